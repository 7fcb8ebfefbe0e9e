# SPDX-License-Identifier: Apache-2.0
"""What the scenarios share inside the machine: programs, the daemon's interface, the cables.
Python's own library only."""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

JOB = pathlib.Path("/mnt")            # shared with the host
WORK = pathlib.Path("/dev/shm/work")  # the machine's memory


def say(*words):
    print(f"{time.monotonic():9.3f}", *words, flush=True)


class Failed(Exception):
    pass


def wait_for(condition, seconds, what, pause=0.02):
    """@return seconds waited"""
    begin = time.monotonic()
    while not condition():
        if time.monotonic() - begin > seconds:
            raise Failed(f"waited {seconds} s for {what}")
        time.sleep(pause)
    return time.monotonic() - begin


def start_udev():
    """Device names such as /dev/serial/by-id, and libusb's news of cables, come from udev."""
    subprocess.run(["/lib/systemd/systemd-udevd", "--daemon"], check=True)
    subprocess.run(["udevadm", "trigger", "--type=devices", "--action=add", "--subsystem-match=usb",
                    "--subsystem-match=tty", "--subsystem-match=virtio-ports",
                    "--subsystem-match=video4linux"], check=True)
    subprocess.run(["udevadm", "settle", "--timeout=60"], check=False)


class Hands:
    """Plugs and unplugs: QEMU's monitor, led back into the machine by a virtio port."""

    def __init__(self):
        port = pathlib.Path("/dev/virtio-ports/hands")
        wait_for(port.exists, 30, str(port))
        self.port = open(port, "r+b", buffering=0)

    def do(self, line):
        say("hands:", line)
        self.port.write(line.encode() + b"\n")


class Lab:
    """The simulator and the daemon, as a lab would start them."""

    def __init__(self, job):
        self.job = job
        self.bin = pathlib.Path(job["bin"])
        self.sim_program = self.bin / "haarlight-sim/haarlight-sim"
        self.daemon_program = self.bin / "haarlightd/haarlightd"
        self.processes = {}
        self.url = f"http://127.0.0.1:{job['port']}"
        WORK.mkdir(parents=True, exist_ok=True)

    def warm(self):
        """Reads programs and libraries once: later nothing waits for the host's disk."""
        files = set()
        for program in (self.sim_program, self.daemon_program):
            files.add(str(program))
            for line in subprocess.run(["ldd", program], capture_output=True, text=True,
                                       check=True).stdout.splitlines():
                files.update(word for word in line.split() if word.startswith("/"))
        for file in files:
            with open(file, "rb") as source:
                while source.read(1 << 20):
                    pass

    def start(self, name, *words):
        say("start", name)
        with open(WORK / f"{name}.log", "ab") as log:
            self.processes[name] = subprocess.Popen(list(map(str, words)), stdout=log, stderr=log,
                                                    cwd=WORK)

    def start_sim(self, *more):
        ready = WORK / "ready"
        self.start("sim", self.sim_program, JOB / "twin.toml", "--scene", self.job["scene"], "--cache",
                   self.job["cache"], "--ready-file", ready, *more)
        wait_for(lambda: ready.exists() or self.has_ended("sim"), 120, "the simulator")
        self.must_run("sim")

    def start_daemon(self, rig="rig.toml", seconds=60):
        self.start("daemon", self.daemon_program, JOB / rig, "--sessions", WORK / "sessions")
        wait_for(lambda: self.state()["phase"] == "idle" or self.has_ended("daemon"), seconds,
                 "an idle daemon")
        self.must_run("daemon")

    def has_ended(self, name):
        return self.processes[name].poll() is not None

    def must_run(self, name):
        if self.has_ended(name):
            raise Failed(f"{name} ended with {self.processes[name].returncode}")

    def ask(self, path, body=None):
        request = urllib.request.Request(self.url + path, data=body)
        with urllib.request.urlopen(request, timeout=20) as reply:
            return json.load(reply)

    def state(self):
        try:
            return self.ask("/v1/state")
        except (urllib.error.URLError, OSError):
            return {"phase": "away", "committed": 0, "shots": 0}

    def counters(self):
        with urllib.request.urlopen(self.url + "/metrics", timeout=20) as reply:
            lines = reply.read().decode().splitlines()
        return {line.split()[0].removeprefix("haarlight_"): float(line.split()[1]) for line in lines
                if line.startswith("haarlight_") and "{" not in line}

    def begin(self, plan="plan.toml"):
        session = self.ask("/v1/run", (JOB / plan).read_bytes())["session"]
        say("session", session)
        return session

    def wait_until_done(self, seconds):
        def is_done():
            self.must_run("daemon")
            self.must_run("sim")
            return self.state()["phase"] == "done"
        waited = wait_for(is_done, seconds, "the end of the session", 0.5)
        say(f"done after {waited:.1f} s")
        return waited

    def keep(self, *names):
        """Copies out of the machine's memory."""
        for name in names:
            source = WORK / name
            if source.is_dir():
                shutil.copytree(source, JOB / name, dirs_exist_ok=True)
            elif source.exists():
                shutil.copyfile(source, JOB / name)

    def stop(self, name):
        """Asks a program to end; it must do so cleanly. @return its exit code"""
        process = self.processes.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            return process.wait(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            return "nothing: it had to be killed"


def main(scenario):
    """Runs scenario(lab) -> figures; all that is known goes to result.json, whatever happens."""
    job = json.loads((JOB / "job.json").read_text())
    lab = Lab(job)
    result = {"failed": []}
    try:
        result.update(scenario(lab))
    except Failed as reason:
        result["failed"].append(str(reason))
        say("FAILED:", reason)
        say("state:", json.dumps(lab.state()))
    for name in ("daemon", "sim"):
        code = lab.stop(name) if name in lab.processes else 0
        if code != 0:
            result["failed"].append(f"{name} ended with {code}")
    lab.keep("sim.log", "daemon.log", "sessions", "record")
    (JOB / "result.json").write_text(json.dumps(result, indent=1))
    os.sync()
    sys.exit(1 if result["failed"] else 0)
