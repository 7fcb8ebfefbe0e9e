#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the real daemon on a small file system of its own (tmpfs, needs root) that is too small, then
fills up in mid-run, then is full at the daemon's start after a SIGKILL. A plan that does not fit is
refused before a light is lit; a full disk suspends; the finished session equals an undisturbed one.

    scripts/full_disk_test.py [--bin build/release/apps]

Exit code 0 when nothing was lost, 77 when no tmpfs can be mounted."""

import argparse
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from kill_test import HERE, Rig, differences, essence, wait_for  # noqa: E402

MEGABYTE = 1 << 20


def mount(sessions, megabytes, *more):
    return subprocess.run(["mount", "-t", "tmpfs", "-o", ",".join((f"size={megabytes}m", *more)), "tmpfs",
                           sessions], stderr=subprocess.DEVNULL, check=False).returncode == 0


def fill(folder):
    """Takes every free block."""
    with open(folder / "filler", "wb", buffering=0) as file:
        for size in (MEGABYTE, 4096):
            try:
                while file.write(bytes(size)) == size:
                    pass
            except OSError:
                pass


def expect(condition, what):
    if not condition:
        sys.exit("FAILED: " + what)


def capture(rig, plan):
    rig.start()
    wait_for(lambda: rig.state()["phase"] == "idle", 30)
    session = rig.begin(plan)
    wait_for(lambda: rig.state()["phase"] == "done", 600)
    return essence(rig.folder / "sessions" / session)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bin", default=str(HERE / "build/release/apps"))
    parser.add_argument("--rig", default="configs/rigs/small8.toml")
    parser.add_argument("--scene", default="configs/scenes/blocks.toml")
    parser.add_argument("--plan", default="configs/plans/quick.toml")
    args = parser.parse_args()
    args.more = ["--doubtful-us", "30000"]  # as in kill_test.py
    args.reserve_mb = 0.0
    folder = pathlib.Path(tempfile.mkdtemp(prefix="haarlight-full."))
    sessions = folder / "sessions"
    sessions.mkdir()
    plan = (HERE / args.plan).read_bytes()
    rig = Rig(args, folder)
    is_mounted = False
    try:
        truth = capture(rig, plan)
        rig.kill()
        is_mounted = mount(sessions, 1)
        if not is_mounted:
            print("skipped: no tmpfs can be mounted here")
            return 77
        fill(sessions)
        rig.start()
        wait_for(lambda: rig.state()["phase"] == "idle", 30)
        rig.ask("/v1/run", plan)
        wait_for(lambda: not rig.state()["is_opening"], 30)
        expect(rig.state()["phase"] == "idle", "a plan that does not fit was begun")
        print("refused before a light was lit:", rig.state()["reason"])
        (sessions / "filler").unlink()
        mount(sessions, 8, "remount")

        session = rig.begin(plan)
        wait_for(lambda: rig.state()["session"] == session and rig.state()["committed"] >= 10, 60)
        (sessions / session / "reserve.bin").unlink(missing_ok=True)
        fill(sessions)
        wait_for(lambda: rig.state()["phase"] == "suspended", 60)
        expect(rig.state()["reasons"] == ["disk"], "suspended for " + str(rig.state()["reasons"]))
        at = rig.state()["committed"]
        rig.kill()
        rig.start()
        wait_for(lambda: rig.state().get("is_opening") or rig.state()["phase"] == "suspended", 30)
        os.truncate(sessions / "filler", 0)
        wait_for(lambda: rig.state()["phase"] == "done", 60)
        found = differences(truth, essence(sessions / session))
        print(f"full and killed at {at} of {len(truth['frames'])} committed; {len(found)} differences")
        for line in found[:20]:
            print(line)
        return 1 if found else 0
    finally:
        rig.end()
        if is_mounted:
            subprocess.run(["umount", sessions], check=False)
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
