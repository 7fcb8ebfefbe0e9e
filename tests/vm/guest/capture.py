# SPDX-License-Identifier: Apache-2.0
"""Whole captures through the kernel's video layer: the simulated camera writes its frames into vivid's
output node, vivid hands them on by its own clock (some twice, some not at all), the daemon reads
the capture node. The light goes by Modbus TCP. Three runs: a good one, a careless one whose rig
file trusts vivid's timestamps, a rough one in which vivid misbehaves."""

import subprocess

import lab as common
from lab import WORK, Failed, say, wait_for

OUTPUT, CAPTURE = "/dev/video1", "/dev/video0"

# vivid's own faults, each after eight more shots: a buffer marked as broken, a broken stream, one
# that cannot be started again at once, all nodes gone.
ROUGH = ["inject_v4l2_buf_flag_error=1", "inject_fatal_streaming_error=1",
         "inject_vidioc_streamon_error=1,inject_fatal_streaming_error=1", "disconnect=1"]


def run(lab, name, rig, plan, meanwhile=None):
    """A session with a daemon of its own; sessions and daemon.log stay under `name`."""
    say(name)
    lab.start_daemon(rig)
    lab.begin(plan)
    if meanwhile:
        meanwhile(lab)
    seconds = lab.wait_until_done(3600)
    state, counters = lab.state(), lab.counters()
    code = lab.stop("daemon")
    (WORK / "sessions").rename(WORK / name)
    (WORK / "daemon.log").rename(WORK / f"{name}.daemon.log")
    lab.keep(name, f"{name}.daemon.log")
    if state["committed"] != state["shots"]:
        raise Failed(f"{name}: session not complete: {state}")
    if code != 0:
        raise Failed(f"{name}: the daemon ended with {code}")
    return {"seconds": seconds, "counters": counters}


def be_rough(lab):
    for control in ROUGH:
        next_at = lab.state()["committed"] + 8
        wait_for(lambda: lab.state()["committed"] >= next_at, 600, f"{next_at} shots")
        say("vivid:", control)
        subprocess.run(["v4l2-ctl", "-d", CAPTURE, "-c", control], check=True)


def scenario(lab):
    for node in (OUTPUT, CAPTURE):
        # 640 x 480 at 59.94 a second: the pace; frames are smaller.
        subprocess.run(["v4l2-ctl", "-d", node, "--set-dv-bt-timings", "index=0"], check=True)
    lab.warm()
    lab.start_sim("--v4l2-output", OUTPUT, "--record", WORK / "record")
    return {"good": run(lab, "good", "rig.toml", "plan.toml"),
            "careless": run(lab, "careless", "careless.toml", "short_plan.toml"),
            "rough": run(lab, "rough", "rig.toml", "short_plan.toml", be_rough)}


if __name__ == "__main__":
    common.main(scenario)
