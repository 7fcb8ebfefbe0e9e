#!/usr/bin/env python3
"""Tampers with sessions in many ways; `haarlight verify` (through session_tool) and
docs/verify_session.py must find all of it where the session was signed before, and what no forger
who computes everything again has touched where it was not. Undisturbed sessions raise no alarm.

    tamper_test.py SESSION_TOOL

HAARLIGHT_TAMPERINGS (one of each kind), HAARLIGHT_UNDISTURBED (12), HAARLIGHT_SEED (drawn, printed).
"""

import collections
import copy
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
SPEC = importlib.util.spec_from_file_location("verify_session", ROOT / "docs/verify_session.py")
PYTHON = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(PYTHON)
TOOL = sys.argv[1]
KINDS = []  # (name, function, forges, touches only the signature)


def run(*words, **options):
    return subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True,
                          **options).stdout


def kind(function=None, *, forges=False, signature=False):
    if function is None:
        return lambda f: kind(f, forges=forges, signature=signature)
    KINDS.append((function.__name__, function, forges, signature))
    return function


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

    def load(self, name="session.json", folder=None):
        return json.loads(((folder or self.folder) / name).read_bytes())

    def save(self, info, name="session.json"):
        """In the layout of haarlight itself."""
        parts = []
        for key, value in info.items():
            if isinstance(value, list) and value:
                text = "[\n" + ",\n".join(json.dumps(v, separators=(",", ":"), ensure_ascii=False)
                                          for v in value) + "\n]"
            else:
                text = json.dumps(value, separators=(",", ":"), ensure_ascii=False)
            parts.append(f'"{key}": {text}')
        self.path(name).write_text("{\n" + ",\n".join(parts) + "\n}\n")

    def edit(self, change, *names):
        for name in names or ("session.json", "start.json"):
            info = self.load(name)
            change(info)
            self.save(info, name)

    def frame(self):
        return self.path(self.chance.choice(self.load()["frames"])["file"])

    def two_frames(self):
        frames = self.load()["frames"]
        need(len(frames) > 1)
        return [self.path(f["file"]) for f in self.chance.sample(frames, 2)]

    def two_lights(self, info):
        """Two light shots with other lights: the same ones in every file."""
        shots = [s for s in info["shots"] if s["lit"]]
        pairs = [(a["index"], b["index"]) for a in shots for b in shots if a["lit"] != b["lit"]]
        return need(pairs)[0]

    def describe(self, file):
        """The description of a frame and its place in the file."""
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
        if not self.path("journal.sqlite").exists():
            raise Skip
        base = sqlite3.connect(self.path("journal.sqlite"))
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

    def sign(self, who="lab"):
        self.path("session.json.sig").unlink(missing_ok=True)
        run("ssh-keygen", "-q", "-Y", "sign", "-f", self.keys / who, "-n", "haarlight",
            self.path("session.json"))


# --- the frames' files


@kind
def pixel_flipped(c):
    f = c.frame()
    data = bytearray(f.read_bytes())
    data[c.chance.randrange(8, 60)] ^= 1 << c.chance.randrange(8)
    f.write_bytes(data)


@kind
def any_bit_of_a_frame_flipped(c):
    f = c.frame()
    data = bytearray(f.read_bytes())
    data[c.chance.randrange(len(data))] ^= 1 << c.chance.randrange(8)
    f.write_bytes(data)


@kind
def frame_cut(c):
    f = c.frame()
    data = f.read_bytes()
    f.write_bytes(data[:c.chance.randrange(len(data))])


@kind
def frame_longer(c):
    with open(c.frame(), "ab") as f:
        f.write(bytes(c.chance.randrange(1, 9)))


@kind
def frame_emptied(c):
    c.frame().write_bytes(b"")


@kind
def frame_deleted(c):
    c.frame().unlink()


@kind
def frames_exchanged(c):
    a, b = c.two_frames()
    data = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(data)


@kind
def frame_copied_over_another(c):
    a, b = c.two_frames()
    a.write_bytes(b.read_bytes())


@kind
def frame_of_another_session(c):
    f = c.frame()
    f.write_bytes(need(sorted((c.other / "frames").glob("*.tif")))[0].read_bytes())


@kind
def frame_is_a_link_to_its_own_bytes(c):
    f = c.frame()
    away = c.folder.parent / f"{c.folder.name}.away.tif"
    f.rename(away)
    f.symlink_to(away)


@kind
def frame_is_a_link_to_another(c):
    a, b = c.two_frames()
    a.unlink()
    a.symlink_to(b.name)


@kind
def frame_is_a_hard_link_to_another(c):
    a, b = c.two_frames()
    a.unlink()
    a.hardlink_to(b)


@kind
def frame_is_a_pipe(c):
    f = c.frame()
    f.unlink()
    os.mkfifo(f)


@kind
def frame_is_a_folder(c):
    f = c.frame()
    f.unlink()
    f.mkdir()


@kind
def frames_folder_is_a_link(c):
    away = c.folder.parent / f"{c.folder.name}.frames"
    c.path("frames").rename(away)
    c.path("frames").symlink_to(away)


@kind
def frame_added(c):
    f = c.frame()
    shutil.copy(f, f.with_name(f.name.split("_a")[0] + "_a9.tif"))


@kind
def stray_in_frames(c):
    c.path("frames/Thumbs.db").write_bytes(b"x")


@kind
def frame_renamed(c):
    f = c.frame()
    f.rename(f.with_name(f.name.split("_a")[0] + "_a7.tif"))


@kind
def description_edited(c):
    c.say(c.frame(), lambda said: said["evidence"].update(discarded_before=3))


@kind
def lit_taken_out_of_a_frame(c):
    c.say(c.frame(), lambda said: said.pop("lit"))


@kind
def frames_exchanged_with_fixed_shots_then_rebuilt(c):
    """Two frames in an editor: their shot numbers fixed, not what they say was lit."""
    if not c.path("journal.sqlite").exists():
        raise Skip
    info = c.load()
    one, two = c.two_lights(info)
    a, b = (c.path(info["frames"][i]["file"]) for i in (one, two))
    exchange(c, a, b, lambda x, y: {"shot": y["shot"], "attempt": y["attempt"]})
    subprocess.run([TOOL, "rebuild", str(c.folder)], capture_output=True, check=False)


@kind(forges=True)
def frames_exchanged_with_fixed_descriptions_then_rebuilt(c):
    info = c.load()
    one, two = c.two_lights(info)
    need(info["shots"][one]["exposure_us"] == info["shots"][two]["exposure_us"])
    a, b = (c.path(info["frames"][i]["file"]) for i in (one, two))
    exchange(c, a, b, lambda x, y: {k: y[k] for k in ("shot", "attempt", "lit", "kind", "exposure_us")},
             fix_evidence=True)
    run(TOOL, "rebuild", c.folder)


@kind(forges=True)
def frames_exchanged_with_everything_fixed(c):
    info = c.load()
    one, two = c.two_lights(info)
    need(info["shots"][one]["exposure_us"] == info["shots"][two]["exposure_us"])
    a, b = (c.path(info["frames"][i]["file"]) for i in (one, two))
    exchange(c, a, b, lambda x, y: {k: y[k] for k in ("shot", "attempt", "lit", "kind", "exposure_us")},
             fix_evidence=True)
    c.forge()


def exchange(c, a, b, fields, fix_evidence=False):
    first, second = c.describe(a)[3], c.describe(b)[3]
    data = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(data)
    for file, was, now in ((a, second, first), (b, first, second)):
        def change(said, was=was, now=now):
            said.update(fields(was, now))
            if fix_evidence:
                for key in ("pattern_id", "tag", "tag_echo"):
                    said["evidence"][key] = now["evidence"][key]
        c.say(file, change)


@kind(forges=True)
def frame_of_another_session_with_everything_fixed(c):
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
    c.forge()


@kind(forges=True)
def pixels_and_all_hashes_edited(c):
    """Exchanges two rows: statistics stay, hashes are computed again."""
    info = c.load()
    f = c.frame()
    form = info["form"]
    size = {"u8": 1, "u16": 2, "f32": 4}[form["sample"]] * form["channels"] * form["width"]
    data = bytearray(f.read_bytes())
    data[8:8 + 2 * size] = data[8 + size:8 + 2 * size] + data[8:8 + size]
    f.write_bytes(data)
    raw = c.folder.parent / "pixels.raw"
    pixels = PYTHON.read_tiff(bytes(data))[2]
    raw.write_bytes(pixels[:size * form["height"]])
    pixel_hash = run(TOOL, "hash", raw).strip()
    c.say(f, lambda said: said["evidence"].update(pixel_hash=pixel_hash))
    c.forge()


# --- session.json and start.json


def swap_lit(c):
    def change(info):
        one, two = c.two_lights(info)
        shots = info["shots"]
        shots[one]["lit"], shots[two]["lit"] = shots[two]["lit"], shots[one]["lit"]
    return change


def move_light(info):
    light = info["lights"][0]
    place = light["position_mm" if "position_mm" in light else "direction"]
    place[0], place[1] = -place[1] + 1e-3, place[0]


def swap_places(info):
    a, b = info["lights"][:2]
    a["position_mm"], b["position_mm"] = b["position_mm"], a["position_mm"]


def change_power(info):
    info["lights"][1]["relative_power"] = 1.01


def change_clip(info):
    info["form"]["clip_level"] = info["form"]["white_level"] - 500.0


def change_exposure(info):
    info["shots"][0]["exposure_us"] += 0.5


def change_kind(info):
    info["shots"][0]["kind"] = "sentinel" if info["shots"][0]["kind"] != "sentinel" else "light"


def change_levels(info):
    need([s for s in info["shots"] if s["lit"]])[0]["lit"][0][1] = 60000


def both_or_one(name, change, takes_case=False):
    def make(c):
        return change(c) if takes_case else change
    def in_session(c):
        c.edit(make(c), "session.json")
    def in_start(c):
        c.edit(make(c), "start.json")
    def in_both(c):
        c.edit(make(c))
    def in_both_resealed(c):
        c.edit(make(c))
        c.reseal()
    for function, where in ((in_session, "session_json"), (in_start, "start_json"), (in_both, "both"),
                            (in_both_resealed, "both_with_a_new_root")):
        function.__name__ = f"{name}_in_{where}"
        kind(function)  # what the frames, the plan and the rig say gives even the last one away


both_or_one("lit_swapped", swap_lit, takes_case=True)
both_or_one("light_moved", move_light)
both_or_one("places_swapped", swap_places)
both_or_one("power_changed", change_power)
both_or_one("clip_level_changed", change_clip)
both_or_one("exposure_changed", change_exposure)
both_or_one("kind_changed", change_kind)
both_or_one("drive_level_changed", change_levels)


@kind(forges=True)
def places_and_frames_and_root_changed(c):
    need(not c.path("rig.toml").exists())
    c.edit(swap_places)
    c.settle()


@kind(forges=True)
def power_and_frames_and_root_changed(c):
    need(not c.path("rig.toml").exists())
    c.edit(change_power)
    c.settle()


@kind(forges=True)
def lit_swapped_everywhere(c):
    need(c.path("rig.toml").exists())
    def change(info):
        swap_lit(c)(info)
    c.edit(change)
    plan = c.load("plan.json")
    plan["shots"] = [{k: s[k] for k in ("index", "kind", "exposure_us", "lit")} for s in c.load()["shots"]]
    c.path("plan.json").write_text(json.dumps(plan, separators=(",", ":")) + "\n")
    c.settle()


@kind(forges=True)
def date_changed_with_a_new_root(c):
    c.edit(lambda info: info.update(created="2019-01-01T00:00:00Z"))
    c.reseal()


@kind
def date_changed(c):
    c.edit(lambda info: info.update(created="2019-01-01T00:00:00Z"))


@kind
def stamp_changed_in_session_json(c):
    c.edit(lambda info: info["frames"][0]["evidence"].update(t_ack_ns=1), "session.json")


@kind(forges=True)
def verdict_changed_everywhere(c):
    c.say(c.frame(), lambda said: said["evidence"].update(verdict="saturated"))
    c.forge()


@kind(forges=True)
def temperature_changed_everywhere(c):
    c.say(c.frame(), lambda said: said["evidence"].update(temperature_c=20.5))
    c.forge()


def change_text(function):
    def wrapped(c):
        path = c.path("session.json")
        path.write_bytes(function(path.read_bytes()))
    wrapped.__name__ = function.__name__
    kind(wrapped)


@change_text
def key_doubled(text):
    return text.replace(b'{\n"schema": 1', b'{\n"grid_rows": 4,\n"schema": 1', 1)


@change_text
def unknown_field(text):
    return text.replace(b'{\n"schema": 1', b'{\n"note": "x",\n"schema": 1', 1)


@change_text
def byte_order_mark(text):
    return b"\xef\xbb\xbf" + text


@change_text
def key_in_capitals(text):
    return text.replace(b'"grid_rows"', b'"Grid_rows"', 1)


@change_text
def line_ends_of_dos(text):
    return text.replace(b"\n", b"\r\n")


@change_text
def written_anew_by_an_editor(text):
    return json.dumps(json.loads(text), indent=2).encode()


@change_text
def a_space_at_the_end(text):
    return text + b" "


@change_text
def root_of_zeros(text):
    return text[:-69] + b"0" * 64 + text[-5:]


@change_text
def session_json_cut(text):
    return text[:len(text) // 2]


@kind
def root_taken_away(c):
    c.edit(lambda info: (info.pop("root"), info.pop("files"), info.pop("made_by")), "session.json")


@kind(forges=True)
def made_an_old_session(c):
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
    c.forge()


@kind(forges=True)
def made_by_changed_with_a_new_root(c):
    c.edit(lambda info: info.update(made_by="rebuild" if info["made_by"] != "rebuild" else "capture"),
           "session.json")
    c.reseal()


@kind
def entry_of_files_taken_out(c):
    c.edit(lambda info: info["files"].pop(), "session.json")


@kind
def frames_leaf_changed(c):
    c.edit(lambda info: info["frames"][0].update(sha256="0" * 64), "session.json")


@kind
def last_shot_taken_out(c):
    c.edit(lambda info: (info["shots"].pop(), info["frames"] and info["frames"].pop()))
    c.reseal()


# --- plan and rig


@kind
def plan_edited(c):
    path = c.path("plan.json")
    path.write_bytes(path.read_bytes().replace(b"65535", b"65534", 1) + b" ")


@kind
def plan_edited_with_its_hash(c):
    if not c.path("rig.toml").exists():
        raise Skip
    plan = c.load("plan.json")
    need([s for s in plan["shots"] if s["lit"]])[0]["lit"][0][1] = 4000
    c.path("plan.json").write_text(json.dumps(plan, separators=(",", ":")) + "\n")
    c.forge()


@kind
def plan_missing(c):
    c.path("plan.json").unlink()


@kind
def plan_of_another_session(c):
    before = c.path("plan.json").read_bytes()
    shutil.copy(c.other / "plan.json", c.path("plan.json"))
    need(before != c.path("plan.json").read_bytes())


@kind
def rig_edited(c):
    path = c.path("rig.toml")
    need(path.exists())
    path.write_bytes(path.read_bytes().replace(b"900.0", b"901.0"))


@kind
def rig_edited_with_its_hash(c):
    path = c.path("rig.toml")
    need(path.exists())
    path.write_bytes(path.read_bytes().replace(b"pitch = 120.0", b"pitch = 121.0"))
    c.forge()


@kind(forges=True)
def rigs_comment_edited_with_its_hash(c):
    path = c.path("rig.toml")
    need(path.exists())
    path.write_bytes(path.read_bytes() + b"# nothing\n")
    c.forge()


@kind
def rig_missing(c):
    need(c.path("rig.toml").exists())
    c.path("rig.toml").unlink()


@kind
def start_missing(c):
    c.path("start.json").unlink()


@kind
def a_rig_appears(c):
    need(not c.path("rig.toml").exists())
    shutil.copy(RIG, c.path("rig.toml"))


# --- the journal


@kind
def event_deleted(c):
    need(c.sql("DELETE FROM events WHERE id = 1"))


@kind
def all_events_deleted(c):
    need(c.sql("DELETE FROM events"))


@kind
def last_event_deleted(c):
    need(c.sql("DELETE FROM events WHERE id = (SELECT max(id) FROM events)"))


@kind
def event_added(c):
    need(c.sql("INSERT INTO events (kind, json) VALUES ('state', '{}')"))


@kind
def event_edited(c):
    need(c.sql("UPDATE events SET json = '{\"reason\": \"nothing\"}' WHERE id = 1"))


@kind
def withdrawn_row_deleted(c):
    need(c.sql("DELETE FROM frames WHERE state = 'withdrawn'"))


@kind
def withdrawn_row_deleted_with_a_new_root(c):
    need(c.sql("DELETE FROM frames WHERE state = 'withdrawn'"))
    c.reseal()


@kind
def row_deleted(c):
    need(c.sql("DELETE FROM frames WHERE id = 1"))


@kind
def rows_state_changed(c):
    need(c.sql("UPDATE frames SET state = 'withdrawn' WHERE id = 2"))


@kind
def rows_evidence_edited(c):
    need(c.sql("UPDATE frames SET evidence = replace(evidence, '\"tag\":', '\"tag\": ') WHERE id = 1"))


@kind
def rows_exchanged(c):
    need(c.sql("UPDATE frames SET id = -1 WHERE id = 1", "UPDATE frames SET id = 1 WHERE id = 2",
               "UPDATE frames SET id = 2 WHERE id = -1"))


@kind
def table_added(c):
    c.sql("CREATE TABLE notes (text TEXT)")


@kind
def journal_missing(c):
    need(c.path("journal.sqlite").exists())
    c.path("journal.sqlite").unlink()


@kind
def journal_of_another_session(c):
    need(c.path("journal.sqlite").exists() and (c.other / "journal.sqlite").exists())
    shutil.copy(c.other / "journal.sqlite", c.path("journal.sqlite"))


@kind
def journal_cut(c):
    need(c.path("journal.sqlite").exists())
    os.truncate(c.path("journal.sqlite"), 4096)


@kind
def journal_not_closed(c):
    c.path("journal.sqlite-wal").write_bytes(b"x" * 32)


@kind(forges=True)
def event_edited_with_a_new_root(c):
    need(c.sql("UPDATE events SET kind = 'stated', json = '{}' WHERE kind = 'state'"))
    c.reseal()


# --- aside/


def any_aside(c):
    return c.chance.choice(need(sorted(p for p in c.path("aside").glob("*") if p.is_file())))


@kind
def note_in_aside_removed(c):
    any_aside(c).unlink()


@kind
def note_in_aside_edited(c):
    f = any_aside(c)
    f.write_bytes(f.read_bytes() + b"!")


@kind
def file_added_to_aside(c):
    c.path("aside").mkdir(exist_ok=True)
    c.path("aside/000000_a5.tif").write_bytes(b"x")


@kind(forges=True)
def aside_emptied_with_a_new_root(c):
    any_aside(c)
    shutil.rmtree(c.path("aside"))
    c.path("aside").mkdir()
    c.reseal()


# --- the signature


@kind(signature=True)
def signature_removed(c):
    c.path("session.json.sig").unlink()


@kind(signature=True)
def signature_of_another_session(c):
    shutil.copy(c.other / "session.json.sig", c.path("session.json.sig"))


@kind(signature=True)
def signature_cut(c):
    path = c.path("session.json.sig")
    path.write_bytes(path.read_bytes()[:120])


@kind(signature=True)
def signed_by_a_stranger_after_forging(c):
    c.say(c.frame(), lambda said: said["evidence"].update(temperature_c=20.5))
    c.forge()
    c.sign("stranger")


@kind(signature=True)
def signed_for_another_purpose(c):
    c.path("session.json.sig").unlink()
    run("ssh-keygen", "-q", "-Y", "sign", "-f", c.keys / "lab", "-n", "file", c.path("session.json"))


@kind(signature=True)
def rebuilt(c):
    run(TOOL, "rebuild", c.folder)


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
    """Of everything a person could see: kinds, links, bytes."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        target = os.readlink(path) if path.is_symlink() else ""
        data = path.read_bytes() if path.is_file() else b""
        digest.update(f"{path.relative_to(folder)} {path.lstat().st_mode} {target}".encode() + data)
    return digest.digest()


def main():
    seed = int(os.environ.get("HAARLIGHT_SEED", random.SystemRandom().randrange(2**31)))
    n_tamperings = int(os.environ.get("HAARLIGHT_TAMPERINGS", len(KINDS)))
    n_undisturbed = int(os.environ.get("HAARLIGHT_UNDISTURBED", 12))
    print(f"HAARLIGHT_SEED={seed}: {n_tamperings} tamperings of {len(KINDS)} kinds, "
          f"{n_undisturbed} undisturbed sessions", flush=True)
    chance = random.Random(seed)
    failures = []
    base = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(prefix="haarlight_tamper_", dir=base) as place:
        place = pathlib.Path(place)
        keys = place / "keys"
        keys.mkdir()
        for who in ("lab", "stranger"):
            run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", who, "-f", keys / who)
        signers = keys / "allowed_signers"
        signers.write_text(f"lab@example.org {(keys / 'lab.pub').read_text()}")
        run(TOOL, "make", seed, n_undisturbed, place / "whole", RIG)
        whole = [place / "whole" / str(i) for i in range(n_undisturbed)]
        for when in ("unsigned", "signed"):
            asked = signers if when == "signed" else ""
            for folder, ours in zip(whole, by_ours(whole, asked)):
                for who, problems in (("verify", ours), ("verify_session.py", by_python(folder, asked))):
                    if problems:
                        failures.append(f"false alarm: {when} {folder.name} by {who}: {problems[:3]}")
            if when == "unsigned":
                for folder in whole:
                    Case(folder, None, chance, keys).sign()
        cases = []  # name, forges, signature, signed copy, unsigned copy
        for i in range(n_tamperings):
            name, function, forges, signature = KINDS[i % len(KINDS)]
            for _ in range(200):
                original, other = chance.sample(whole, 2)
                folder = place / "work" / str(i)
                shutil.rmtree(folder, ignore_errors=True)
                shutil.copytree(original, folder)
                state = chance.getstate()
                try:
                    function(Case(folder, other, chance, keys))
                except (Skip, IndexError, KeyError):
                    chance.setstate(state)
                    chance.random()
                    continue
                if fingerprint(folder) != fingerprint(original):
                    break
            else:
                failures.append(f"{name}: no session of this campaign can be tampered with so")
                continue
            cases.append((name, forges, signature, folder))
        found = collections.defaultdict(lambda: [0, 0, 0])
        ours = by_ours([folder for *_, folder in cases], signers)
        for (name, _, _, folder), problems in zip(cases, ours):
            for who, said in (("verify", problems), ("verify_session.py", by_python(folder, signers))):
                if not said:
                    failures.append(f"missed: signed, {name} ({folder.name}) by {who}")
        plain = [case for case in cases if not case[2]]
        for *_, folder in plain:
            (folder / "session.json.sig").unlink(missing_ok=True)
        ours = by_ours([folder for *_, folder in plain], "")
        for (name, forges, _, folder), problems in zip(plain, ours):
            theirs = by_python(folder, "")
            row = found[name]
            row[0] += 1
            row[1] += bool(problems)
            row[2] += bool(theirs)
            for who, said in (("verify", problems), ("verify_session.py", theirs)):
                if not forges and not said:
                    failures.append(f"missed: unsigned, {name} ({folder.name}) by {who}")
        n = [sum(row[i] for row in found.values()) for i in range(3)]
        print(f"signed: {len(cases)} tamperings, missed by one of the two: "
              f"{sum(f.startswith('missed: signed') for f in failures)}")
        print(f"unsigned: {n[0]} tamperings, found {n[1]} by verify, {n[2]} by verify_session.py; "
              "not always found:")
        for name, (total, first, second) in sorted(found.items()):
            if min(first, second) < total:
                print(f"    {name}: {total} times, found {first} and {second}")
        if os.environ.get("HAARLIGHT_KEEP"):
            shutil.copytree(place, os.environ["HAARLIGHT_KEEP"], symlinks=True, dirs_exist_ok=True)
    print("\n".join(failures))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
