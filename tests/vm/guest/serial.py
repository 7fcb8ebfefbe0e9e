# SPDX-License-Identifier: Apache-2.0
"""A whole capture with the controller on a serial line: the daemon speaks Modbus RTU to a USB-serial
adapter (ftdi_sio), found by its name under /dev/serial/by-id; a null-modem cable leads to the
machine's own UART (8250), where the simulated controller listens. In the middle the adapter is
pulled out and put in again."""

import pathlib
import subprocess
import sys
import time

import lab as common
from lab import WORK, Failed, Hands, say, wait_for


def scenario(lab):
    common.start_udev()
    hands = Hands()
    adapter = pathlib.Path(lab.job["adapter"])
    wait_for(adapter.exists, 60, f"{adapter} (udev's name for the adapter)")
    first_node = adapter.resolve()
    say(adapter, "is", first_node)
    lab.start_sim()
    pty = (WORK / "controller").resolve()
    lab.start("bridge", sys.executable, pathlib.Path(__file__).with_name("bridge.py"), pty,
              "/dev/ttyS2")
    lab.start_daemon()
    lab.begin()
    wait_for(lambda: lab.state()["committed"] >= lab.job["unplug_after"], 120, "the first frames", 0.05)
    before = lab.state()["committed"]

    hands.do("device_del adapter")
    out_at = time.monotonic()
    wait_for(lambda: lab.state()["phase"] == "suspended", 20, "the daemon to be suspended", 0.01)
    suspended_s = time.monotonic() - out_at
    say(f"suspended after {suspended_s:.3f} s:", lab.state())
    wait_for(lambda: not adapter.exists(), 20, "udev to take the name away")
    at_rest = lab.state()["committed"]
    time.sleep(1.0)
    hands.do(lab.job["replug"])
    in_at = time.monotonic()
    wait_for(adapter.exists, 60, "udev to give the name back")
    say(adapter, "is", adapter.resolve(), f"{time.monotonic() - in_at:.3f} s after it was put in")
    wait_for(lambda: lab.state()["phase"] in ("running", "finalise", "done"), 60, "the daemon to go on")
    resumed_s = time.monotonic() - in_at
    say(f"goes on {resumed_s:.3f} s after the adapter was put in")
    lab.wait_until_done(240)
    if lab.state()["committed"] != lab.state()["shots"]:
        raise Failed(f"session not complete: {lab.state()}")
    return {"first_node": str(first_node), "second_node": str(adapter.resolve()),
            "committed_before": before, "committed_at_rest": at_rest, "suspended_s": suspended_s,
            "resumed_s": resumed_s, "counters": lab.counters()}


if __name__ == "__main__":
    common.main(scenario)
