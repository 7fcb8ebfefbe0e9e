#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The daemon as a service: what it tells the service manager, that every end of it leaves the rig
dark, that its metrics are Prometheus text, and that what is installed is whole.
service_test.py BUILD, the build's folder."""

import math
import os
import pathlib
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

from programs import SOURCE, Programs, free_port, rig_on_free_ports, wait_for

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
RIG = SOURCE / "configs/rigs/small8.toml"
SCENE = SOURCE / "configs/scenes/blocks.toml"
LONG_PLAN = 'schema = 1\nname = "long"\npatterns = "one_at_a_time"\nrepeats = 100\n'
LONG_LEASE_MS = 60000  # so long that a dark rig is never the lease's work
EXPOSURE_LIMIT = 2.5   # of systemd-analyze security: 0 is a cell, 10 an open door


class Rig:
    """The simulator and a daemon that speaks to a service manager of our own."""

    def __init__(self, programs, lease_ms):
        self.programs = programs
        self.place = tempfile.TemporaryDirectory(prefix="haarlight-service.")
        self.folder = pathlib.Path(self.place.name)
        self.port = free_port()
        self.rig = self.folder / "rig.toml"
        rig_on_free_ports(RIG, self.rig, self.folder, self.port, [("lease_ms", str(lease_ms))])
        host, port = re.search(r"(127\.0\.0\.1):(\d+)", self.rig.read_text()).groups()
        self.bus = (host, int(port))
        self.url = f"http://127.0.0.1:{self.port}"
        ready = self.folder / "ready"
        self.sim = subprocess.Popen(
            [programs.sim, self.rig, "--scene", SCENE, "--ready-file", ready, "--quiet",
             "--cache", BUILD / "page-test/cache"], stdout=subprocess.DEVNULL)
        wait_for(ready.exists, 120, "the simulator")
        self.manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.manager.bind(str(self.folder / "notify"))
        self.manager.settimeout(20)
        self.daemon = None

    def begin(self):
        environment = {**os.environ, "NOTIFY_SOCKET": str(self.folder / "notify"),
                       "WATCHDOG_USEC": "2000000"}
        self.daemon = subprocess.Popen([self.programs.daemon, self.rig], env=environment,
                                       stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        return self

    def told(self):
        return self.manager.recv(4096).decode()

    def run_long(self):
        request = urllib.request.Request(self.url + "/v1/run", data=LONG_PLAN.encode())
        urllib.request.urlopen(request, timeout=10).close()
        wait_for(lambda: '"phase":"running"' in self.get("/v1/state") and self.n_lit() > 0, 30,
                 "a light to burn")

    def get(self, path):
        with urllib.request.urlopen(self.url + path, timeout=10) as answer:
            return answer.read().decode()

    def n_lit(self):
        """Asks the controller itself, over Modbus: discrete inputs `lit` of 64 elements."""
        with socket.create_connection(self.bus, timeout=5) as bus:
            bus.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 2, 0, 64))
            answer = b""
            while len(answer) < 9 + 8:
                piece = bus.recv(64)
                assert piece, f"the controller said {answer.hex()}"
                answer += piece
        assert answer[7] == 2, answer.hex()
        return sum(byte.bit_count() for byte in answer[9:])

    def end(self):
        for process in (self.daemon, self.sim):
            if process and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
                process.wait(timeout=40)
        if self.daemon:
            self.daemon.stderr.close()
        self.manager.close()
        self.place.cleanup()


def metric_problems(text):
    """What breaks the rules of the text format, version 0.0.4; empty when all is well."""
    problems, types, series, families_left = [], {}, {}, set()
    current = None
    if not text.endswith("\n"):
        problems.append("the last line has no end")
    for line in text.splitlines():
        if line.startswith("#"):
            match = re.fullmatch(r"# (HELP|TYPE) ([a-zA-Z_:][a-zA-Z0-9_:]*) (.+)", line)
            if not match:
                problems.append(f"not a comment of the format: {line}")
                continue
            word, name, rest = match.groups()
            if name != current:
                if name in families_left:
                    problems.append(f"{name} comes in two places")
                families_left.add(name)
                current = name
            if word == "TYPE":
                if name in types:
                    problems.append(f"{name} has two types")
                types[name] = rest
                if rest not in ("counter", "gauge", "histogram"):
                    problems.append(f"{name} is a {rest}")
                if rest == "counter" and not name.endswith("_total"):
                    problems.append(f"the counter {name} does not end in _total")
            continue
        match = re.fullmatch(r"([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})? (\S+)", line)
        if not match:
            problems.append(f"not a sample: {line}")
            continue
        name, labels, value = match.group(1), match.group(2) or "", match.group(3)
        if labels and not re.fullmatch(r'(?:[a-zA-Z_]\w*="(?:[^"\\]|\\.)*",?)+', labels):
            problems.append(f"labels: {line}")
        family = name if name in types else re.sub(r"_(bucket|sum|count)$", "", name)
        if family != current or family not in types:
            problems.append(f"{name} stands outside its family")
        if (name, labels) in series:
            problems.append(f"{name}{{{labels}}} twice")
        number = float(value.replace("+Inf", "inf"))
        series[name, labels] = number
        if types.get(family) != "gauge" and not (number >= 0 and math.isfinite(number)):
            problems.append(f"{line}: a count is finite and not negative")
    for name in [n for n, kind in types.items() if kind == "histogram"]:
        buckets = [(float(re.fullmatch(r'le="(.*)"', labels)[1].replace("+Inf", "inf")), value)
                   for (metric, labels), value in series.items() if metric == name + "_bucket"]
        if buckets != sorted(buckets) or [v for _, v in buckets] != sorted(v for _, v in buckets):
            problems.append(f"{name}: classes do not ascend")
        if not buckets or buckets[-1][0] != math.inf:
            problems.append(f"{name} has no class +Inf")
        elif buckets[-1][1] != series.get((name + "_count", "")):
            problems.append(f"{name}: +Inf is not the count")
    return problems, types, series


class Service(unittest.TestCase):
    def setUp(self):
        self.programs = Programs(BUILD / "apps")
        self.rig = None

    def tearDown(self):
        if self.rig:
            self.rig.end()

    def start(self, lease_ms=LONG_LEASE_MS):
        self.rig = Rig(self.programs, lease_ms).begin()
        self.assertEqual(self.rig.told(), "READY=1")
        return self.rig

    def test_the_manager_hears_ready_watchdog_and_stopping(self):
        rig = self.start()
        begun = time.monotonic()
        for _ in range(5):
            self.assertEqual(rig.told(), "WATCHDOG=1")
        fed_s = (time.monotonic() - begun) / 5
        self.assertLess(fed_s, 1.0, "half of the shortest sensible WatchdogSec")
        rig.run_long()
        rig.daemon.terminate()
        while (told := rig.told()) != "STOPPING=1":
            self.assertEqual(told, "WATCHDOG=1")
        self.assertEqual(rig.daemon.wait(timeout=30), 0)
        self.assertEqual(rig.n_lit(), 0, "an asked end leaves the rig dark")
        print(f"watchdog fed every {fed_s:.2f} s", file=sys.stderr)

    def test_the_stop_action_darkens_after_sigkill_long_before_the_lease(self):
        rig = self.start()
        rig.run_long()
        rig.daemon.kill()
        rig.daemon.wait()
        self.assertGreater(rig.n_lit(), 0, "SIGKILL leaves a light on: what follows must see to it")
        begun = time.monotonic()
        done = subprocess.run([self.programs.daemon, rig.rig, "--all-off"], capture_output=True,
                              text=True, timeout=20)
        took_s = time.monotonic() - begun
        self.assertEqual((done.returncode, done.stdout), (0, "all lights off\n"), done.stderr)
        self.assertEqual(rig.n_lit(), 0)
        print(f"--all-off: {1000 * took_s:.0f} ms from start to end", file=sys.stderr)

    def test_a_stopped_process_darkens_within_the_lease(self):
        rig = self.start(lease_ms=1000)
        rig.run_long()
        rig.daemon.send_signal(signal.SIGSTOP)
        begun = time.monotonic()
        wait_for(lambda: rig.n_lit() == 0, 10, "the controller to go dark by itself")
        took_s = time.monotonic() - begun
        self.assertLess(took_s, 1.0 + 1.0)  # the lease, and this machine's load
        rig.manager.setblocking(False)
        while True:  # what was fed before the stop
            try:
                rig.manager.recv(4096)
            except BlockingIOError:
                break
        time.sleep(1.0)
        with self.assertRaises(BlockingIOError):
            rig.manager.recv(4096)  # not fed: the manager would end it
        print(f"SIGSTOP: dark after {took_s:.2f} s with a lease of 1 s", file=sys.stderr)

    def test_all_off_without_a_controller_says_so(self):
        with tempfile.TemporaryDirectory() as place:
            rig = pathlib.Path(place) / "rig.toml"
            rig_on_free_ports(RIG, rig, place, free_port())
            done = subprocess.run([self.programs.daemon, rig, "--all-off"], capture_output=True,
                                  text=True, timeout=20)
        self.assertEqual(done.returncode, 69)
        self.assertRegex(done.stderr, r"not turned off(.|\n)*hint: .*lease")

    def test_metrics_are_prometheus_text_and_count_what_happened(self):
        rig = self.start()
        self.assertEqual(metric_problems(rig.get("/metrics"))[0], [])
        rig.run_long()
        wait_for(lambda: int(re.search(r'"committed":(\d+)', rig.get("/v1/state"))[1]) > 30, 60,
                 "some shots")
        problems, types, series = metric_problems(rig.get("/metrics"))
        self.assertEqual(problems, [])
        histograms = {name for name, kind in types.items() if kind == "histogram"}
        self.assertLessEqual({"haarlight_margin_seconds", "haarlight_latch_seconds",
                              "haarlight_frame_arrival_seconds", "haarlight_shot_seconds",
                              "haarlight_commit_seconds"}, histograms)
        for name in ("haarlight_frames_total", "haarlight_sequence_gaps_total",
                     "haarlight_retries_total", "haarlight_event_lines_dropped_total"):
            self.assertIn((name, ""), series)
        self.assertGreater(series["haarlight_commits_total", ""], 30)
        for name in sorted(histograms):
            n, total = series[name + "_count", ""], series[name + "_sum", ""]
            self.assertGreater(n, 30, name)
            self.assertLess(total / n, 5.0, f"{name} is in seconds")
            print(f"{name}: {n:.0f}, mean {1000 * total / n:.2f} ms", file=sys.stderr)
        self.assertGreaterEqual(series["haarlight_margin_seconds_count", ""],
                                series["haarlight_commits_total", ""])

    def test_what_is_installed_is_whole(self):
        with tempfile.TemporaryDirectory(prefix="haarlight-install.") as place:
            self.check_installed(pathlib.Path(place))

    def check_installed(self, prefix):
        done = subprocess.run(["cmake", "--install", BUILD, "--prefix", prefix],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        for name in ("bin/haarlight", "bin/haarlightd", "bin/haarlight-sim",
                     "share/haarlight/web/index.html", "share/haarlight/web/main.js",
                     "share/haarlight/web/viewer/index.html", "share/haarlight/web/viewer/main.js",
                     "share/haarlight/rigs/cube32.toml", "share/haarlight/plans/quick.toml",
                     "share/haarlight/scenes/airplane.toml", "share/haarlight/environments/room.hdr",
                     "share/man/man1/haarlight.1", "share/man/man1/haarlight-relight.1",
                     "share/man/man1/haarlight-sim.1", "share/man/man8/haarlightd.8",
                     "lib/sysusers.d/haarlight.conf"):
            self.assertTrue((prefix / name).is_file(), name)
        self.assertNotIn("@", (prefix / "share/man/man8/haarlightd.8").read_text())
        # Plans, scenes and environments name each other as they lie there.
        share = prefix / "share/haarlight"
        files = [str(file) for kind in ("rigs", "plans", "scenes", "environments")
                 for file in sorted((share / kind).iterdir()) if file.suffix in (".toml", ".hdr")]
        checked = subprocess.run([prefix / "bin/haarlight", "check", *files], capture_output=True,
                                 text=True)
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        for plan in sorted((share / "plans").iterdir()):
            planned = subprocess.run([prefix / "bin/haarlight", "plan", share / "rigs/cube32.toml", plan,
                                      "--dry-run"], capture_output=True, text=True)
            self.assertEqual(planned.returncode, 0, f"{plan}: {planned.stderr}")
        unit = prefix / "lib/systemd/system/haarlightd.service"
        self.assertNotRegex(unit.read_text(), "@[A-Z]+@")
        self.assertIn(f"ExecStopPost={prefix}/bin/haarlightd", unit.read_text())
        # The installed daemon finds its page beside itself.
        rig = prefix / "rig.toml"
        port = free_port()
        rig_on_free_ports(RIG, rig, prefix, port)
        daemon = subprocess.Popen([prefix / "bin/haarlightd", rig], stdout=subprocess.PIPE)
        try:
            daemon.stdout.readline()
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as page:
                self.assertIn("<title>haarlight</title>", page.read().decode())
        finally:
            daemon.terminate()
            self.assertEqual(daemon.wait(timeout=30), 0)
            daemon.stdout.close()
        if not shutil.which("systemd-analyze"):
            self.skipTest("systemd-analyze is not installed: the unit was not verified")
        verified = subprocess.run(["systemd-analyze", "verify", "--man=no", unit],
                                  capture_output=True, text=True)
        about_us = [line for line in verified.stderr.splitlines() if "haarlight" in line]
        self.assertEqual((verified.returncode, about_us), (0, []), verified.stderr)
        rated = subprocess.run(["systemd-analyze", "security", "--offline=yes", "--no-pager", unit],
                               capture_output=True, text=True)
        match = re.search(r"exposure level for \S+: ([\d.]+)", rated.stdout)
        self.assertIsNotNone(match, rated.stdout + rated.stderr)
        self.assertLessEqual(float(match[1]), EXPOSURE_LIMIT, rated.stdout)
        print(f"systemd-analyze security: {match[1]}", file=sys.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
