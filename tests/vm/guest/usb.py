# SPDX-License-Identifier: Apache-2.0
"""A whole capture with the controller on USB: xhci, usbfs, libusb and udev are real; the device is the
simulator's, which reaches QEMU's usb-redir by a port of the machine. In the middle it is pulled out
and put in again."""

import os
import pathlib
import time

import lab as common
from lab import WORK, Failed, say, wait_for


def is_there(serial):
    return any(file.read_text().strip() == serial
               for file in pathlib.Path("/sys/bus/usb/devices").glob("*/serial"))


def scenario(lab):
    common.start_udev()
    port, serial = pathlib.Path("/dev/virtio-ports/light"), lab.job["serial"]
    wait_for(port.exists, 60, str(port))
    commands = WORK / "commands"
    os.mkfifo(commands)
    lab.start_sim("--usb-redir", port.resolve(), "--commands", commands)
    wait_for(lambda: is_there(serial), 60, "the kernel to see the device")
    say("the kernel sees the device", serial)
    lab.start_daemon()
    lab.begin()
    wait_for(lambda: lab.state()["committed"] >= lab.job["unplug_after"], 120, "the first frames", 0.05)

    say("unplug")
    commands.write_text("unplug\n")
    out_at = time.monotonic()
    wait_for(lambda: lab.state()["phase"] == "suspended", 20, "the daemon to be suspended", 0.01)
    suspended_s = time.monotonic() - out_at
    say(f"suspended after {suspended_s:.3f} s:", lab.state())
    wait_for(lambda: not is_there(serial), 20, "the kernel to forget the device")
    at_rest = lab.state()["committed"]
    time.sleep(1.0)
    say("replug")
    commands.write_text("replug\n")
    in_at = time.monotonic()
    wait_for(lambda: lab.state()["phase"] in ("running", "finalise", "done"), 60, "the daemon to go on")
    resumed_s = time.monotonic() - in_at
    say(f"goes on {resumed_s:.3f} s after the device was put in")
    lab.wait_until_done(240)
    if lab.state()["committed"] != lab.state()["shots"]:
        raise Failed(f"session not complete: {lab.state()}")
    return {"committed_at_rest": at_rest, "suspended_s": suspended_s, "resumed_s": resumed_s,
            "counters": lab.counters()}


if __name__ == "__main__":
    common.main(scenario)
