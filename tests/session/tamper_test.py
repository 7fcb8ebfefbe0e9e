#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tampers with sessions in many ways; `haarlight verify` (through session_tool) and
docs/reference/verify_session.py must find all of it where the session was signed before, and what no forger
who computes everything again has touched where it was not. Undisturbed sessions raise no alarm.

    tamper_test.py SESSION_TOOL

HAARLIGHT_TAMPERINGS (one of each kind), HAARLIGHT_UNDISTURBED (12), HAARLIGHT_SEED (drawn, printed),
HAARLIGHT_KEEP (a folder for all of it).
"""

import collections
import hashlib
import importlib.util
import json
import os
import pathlib
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
RIG = ROOT / "configs/rigs/small8.toml"
SPEC = importlib.util.spec_from_file_location("verify_session", ROOT / "docs/reference/verify_session.py")
PYTHON = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(PYTHON)
TOOL = sys.argv[1]


def run(*words, **options):
    return subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True,
                          **options).stdout


def compact(value):
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


class Skip(Exception):
    """This session has nothing of that kind."""


def need(value):
    if not value:
        raise Skip
    return value


class Case:
    """A copy of a session, and an editor that knows the format."""

    def __init__(self, folder, other, chance, keys):
        self.folder, self.other, self.chance, self.keys = folder, other, chance, keys

    def path(self, name):
        return self.folder / name

    def load(self, name="session.json"):
        return json.loads(self.path(name).read_bytes())

    def save(self, info, name="session.json"):
        """In the layout of haarlight itself."""
        parts = []
        for key, value in info.items():
            text = compact(value)
            if isinstance(value, list) and value:
                text = "[\n" + ",\n".join(map(compact, value)) + "\n]"
            parts.append(f'"{key}": {text}')
        self.path(name).write_text("{\n" + ",\n".join(parts) + "\n}\n")

    def having(self, name):
        need(self.path(name).exists())
        return self.path(name)

    def rewrite(self, name, change):
        path = self.path(name)
        path.write_bytes(change(path.read_bytes()))

    def flip_a_bit(self, file, first=0, end=None):
        data = bytearray(file.read_bytes())
        data[self.chance.randrange(first, end or len(data))] ^= 1 << self.chance.randrange(8)
        file.write_bytes(data)

    def take(self, name):
        """The other session's file of this name."""
        shutil.copy(self.other / name, self.path(name))

    def edit(self, change, *names):
        for name in names or ("session.json", "start.json"):
            info = self.load(name)
            change(info)
            self.save(info, name)

    def edit_session(self, change):
        self.edit(change, "session.json")

    def edit_evidence(self, **values):
        """Of any frame, in its description."""
        self.say(self.frame(), lambda said: said["evidence"].update(values))

    def frame(self):
        return self.path(self.chance.choice(self.load()["frames"])["file"])

    def two_frames(self):
        frames = self.load()["frames"]
        need(len(frames) > 1)
        return [self.path(f["file"]) for f in self.chance.sample(frames, 2)]

    def describe(self, file):
        """The description of a frame and its position in the file."""
        data = file.read_bytes()
        at = data.find(b'{"haarlight_frame"')
        end = data.find(b"\0", at)
        return data, at, end, json.loads(data[at:end])

    def say(self, file, change):
        """Changes a description; a longer one goes to the file's end, as libtiff would do it."""
        data, at, end, said = self.describe(file)
        change(said)
        text = json.dumps(said, separators=(",", ":")).encode() + b"\0"
        directory = int.from_bytes(data[4:8], "little")
        data = bytearray(data)
        for i in range(int.from_bytes(data[directory:directory + 2], "little")):
            entry = directory + 2 + 12 * i
            if data[entry:entry + 2] == (270).to_bytes(2, "little"):
                if len(text) > end - at + 1:
                    data[entry + 8:entry + 12] = len(data).to_bytes(4, "little")
                    data += text
                else:
                    data[at:end + 1] = text.ljust(end + 1 - at, b"\0")
                data[entry + 4:entry + 8] = len(text).to_bytes(4, "little")
        file.write_bytes(data)

    def sql(self, *statements):
        """How many rows were changed."""
        base = sqlite3.connect(self.having("journal.sqlite"))
        n = 0
        for statement in statements:
            words = statement if isinstance(statement, tuple) else (statement, ())
            n += max(base.execute(*words).rowcount, 0)
        base.commit()
        base.close()
        return n

    def reseal(self):
        """Leaves, files and root again, as they now are."""
        info = self.load()
        if "root" not in info:
            return
        del info["root"]
        for frame in info["frames"]:
            frame["sha256"] = PYTHON.leaf(frame["file"], self.path(frame["file"]).read_bytes()).hex()
        frames = {f["file"] for f in info["frames"]}
        names = [n for n in ("start.json", "plan.json", "rig.toml") if self.path(n).exists()]
        names += [str(p.relative_to(self.folder)) for part in ("frames", "aside")
                  for p in self.path(part).rglob("*") if p.is_file()]
        info["files"] = [{"name": n, "sha256": PYTHON.leaf(n, self.path(n).read_bytes()).hex()}
                         for n in names if n not in frames]
        if self.path("journal.sqlite").exists():
            text = PYTHON.journal_content(self.path("journal.sqlite"))[0]
            info["files"].append({"name": "journal.sqlite",
                                  "sha256": PYTHON.leaf("journal.sqlite", text).hex()})
        info["files"].sort(key=lambda f: f["name"].encode())
        self.save(info)
        part = self.path("session.json").read_bytes()[:-len(b"\n}\n")]
        leaves = [PYTHON.leaf("session.json", part)] + [
            bytes.fromhex(f["sha256"]) for f in info["frames"] + info["files"]]
        self.path("session.json").write_bytes(
            part + f',\n"root": "{PYTHON.merkle(leaves).hex()}"\n}}\n'.encode())

    def forge(self):
        """Makes everything agree with the frames, plan and rig as they now are."""
        info = self.load()
        texts = [n for n in ("plan.json", "rig.toml") if self.path(n).exists()]
        hashes = run(TOOL, "hash", *[self.path(n) for n in texts],
                     *[self.path(f["file"]) for f in info["frames"]]).split()
        changed = dict(zip(("plan_file_hash", "rig_hash"), hashes))
        changed = {k: v for k, v in changed.items() if info[k]}
        for frame, file_hash in zip(info["frames"], hashes[len(texts):]):
            said = self.describe(self.path(frame["file"]))[3]
            frame["file_hash"], frame["evidence"] = file_hash, said["evidence"]
            if self.path("journal.sqlite").exists():
                self.sql(("UPDATE frames SET file_hash = ?, evidence = ? WHERE file = ?",
                          (file_hash, json.dumps(said["evidence"], separators=(",", ":")),
                           frame["file"])))
        info.update(changed)
        self.save(info)
        self.edit(lambda start: start.update(changed), "start.json")
        self.reseal()

    def settle(self):
        """Frames say what session.json says: another setup, other lights."""
        info = self.load()
        setup = PYTHON.setup_hash(info)
        for frame in info["frames"]:
            shot = info["shots"][frame["shot"]]
            self.say(self.path(frame["file"]), lambda said, s=shot: said.update(
                kind=s["kind"], lit=s["lit"], exposure_us=s["exposure_us"], setup=setup))
        self.forge()

    def sign(self, who="lab", purpose="haarlight"):
        self.path("session.json.sig").unlink(missing_ok=True)
        run("ssh-keygen", "-q", "-Y", "sign", "-f", self.keys / who, "-n", purpose,
            self.path("session.json"))


# --- what needs more than a line


def two_lights(info):
    """Two light shots with other lights: the same ones in every file."""
    shots = [s for s in info["shots"] if s["lit"]]
    pairs = [(a["index"], b["index"]) for a in shots for b in shots if a["lit"] != b["lit"]]
    return need(pairs)[0]


def swap_files(a, b):
    data = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(data)


def one_frame(c):
    return [c.frame()]


def with_a_frame(how):
    return lambda c: how(c.frame())


def instead_of(files, how):
    """The first of the files goes, and something else takes its place."""
    def change(c):
        first, *others = files(c)
        first.unlink()
        how(first, *others)
    return change


def move_away(c, path, name):
    """The file or folder itself lies elsewhere; a link replaces it."""
    away = c.folder.parent / f"{c.folder.name}.{name}"
    path.rename(away)
    path.symlink_to(away)


def attempt_of(file, k):
    return file.with_name(file.name.split("_a")[0] + f"_a{k}.tif")


def exchange_lights(everything):
    """Two frames' files, with their shot numbers fixed; or everything that they say was lit."""
    def change(c):
        need(everything or c.path("journal.sqlite").exists())
        info = c.load()
        one, two = two_lights(info)
        need(not everything or info["shots"][one]["exposure_us"] == info["shots"][two]["exposure_us"])
        a, b = (c.path(info["frames"][i]["file"]) for i in (one, two))
        first, second = c.describe(a)[3], c.describe(b)[3]
        swap_files(a, b)
        for file, now in ((a, first), (b, second)):
            def fix(said, now=now):
                keys = ("shot", "attempt") + (("lit", "kind", "exposure_us") if everything else ())
                said.update({k: now[k] for k in keys})
                keys = ("pattern_id", "tag", "tag_echo") if everything else ()
                said["evidence"].update({k: now["evidence"][k] for k in keys})
            c.say(file, fix)
    return change


def rebuild(c, check=True):
    subprocess.run([TOOL, "rebuild", str(c.folder)], capture_output=True, check=check)


def take_pixels_of_another_session(c):
    """The pixels of another session's frame, under this frame's description."""
    info = c.load()
    f = c.frame()
    donor = need([p for p in sorted((c.other / "frames").glob("*.tif"))
                  if p.stat().st_size >= f.stat().st_size - 64 and
                  json.loads((c.other / "session.json").read_bytes())["form"] == info["form"]])[0]
    mine = c.describe(f)[3]
    theirs = c.describe(donor)[3]["evidence"]
    f.write_bytes(donor.read_bytes())
    pixels = ("min_dn", "max_dn", "mean_dn", "saturated_share", "black_share", "pixel_hash")
    mine["evidence"].update({k: theirs[k] for k in pixels})
    c.say(f, lambda said: (said.clear(), said.update(mine)))


def exchange_rows(c):
    """Of a picture: its statistics stay, its hash is computed again."""
    form = c.load()["form"]
    f = c.frame()
    size = {"u8": 1, "u16": 2, "f32": 4}[form["sample"]] * form["channels"] * form["width"]
    data = bytearray(f.read_bytes())
    data[8:8 + 2 * size] = data[8 + size:8 + 2 * size] + data[8:8 + size]
    f.write_bytes(data)
    raw = c.folder.parent / "pixels.raw"
    pixels = PYTHON.read_tiff(bytes(data))[2]
    raw.write_bytes(pixels[:size * form["height"]])
    pixel_hash = run(TOOL, "hash", raw).strip()
    c.say(f, lambda said: said["evidence"].update(pixel_hash=pixel_hash))


def swap_lit(info):
    one, two = two_lights(info)
    shots = info["shots"]
    shots[one]["lit"], shots[two]["lit"] = shots[two]["lit"], shots[one]["lit"]


def move_light(info):
    light = info["lights"][0]
    place = light["position_mm" if "position_mm" in light else "direction"]
    place[0], place[1] = -place[1] + 1e-3, place[0]


def swap_places(info):
    a, b = info["lights"][:2]
    a["position_mm"], b["position_mm"] = b["position_mm"], a["position_mm"]


def change_power(info):
    info["lights"][1]["relative_power"] = 1.01


def add_lobe(info):
    info["lights"][1].update(axis=[0.0, 0.0, -1.0], lobe_mu=1.0)


def change_clip(info):
    info["form"]["clip_level"] = info["form"]["white_level"] - 500.0


def change_gains(info):
    form = info["form"]
    form["gains"] = [1.25 * gain for gain in form.get("gains", [1.0] * form["channels"])]


def change_crop(info):
    form = info["form"]
    form["crop"] = [1, 2, form["width"] + 4, form["height"] + 4]


def change_exposure(info):
    info["shots"][0]["exposure_us"] += 0.5


def change_kind(info):
    info["shots"][0]["kind"] = "sentinel" if info["shots"][0]["kind"] != "sentinel" else "light"


def change_levels(info):
    need([s for s in info["shots"] if s["lit"]])[0]["lit"][0][1] = 60000


def set_in_both(**values):
    return lambda c: c.edit(lambda info: info.update(values))


def save_plan(c, plan):
    c.path("plan.json").write_text(compact(plan) + "\n")


def plan_as_the_session_says(c):
    plan = c.load("plan.json")
    plan["shots"] = [{k: s[k] for k in ("index", "kind", "exposure_us", "lit")} for s in c.load()["shots"]]
    save_plan(c, plan)


def plan_dims_a_light(c):
    c.having("rig.toml")
    plan = c.load("plan.json")
    need([s for s in plan["shots"] if s["lit"]])[0]["lit"][0][1] = 4000
    save_plan(c, plan)


def another_plan(c):
    before = c.path("plan.json").read_bytes()
    c.take("plan.json")
    need(before != c.path("plan.json").read_bytes())


def without_a_rig(c):
    need(not c.path("rig.toml").exists())


def forget_the_root(c):
    """Nothing is left by which a session could be known for one with a root."""
    def change(info):
        for key in ("root", "files", "made_by", "program"):
            info.pop(key, None)
        for frame in info["frames"]:
            frame.pop("sha256", None)
    c.edit(change)
    for frame in c.load()["frames"]:
        c.say(c.path(frame["file"]),
              lambda said: [said.pop(k) for k in ("lit", "kind", "exposure_us", "setup")])


def any_aside(c):
    return c.chance.choice(need(sorted(p for p in c.path("aside").glob("*") if p.is_file())))


def empty_aside(c):
    any_aside(c)
    shutil.rmtree(c.path("aside"))
    c.path("aside").mkdir()


def add_to_aside(c):
    c.path("aside").mkdir(exist_ok=True)
    c.path("aside/000000_a5.tif").write_bytes(b"x")


# --- the kinds


Kind = collections.namedtuple("Kind", "steps forges signature")


def does(*steps):
    return Kind(steps, forges=False, signature=False)


def forges(*steps):
    """Who computes everything again; found for sure only where the session was signed before."""
    return Kind(steps, forges=True, signature=False)


def signs(*steps):
    """Touches only the signature."""
    return Kind(steps, forges=False, signature=True)


def everywhere(name, change):
    """In session.json, start.json, both, and both with a new root: what the frames, the plan and
    the rig say gives even the last one away."""
    return {f"{name}_in_session_json": does(lambda c: c.edit(change, "session.json")),
            f"{name}_in_start_json": does(lambda c: c.edit(change, "start.json")),
            f"{name}_in_both": does(lambda c: c.edit(change)),
            f"{name}_in_both_with_a_new_root": does(lambda c: c.edit(change), Case.reseal)}


def text(change):
    """Of session.json."""
    return does(lambda c: c.rewrite("session.json", change))


def rows(*statements):
    """Of the journal; one of them at least is there."""
    return lambda c: need(c.sql(*statements))


KINDS = {
    # the frames' files
    "pixel_flipped": does(lambda c: c.flip_a_bit(c.frame(), 8, 60)),
    "any_bit_of_a_frame_flipped": does(lambda c: c.flip_a_bit(c.frame())),
    "frame_cut": does(lambda c: c.rewrite(c.frame(), lambda t: t[:c.chance.randrange(len(t))])),
    "frame_longer": does(lambda c: c.rewrite(c.frame(), lambda t: t + bytes(c.chance.randrange(1, 9)))),
    "frame_emptied": does(with_a_frame(lambda f: f.write_bytes(b""))),
    "frame_deleted": does(with_a_frame(pathlib.Path.unlink)),
    "frames_exchanged": does(lambda c: swap_files(*c.two_frames())),
    "frame_copied_over_another": does(lambda c: shutil.copyfile(*reversed(c.two_frames()))),
    "frame_of_another_session": does(lambda c: c.frame().write_bytes(
        need(sorted((c.other / "frames").glob("*.tif")))[0].read_bytes())),
    "frame_is_a_link_to_its_own_bytes": does(lambda c: move_away(c, c.frame(), "away.tif")),
    "frame_is_a_link_to_another": does(instead_of(Case.two_frames, lambda a, b: a.symlink_to(b.name))),
    "frame_is_a_hard_link_to_another": does(instead_of(Case.two_frames, lambda a, b: a.hardlink_to(b))),
    "frame_is_a_pipe": does(instead_of(one_frame, os.mkfifo)),
    "frame_is_a_folder": does(instead_of(one_frame, os.mkdir)),
    "frames_folder_is_a_link": does(lambda c: move_away(c, c.path("frames"), "frames")),
    "frame_added": does(with_a_frame(lambda f: shutil.copy(f, attempt_of(f, 9)))),
    "stray_in_frames": does(lambda c: c.path("frames/Thumbs.db").write_bytes(b"x")),
    "frame_renamed": does(with_a_frame(lambda f: f.rename(attempt_of(f, 7)))),
    "description_edited": does(lambda c: c.edit_evidence(discarded_before=3)),
    "lit_taken_out_of_a_frame": does(lambda c: c.say(c.frame(), lambda said: said.pop("lit"))),
    "frames_exchanged_with_fixed_shots_then_rebuilt": does(
        exchange_lights(False), lambda c: rebuild(c, check=False)),
    "frames_exchanged_with_fixed_descriptions_then_rebuilt": forges(exchange_lights(True), rebuild),
    "frames_exchanged_with_everything_fixed": forges(exchange_lights(True), Case.forge),
    "frame_of_another_session_with_everything_fixed": forges(take_pixels_of_another_session, Case.forge),
    "pixels_and_all_hashes_edited": forges(exchange_rows, Case.forge),

    # session.json and start.json
    **everywhere("lit_swapped", swap_lit),
    **everywhere("light_moved", move_light),
    **everywhere("places_swapped", swap_places),
    **everywhere("power_changed", change_power),
    **everywhere("lobe_added", add_lobe),
    **everywhere("clip_level_changed", change_clip),
    **everywhere("gains_changed", change_gains),
    **everywhere("crop_changed", change_crop),
    **everywhere("exposure_changed", change_exposure),
    **everywhere("kind_changed", change_kind),
    **everywhere("drive_level_changed", change_levels),
    "places_and_frames_and_root_changed": forges(
        without_a_rig, lambda c: c.edit(swap_places), Case.settle),
    "power_and_frames_and_root_changed": forges(
        without_a_rig, lambda c: c.edit(change_power), Case.settle),
    "lit_swapped_everywhere": forges(
        lambda c: c.having("rig.toml"), lambda c: c.edit(swap_lit), plan_as_the_session_says, Case.settle),
    "date_changed_with_a_new_root": forges(set_in_both(created="2019-01-01T00:00:00Z"), Case.reseal),
    "date_changed": does(set_in_both(created="2019-01-01T00:00:00Z")),
    "stamp_changed_in_session_json": does(lambda c: c.edit_session(
        lambda info: info["frames"][0]["evidence"].update(t_ack_ns=1))),
    "verdict_changed_everywhere": forges(lambda c: c.edit_evidence(verdict="saturated"), Case.forge),
    "temperature_changed_everywhere": forges(lambda c: c.edit_evidence(temperature_c=20.5), Case.forge),
    "key_doubled": text(lambda t: t.replace(b'{\n"schema": 1', b'{\n"grid_rows": 4,\n"schema": 1', 1)),
    "unknown_field": text(lambda t: t.replace(b'{\n"schema": 1', b'{\n"note": "x",\n"schema": 1', 1)),
    "byte_order_mark": text(lambda t: b"\xef\xbb\xbf" + t),
    "key_in_capitals": text(lambda t: t.replace(b'"grid_rows"', b'"Grid_rows"', 1)),
    "line_ends_of_dos": text(lambda t: t.replace(b"\n", b"\r\n")),
    "written_anew_by_an_editor": text(lambda t: json.dumps(json.loads(t), indent=2).encode()),
    "a_space_at_the_end": text(lambda t: t + b" "),
    "root_of_zeros": text(lambda t: t[:-69] + b"0" * 64 + t[-5:]),
    "session_json_cut": text(lambda t: t[:len(t) // 2]),
    "root_taken_away": does(lambda c: c.edit_session(
        lambda info: (info.pop("root"), info.pop("files"), info.pop("made_by")))),
    "made_an_old_session": forges(forget_the_root, Case.forge),
    "made_by_changed_with_a_new_root": forges(lambda c: c.edit_session(lambda info: info.update(
        made_by="rebuild" if info["made_by"] != "rebuild" else "capture")), Case.reseal),
    "entry_of_files_taken_out": does(lambda c: c.edit_session(lambda info: info["files"].pop())),
    "frames_leaf_changed": does(lambda c: c.edit_session(
        lambda info: info["frames"][0].update(sha256="0" * 64))),
    "last_shot_taken_out": does(lambda c: c.edit(
        lambda info: (info["shots"].pop(), info["frames"] and info["frames"].pop())), Case.reseal),

    # plan and rig
    "plan_edited": does(lambda c: c.rewrite("plan.json", lambda t: t.replace(b"65535", b"65534", 1) + b" ")),
    "plan_edited_with_its_hash": does(plan_dims_a_light, Case.forge),
    "plan_missing": does(lambda c: c.path("plan.json").unlink()),
    "plan_of_another_session": does(another_plan),
    "rig_edited": does(lambda c: c.rewrite(c.having("rig.toml"), lambda t: t.replace(b"900.0", b"901.0"))),
    "rig_edited_with_its_hash": does(lambda c: c.rewrite(
        c.having("rig.toml"), lambda t: t.replace(b"pitch = 120.0", b"pitch = 121.0")), Case.forge),
    "rigs_comment_edited_with_its_hash": forges(
        lambda c: c.rewrite(c.having("rig.toml"), lambda t: t + b"# nothing\n"), Case.forge),
    "rig_missing": does(lambda c: c.having("rig.toml").unlink()),
    "start_missing": does(lambda c: c.path("start.json").unlink()),
    "a_rig_appears": does(without_a_rig, lambda c: shutil.copy(RIG, c.path("rig.toml"))),

    # the journal
    "event_deleted": does(rows("DELETE FROM events WHERE id = 1")),
    "all_events_deleted": does(rows("DELETE FROM events")),
    "last_event_deleted": does(rows("DELETE FROM events WHERE id = (SELECT max(id) FROM events)")),
    "event_added": does(rows("INSERT INTO events (kind, json) VALUES ('state', '{}')")),
    "event_edited": does(rows("UPDATE events SET json = '{\"reason\": \"nothing\"}' WHERE id = 1")),
    "withdrawn_row_deleted": does(rows("DELETE FROM frames WHERE state = 'withdrawn'")),
    "withdrawn_row_deleted_with_a_new_root": does(
        rows("DELETE FROM frames WHERE state = 'withdrawn'"), Case.reseal),
    "row_deleted": does(rows("DELETE FROM frames WHERE id = 1")),
    "rows_state_changed": does(rows("UPDATE frames SET state = 'withdrawn' WHERE id = 2")),
    "rows_evidence_edited": does(rows(
        "UPDATE frames SET evidence = replace(evidence, '\"tag\":', '\"tag\": ') WHERE id = 1")),
    "rows_exchanged": does(rows("UPDATE frames SET id = -1 WHERE id = 1",
                                "UPDATE frames SET id = 1 WHERE id = 2",
                                "UPDATE frames SET id = 2 WHERE id = -1")),
    "table_added": does(lambda c: c.sql("CREATE TABLE notes (text TEXT)")),
    "journal_missing": does(lambda c: c.having("journal.sqlite").unlink()),
    "journal_of_another_session": does(lambda c: c.having("journal.sqlite"),
                                       lambda c: need((c.other / "journal.sqlite").exists()),
                                       lambda c: c.take("journal.sqlite")),
    "journal_cut": does(lambda c: os.truncate(c.having("journal.sqlite"), 4096)),
    "journal_not_closed": does(lambda c: c.path("journal.sqlite-wal").write_bytes(b"x" * 32)),
    "event_edited_with_a_new_root": forges(
        rows("UPDATE events SET kind = 'stated', json = '{}' WHERE kind = 'state'"), Case.reseal),

    # aside/
    "note_in_aside_removed": does(lambda c: any_aside(c).unlink()),
    "note_in_aside_edited": does(lambda c: c.rewrite(any_aside(c), lambda t: t + b"!")),
    "file_added_to_aside": does(add_to_aside),
    "aside_emptied_with_a_new_root": forges(empty_aside, Case.reseal),

    # the signature
    "signature_removed": signs(lambda c: c.path("session.json.sig").unlink()),
    "signature_of_another_session": signs(lambda c: c.take("session.json.sig")),
    "signature_cut": signs(lambda c: c.rewrite("session.json.sig", lambda t: t[:120])),
    "signed_by_a_stranger_after_forging": signs(
        lambda c: c.edit_evidence(temperature_c=20.5), Case.forge, lambda c: c.sign("stranger")),
    "signed_for_another_purpose": signs(lambda c: c.sign(purpose="file")),
    "rebuilt": signs(rebuild),
}


# --- the campaign


def by_python(folder, signers):
    PYTHON.problems.clear()
    PYTHON.notes.clear()
    try:
        PYTHON.check(str(folder), str(signers) if signers else "")
    except PYTHON.UNREADABLE as error:
        PYTHON.problems.append(f"cannot be read: {error}")
    return list(PYTHON.problems)


def by_ours(folders, signers):
    out = run(TOOL, "verify", signers or "-", *folders)
    return [json.loads(line)["problems"] for line in out.splitlines()]


def fingerprint(folder):
    """Of everything that could be seen: kinds, links, bytes."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        target = os.readlink(path) if path.is_symlink() else ""
        data = path.read_bytes() if path.is_file() else b""
        digest.update(f"{path.relative_to(folder)} {path.lstat().st_mode} {target}".encode() + data)
    return digest.digest()


def tamper(kind, whole, folder, chance, keys):
    """A copy of one of the sessions, tampered with; whether one was found that can be."""
    for _ in range(200):
        original, other = chance.sample(whole, 2)
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(original, folder)
        state = chance.getstate()
        try:
            case = Case(folder, other, chance, keys)
            for step in kind.steps:
                step(case)
        except (Skip, IndexError, KeyError):
            chance.setstate(state)
            chance.random()
            continue
        if fingerprint(folder) != fingerprint(original):
            return True
    return False


def verdicts(folders, signers):
    """Of each folder: who, and the problems that he found."""
    for folder, ours in zip(folders, by_ours(folders, signers)):
        yield {"verify": ours, "verify_session.py": by_python(folder, signers)}


def campaign(place, seed, n_tamperings, n_undisturbed):
    """What was missed, and what was said of undisturbed sessions."""
    chance = random.Random(seed)
    failures = []
    keys = place / "keys"
    keys.mkdir()
    for who in ("lab", "stranger"):
        run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", who, "-f", keys / who)
    signers = keys / "allowed_signers"
    signers.write_text(f"lab@example.org {(keys / 'lab.pub').read_text()}")
    run(TOOL, "make", seed, n_undisturbed, place / "whole", RIG)
    whole = [place / "whole" / str(i) for i in range(n_undisturbed)]
    for when, asked in (("unsigned", ""), ("signed", signers)):
        if asked:
            for folder in whole:
                Case(folder, None, chance, keys).sign()
        for folder, found in zip(whole, verdicts(whole, asked)):
            failures += [f"false alarm: {when} {folder.name} by {who}: {problems[:3]}"
                         for who, problems in found.items() if problems]
    cases = []  # name, kind, folder
    for i in range(n_tamperings):
        name, kind = list(KINDS.items())[i % len(KINDS)]
        folder = place / "work" / str(i)
        if tamper(kind, whole, folder, chance, keys):
            cases.append((name, kind, folder))
        else:
            failures.append(f"{name}: no session of this campaign can be tampered with so")
    for (name, _, folder), found in zip(cases, verdicts([folder for *_, folder in cases], signers)):
        failures += [f"missed: signed, {name} ({folder.name}) by {who}"
                     for who, problems in found.items() if not problems]
    print(f"signed: {len(cases)} tamperings, missed by one of the two: "
          f"{sum(f.startswith('missed: signed') for f in failures)}")
    cases = [case for case in cases if not case[1].signature]
    for *_, folder in cases:
        (folder / "session.json.sig").unlink(missing_ok=True)
    n = collections.defaultdict(collections.Counter)
    for (name, kind, folder), found in zip(cases, verdicts([folder for *_, folder in cases], "")):
        n[name]["all"] += 1
        for who, problems in found.items():
            n[name][who] += bool(problems)
            if not problems and not kind.forges:
                failures.append(f"missed: unsigned, {name} ({folder.name}) by {who}")
    total = sum(n.values(), collections.Counter())
    print(f"unsigned: {total['all']} tamperings, found {total['verify']} by verify, "
          f"{total['verify_session.py']} by verify_session.py; not always found:")
    for name, row in sorted(n.items()):
        if min(row["verify"], row["verify_session.py"]) < row["all"]:
            print(f"    {name}: {row['all']} times, found {row['verify']} and "
                  f"{row['verify_session.py']}")
    return failures


def main():
    seed = int(os.environ.get("HAARLIGHT_SEED", random.SystemRandom().randrange(2**31)))
    n_tamperings = int(os.environ.get("HAARLIGHT_TAMPERINGS", len(KINDS)))
    n_undisturbed = int(os.environ.get("HAARLIGHT_UNDISTURBED", 12))
    print(f"HAARLIGHT_SEED={seed}: {n_tamperings} tamperings of {len(KINDS)} kinds, "
          f"{n_undisturbed} undisturbed sessions", flush=True)
    base = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(prefix="haarlight_tamper_", dir=base) as place:
        failures = campaign(pathlib.Path(place), seed, n_tamperings, n_undisturbed)
        if os.environ.get("HAARLIGHT_KEEP"):
            run("cp", "-a", f"{place}/.", os.environ["HAARLIGHT_KEEP"])  # pipes too
    print("\n".join(failures))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
