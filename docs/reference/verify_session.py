#!/usr/bin/env python3
"""Checks a haarlight session (docs/reference/session-format.md) with Python's standard library alone.

    python3 verify_session.py SESSION [--signers ALLOWED_SIGNERS]

Prints each broken promise; exit code 0: none. Unsigned this finds accident and careless editing, signed (it calls
ssh-keygen) everything after signing. XXH3 is left to `haarlight verify`: SHA-256 covers the same bytes.  SPDX-License-Identifier: Apache-2.0"""
import array, contextlib, hashlib, json, math, os, re, sqlite3, stat, struct, subprocess, sys, tomllib, urllib.parse

OWN = set("start.json session.json session.json.sig plan.json rig.toml frames aside journal.sqlite aborted.txt cache".split())
TABLES = ("SELECT type, name, sql FROM sqlite_master ORDER BY type, name",
          "SELECT format, session FROM meta ORDER BY rowid",
          "SELECT id, shot, attempt, file, file_hash, evidence, state FROM frames ORDER BY id",
          "SELECT id, kind, json FROM events ORDER BY id")
UNREADABLE = (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, sqlite3.Error, struct.error)
SHOT = ("index", "kind", "lit", "exposure_us")
SAMPLES = {"u8": ("B", 8, 1), "u16": ("H", 16, 1), "f32": ("f", 32, 3)}  # code, bits, TIFF's SampleFormat
problems, notes = [], []

def need(is_good, text):
    if not is_good:
        problems.append(text)
    return is_good

def parse(text):
    def unique(pairs):
        if len(dict(pairs)) != len(pairs):
            raise ValueError("a key stands twice in one object")
        return dict(pairs)
    return json.loads(text.decode("utf-8"), object_pairs_hook=unique)

def leaf(name, data):
    return hashlib.sha256(b"\0" + name.encode() + b"\0" + data).digest()

def merkle(leaves):
    k = 1 << ((len(leaves) - 1).bit_length() - 1) if len(leaves) > 1 else 0
    return hashlib.sha256(b"\1" + merkle(leaves[:k]) + merkle(leaves[k:])).digest() if k else leaves[0]

def setup_hash(info):
    data, form = b"", info["form"]
    for light in info["lights"]:
        place = "position_mm" if "position_mm" in light else "direction"
        for text in (light["name"].encode(), place.encode()):
            data += b"%d:" % len(text) + text
        data += struct.pack("<4d", *light[place], light["relative_power"])
        if "axis" in light:
            data += b"4:lobe" + struct.pack("<4d", *light["axis"], light["lobe_mu"])
    data += struct.pack(
        "<12d", form["width"], form["height"], form["stored_height"], form["channels"],
        SAMPLES[form["sample"]][1], ("linear", "srgb", "unknown").index(form["transfer"]),
        ("none", "rggb", "bggr", "grbg", "gbrg").index(form["bayer"]), form["black_level"],
        form["white_level"], form.get("clip_level", form["white_level"]), info["grid_rows"], info["grid_cols"])
    for name in (name for name in ("gains", "crop") if name in form):
        data += b"%d:" % len(name) + name.encode() + struct.pack(f"<{len(form[name])}d", *form[name])
    return hashlib.sha256(data).hexdigest()

def read_tiff(data):
    at, tags = *struct.unpack_from("<I", data, 4), {}
    for i in range(struct.unpack_from("<H", data, at)[0]):
        tag, kind, count, value = struct.unpack_from("<HHII", data, at + 2 + 12 * i)
        code = {1: "B", 2: "s", 3: "H", 4: "I"}.get(kind, "B")
        start = at + 10 + 12 * i if struct.calcsize(code) * count <= 4 else value
        tags[tag] = struct.unpack_from(f"<{count}{code}", data, start)
    if data[:4] != b"II*\0" or tags.get(259) != (1,):
        raise ValueError("not a little-endian, uncompressed TIFF")
    pixels = b"".join(data[o:o + n] for o, n in zip(tags[273], tags[279]))
    form = tags[256][0], tags[257][0], tags.get(277, (1,))[0], (tags[258][0], tags.get(339, (1,))[0])
    return form, parse(tags[270][0].rstrip(b"\0")), pixels

def check_evidence(e, form, pixels):
    kind, bits, _ = SAMPLES[form["sample"]]
    samples = array.array(kind, pixels[:form["width"] * form["height"] * form["channels"] * bits // 8])
    clip, black = form.get("clip_level", form["white_level"]), form["black_level"]
    word = lambda value: int(min(max(value, 0), 65535))
    sums = math.fsum(samples), sum(v >= clip for v in samples), sum(v <= black for v in samples)
    said = e["mean_dn"], e["saturated_share"], e["black_share"]
    if (word(min(samples)), word(max(samples))) != (e["min_dn"], e["max_dn"]) or any(
            abs(a / len(samples) - b) > 1e-9 * max(1.0, abs(b)) for a, b in zip(sums, said)):
        return "the pixels are not those of the evidence"
    if e["kind"] == "asserted":
        return ""
    if e["tag"] != e["tag_echo"] or e["flags"] & 3:
        return "its tag came back otherwise, or the camera marked it"
    exposure = (ns := lambda us: math.floor(us * 1000.0 + 0.5))(e["exposure_read_us"])
    start = e["timestamp_ns"] - {"start_exposure": 0, "start_readout": exposure,
                                 "end_frame": ns(e["read_us"]) + exposure}[e["timestamp_meaning"]]
    end = start + exposure + ns(e["skew_us"])
    if (start, end) != (e["t_exposure_start_ns"], e["t_exposure_end_ns"]) or start < e["t_stable_ns"] or (
            end > e["t_next_change_ns"]):
        return "its exposure does not follow from the timestamp, or its light was not stable"
    shown = e["t_ack_ns"] if e.get("t_shown_ns") is None else e["t_shown_ns"]
    if e["sync"] == "camera-leads":
        return "" if e["step_after"] == e["step_before"] + 1 > 0 <= e["margin_us"] and shown <= start else "not one step on"
    return "" if e["t_command_ns"] <= e["t_ack_ns"] <= shown <= e["t_stable_ns"] else "its times are out of order"

def check_frame(frame, info, setup, data):
    form, shot, e, (shape, said, pixels) = info["form"], info["shots"][frame["shot"]], frame["evidence"], read_tiff(data)
    if shape != (form["width"], form["stored_height"], form["channels"], SAMPLES[form["sample"]][1:]):
        return "not of the session's form"
    expected = {"haarlight_frame": 1, "session": info["id"], "plan_hash": info["plan_hash"], "shot": frame["shot"],
                "attempt": frame["attempt"], "evidence": e}
    if "program" in info or "lit" in said:
        expected.update(kind=shot["kind"], lit=shot["lit"], exposure_us=shot["exposure_us"], setup=setup)
    if said != expected:
        return f"it says otherwise of itself: {[k for k in said | expected if said.get(k) != expected.get(k)]}"
    if e["kind"] == "measured" and (e["pattern_id"] != shot["index"] or e["exposure_asked_us"] != (
            shot["exposure_us"] or e["exposure_asked_us"])):
        return "taken for another pattern or exposure"
    return check_evidence(e, form, pixels)

def check_plan(plan, info):
    if "shots" in plan:
        need([{k: s[k] for k in SHOT} for s in plan["shots"]] == info["shots"] and plan["hash"] == info["plan_hash"]
             and plan["n_lights"] == len(info["lights"]), "plan.json: its shots are not those of session.json")
    elif "pictures" in plan:
        n, names = len(info["lights"]), [light["name"] for light in info["lights"]]
        need(len(plan["pictures"]) == len(info["shots"]) and all(
            (s["kind"], s["lit"]) == (("light", [[i, 65535]]) if i < n else ("dark", []))
            and (i >= n or names[i] in ("", plan["pictures"][i]["name"]))
            for i, s in enumerate(info["shots"])), "plan.json: its pictures are not the shots of session.json")

def check_rig(text, info):
    rig, expected = tomllib.loads(text), []
    for face in rig["face"]:
        u, v = ([x / math.hypot(*face[key]) for x in face[key]] for key in "uv")
        for row in range(face["rows"]):
            for col in range(face["cols"]):
                a, b = ((i - 0.5 * (n - 1)) * face["pitch"] for i, n in ((col, face["cols"]), (row, face["rows"])))
                place = [c + x * a + y * b for c, x, y in zip(face["centre"], u, v)]
                expected.append((f"{face['id']}/{row}/{col}", place))
    camera, form = rig["camera"][0], info["form"]
    need([light["name"] for light in info["lights"]] == [name for name, _ in expected]
         and {(light["relative_power"], "axis" in light) for light in info["lights"]} == {(1, False)}, "rig.toml: its lights are others")
    need([form[k] for k in ("width", "stored_height", "height", "white_level", "bayer")] ==
         [*camera["size"], camera["active_area"], 2 ** camera["bits"] - 1, camera.get("bayer", "none")]
         and not {"gains", "crop"} & form.keys(), "rig.toml: its camera's frames are not those of session.json")
    if "# haarlight measured values" in text:
        return notes.append("rig.toml: measured values override it: positions and times are left to haarlight verify")
    need(form["black_level"] == camera.get("noise", {}).get("black", 0) and all(
        "position_mm" in light and math.dist(light["position_mm"], place) < 1e-6
        for light, (_, place) in zip(info["lights"], expected)), "rig.toml: other positions of lights, or black level")

def journal_content(path):
    with contextlib.closing(sqlite3.connect(f"file:{urllib.parse.quote(os.path.abspath(path))}?mode=ro", uri=True)) as base:
        base.text_factory = bytes
        need(base.execute("PRAGMA integrity_check(1)").fetchone() == (b"ok",), "journal.sqlite: damaged")
        plain = lambda value: str(value).encode() if isinstance(value, (int, float)) else value or b""
        tables = [[tuple(map(plain, row)) for row in base.execute(query)] for query in TABLES]
    line = lambda row: b"".join(b"%d:" % len(value) + value for value in row) + b"\n"
    return b"".join(b"".join(map(line, table)) + b"\n" for table in tables), tables

def check_journal(path, info, files):
    text, (_, meta, rows, events) = journal_content(path)
    need("root" not in info or leaf("journal.sqlite", text).hex() == files.get("journal.sqlite"),
         "journal.sqlite: its tables were altered")
    need(meta == [(b"1", info["id"].encode())], "journal.sqlite: of another session")
    need([int(r[0]) for r in rows] == list(range(1, len(rows) + 1)), "journal.sqlite: rows are missing")
    need([int(r[0]) for r in events] == list(range(1, len(events) + 1)) and events and events[-1][1] == b"finished",
         "journal.sqlite: events are missing, or it was opened again")
    said, newest, kept = {(kind.decode(), parse(line).get("file")) for _, kind, line in events}, {}, set()
    for _, shot, attempt, file, file_hash, evidence, state in rows:
        name, state = file.decode(), state.decode()
        if state == "committed" and int(attempt) >= newest.get(int(shot), (-1,))[0]:
            newest[int(shot)] = (int(attempt), name, file_hash.decode(), parse(evidence))
        need(state == "committed" or (state, name) in said, f"{name}: {state}, and no event says so")
        kept |= {os.path.basename(name)} if state != "returned" else set()
    need(newest == {f["shot"]: (f["attempt"], f["file"], f["file_hash"], f["evidence"]) for f in info["frames"]},
         "journal.sqlite: its rows are not the frames of session.json")
    return kept

def check_signature(folder, signers):
    session, signature = os.path.join(folder, "session.json"), os.path.join(folder, "session.json.sig")
    if not os.path.lexists(signature):
        return need(not signers, "session.json.sig: missing") and notes.append(
            "not signed: accident and careless editing are found, a forger who computes the root again is not")
    def run(*words):
        with open(session, "rb") as data:
            words = ["ssh-keygen", "-Y", *words, "-s", signature]
            return subprocess.run(words, stdin=data, capture_output=True, text=True)
    answer = run("find-principals", "-f", signers) if signers else run("check-novalidate", "-n", "haarlight")
    if signers and answer.returncode == 0:
        answer = run("verify", "-f", signers, "-I", re.split("[,\n]", answer.stdout)[0], "-n", "haarlight")
    need(answer.returncode == 0, "session.json.sig: " + (answer.stdout + answer.stderr).strip())
    notes.append(answer.stdout.strip())

def check(folder, signers):
    read, present = lambda name: open(os.path.join(folder, name), "rb").read(), set()
    for path, folders, names in os.walk(folder):
        inside = os.path.relpath(path, folder)
        for name in folders + names:
            mode, own = os.lstat(os.path.join(path, name)).st_mode, os.path.normpath(os.path.join(inside, name))
            if inside == "." and name not in OWN:
                need(not name.startswith("journal.sqlite"), f"{name}: the journal was not closed")
            elif (inside, name) != (".", "cache") and need(
                    stat.S_ISREG(mode) or stat.S_ISDIR(mode) and own in ("frames", "aside"), f"{own}: no plain file"):
                present |= {own} if stat.S_ISREG(mode) else set()
        folders[:] = [name for name in folders if inside == "." and name in ("frames", "aside")]
    info = parse(whole := read("session.json"))
    files, listed = {f["name"]: f["sha256"] for f in info.get("files", [])}, {f["file"] for f in info["frames"]}
    sealed = {n for n in present if "/" in n or n in ("start.json", "plan.json", "rig.toml")} - listed
    if "root" in info:
        tail = f',\n"root": "{info["root"]}"\n}}\n'.encode()
        leaves = [leaf("session.json", whole[:-len(tail)])] + [bytes.fromhex(f["sha256"]) for f in info["frames"] + info["files"]]
        need(whole.endswith(tail) and merkle(leaves).hex() == info["root"], "session.json: altered: another root")
        need(sealed == set(files) - {"journal.sqlite"}, f"files came or went: {sealed ^ set(files)}")
        for name in sealed & set(files):
            need(leaf(name, read(name)).hex() == files[name], f"{name}: altered: SHA-256 differs")
    else:
        need("program" not in info and not files, "session.json: its root was taken away")
    first = {k: v for k, v in info.items() if k not in ("files", "root", "made_by")} | {"frames": []}
    need(parse(read("start.json")) == first, "start.json: differs from session.json")
    check_plan(parse(read("plan.json")), info)
    if info["rig_hash"]:
        check_rig(read("rig.toml").decode(), info)
    setup, seen = setup_hash(info), set()
    need([f["shot"] for f in info["frames"]] == [s["index"] for s in info["shots"]] == [*range(len(info["shots"]))],
         "session.json: not a frame for every shot, in order")
    for frame in info["frames"]:
        name, e = frame["file"], frame["evidence"]
        need(name == f"frames/{frame['shot']:06}_a{frame['attempt']}.tif", f"{name}: not named after its shot")
        data = read(name) if name in present else b""
        try:
            need("root" not in info or leaf(name, data).hex() == frame["sha256"], f"{name}: altered: SHA-256 differs")
            problem = check_frame(frame, info, setup, data)
        except UNREADABLE as error:
            problem = f"cannot be read: {error}"
        need(not problem, f"{name}: {problem}")
        need(e["kind"] == "asserted" or (e["sequence"], e["timestamp_ns"]) not in seen, f"{name}: its frame stands for two shots")
        may_coincide = info["form"]["sample"] == "u8" and info["shots"][frame["shot"]]["kind"] == "dark"
        has_noise = e["saturated_share"] + e["black_share"] < 1 and not may_coincide
        need(not has_noise or e["pixel_hash"] not in seen, f"{name}: the same pixels twice")
        seen |= {e["pixel_hash"] if has_noise else "", (e["sequence"], e["timestamp_ns"])}
    if "journal.sqlite" in present:
        rows = check_journal(os.path.join(folder, "journal.sqlite"), info, files)
        need(rows == {n[7:] for n in present if n[:7] == "frames/"}, "frames/: not the files of the journal's rows")
    else:
        need(info["evidence"] == "asserted" and "journal.sqlite" not in files, "journal.sqlite: missing")
    check_signature(folder, signers)
    return info

if __name__ == "__main__":
    if len(sys.argv) not in (2, 4) or sys.argv[2:3] not in ([], ["--signers"]):
        sys.exit("python3 verify_session.py SESSION [--signers ALLOWED_SIGNERS]")
    try:
        session = check(sys.argv[1], sys.argv[3] if len(sys.argv) == 4 else "")
        notes.append(f"root {session.get('root', 'none')}, made by {session.get('made_by', 'an older program')}")
    except UNREADABLE as error:
        problems.append(f"cannot be read: {type(error).__name__}: {error}")
    print("\n".join(problems + ["note: " + note for note in notes]))
    sys.exit(1 if problems else 0)
