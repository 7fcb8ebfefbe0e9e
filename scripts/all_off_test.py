#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Holds the real daemon to its promise: all-off is answered within 100 ms (99 of 100), and its page
gets through, while clients that mean harm, or only a plan too large, keep it busy all at once:

  * dry runs of 256 000 shots, one after the other from several clients, one of which types;
  * lists and maps of that plan's session;
  * idle connections that are opened again as soon as they are closed;
  * connections that send a header, or a body, a byte at a time;
  * event listeners that never read.

Then all lights are turned off in mid-capture: how long until the simulated controller is dark.

    scripts/all_off_test.py [--idle 10000] [--slow 600] [--samples 300] [--seed N] [--bin DIR]

Exit code 0 when every promise holds. The seed is drawn and printed."""

import argparse
import multiprocessing
import pathlib
import random
import resource
import shutil
import socket
import sys
import tempfile
import threading
import time

from kill_test import HERE, Rig, wait_for

PLAN = b'schema = 1\nname = "%d"\npatterns = "one_at_a_time"\nrepeats = %d\n'
PROMISE_MS = 100.0


def request(port, method, path, body=b"", patience=30.0):
    """Status and seconds; status 0 when the connection was closed before an answer."""
    begin = time.monotonic()
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=patience) as s:
            s.sendall(b"%s %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
                      b"Content-Length: %d\r\n\r\n" % (method, path, len(body)) + body)
            answer = b""
            while True:
                part = s.recv(1 << 16)
                if not part:
                    break
                answer += part
        return int(answer[9:12] or 0), time.monotonic() - begin
    except (OSError, ValueError):
        return 0, time.monotonic() - begin


class Attackers:
    def __init__(self, port, args, dice):
        self.port, self.args, self.dice = port, args, dice
        self.is_over = threading.Event()
        self.count = {}
        self.threads = []

    def begin(self, what, *more):
        thread = threading.Thread(target=what, args=more, daemon=True)
        self.threads.append(thread)
        thread.start()

    def end(self):
        self.is_over.set()
        for thread in self.threads:
            thread.join(60)

    def add(self, what):
        self.count[what] = self.count.get(what, 0) + 1

    def dry_runs(self, n_repeats, query):
        k = 0
        while not self.is_over.is_set():
            k += 1
            status, _ = request(self.port, b"POST", b"/v1/dry-run" + query, PLAN % (k, n_repeats))
            self.add(f"dry run {status}")
            if status in (503, 0):
                time.sleep(0.2)

    def looks(self, session):
        while not self.is_over.is_set():
            for path in ("shots", "map", "layout", "shots/0/story"):
                status, _ = request(self.port, b"GET", f"/v1/sessions/{session}/{path}".encode())
                self.add(f"look {status}")

    def connect(self):
        try:
            s = socket.socket()
            s.settimeout(2.0)
            s.connect(("127.0.0.1", self.port))
            return s
        except OSError:
            return None

    def idle(self, n):
        """Closed ones are opened again, some hundreds a second."""
        held = []
        while not self.is_over.is_set():
            for _ in range(20):
                s = self.connect()
                if s is not None:
                    held.append(s)
                    self.add("idle connections")
                if len(held) > n:
                    held.pop(0).close()
            self.idle_held = len(held)
            if len(held) >= n:
                time.sleep(0.05)

    def slow(self, n):
        held = []
        head = b"POST /v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n"
        while not self.is_over.is_set():
            while len(held) < n:
                s = self.connect()
                if s is None:
                    break
                held.append([s, head if self.dice.random() < 0.5 else head + b"\r\n", 0])
                self.add("slow connections")
                if self.dice.random() < 0.5:  # a whole header at once, the body slowly
                    held[-1][2] = len(held[-1][1]) - 2
            alive = []
            for entry in held:
                s, text, at = entry
                try:
                    s.send(text[at:at + 1] or b"x")
                    entry[2] = at + 1
                    alive.append(entry)
                except OSError:
                    s.close()
            held = alive
            time.sleep(0.1)

    def listeners(self, n):
        held = []
        for _ in range(n):
            s = self.connect()
            if s is not None:
                try:
                    s.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
                except OSError:
                    pass
                held.append(s)
        self.count["listeners"] = len(held)
        self.is_over.wait()


def attack_all(port, args, session, ready, over, counts):
    """A process of its own, so that the operator's clock does not wait for its threads."""
    resource.setrlimit(resource.RLIMIT_NOFILE, args.files)
    attack = Attackers(port, args, random.Random(args.seed))
    for query in (b"", b"", b"?client=typing", b"?client=typing"):
        attack.begin(attack.dry_runs, args.shots // 64, query)
    attack.begin(attack.looks, session)
    attack.begin(attack.idle, args.idle)
    attack.begin(attack.slow, args.slow)
    attack.begin(attack.listeners, 100)
    wait_for(lambda: getattr(attack, "idle_held", 0) >= args.idle * 0.99, 300, 0.1)
    ready.set()
    over.wait()
    attack.end()
    counts.put(attack.count)


def answer_idly(ready, port):
    """The control: a server that has nothing else to do. What it takes is this machine's doing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port.value = server.getsockname()[1]
        ready.set()
        while True:
            s, _ = server.accept()
            with s:
                s.recv(1 << 16)
                s.sendall(b"HTTP/1.1 202 Accepted\r\n\r\n")


def page_hears(port):
    """A page's listener gets the stream's first line."""
    for _ in range(5):
        try:
            with socket.create_connection(("127.0.0.1", port), timeout=2.0) as s:
                s.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
                text = b""
                while b"retry" not in text:
                    part = s.recv(4096)
                    if not part:
                        break
                    text += part
                if b"retry" in text:
                    return True
        except OSError:
            pass
    return False


def share_within(times, limit):
    return sum(t <= limit for t in times) / len(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--idle", type=int, default=10000)
    parser.add_argument("--slow", type=int, default=600)
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--puts-out", type=int, default=10)
    parser.add_argument("--shots", type=int, default=256000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(1 << 32))
    parser.add_argument("--bin", default=str(HERE / "build/release/apps"))
    parser.add_argument("--rig", default="configs/rigs/small8.toml")
    parser.add_argument("--scene", default="configs/scenes/blocks.toml")
    args = parser.parse_args()
    args.more, args.reserve_mb = [], 0
    dice = random.Random(args.seed)
    print(f"seed {args.seed}")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = args.idle + args.slow + 1000
    args.files = (hard if hard != resource.RLIM_INFINITY and hard < wanted else max(soft, wanted), hard)
    if hard != resource.RLIM_INFINITY and hard < wanted:
        args.idle = hard - args.slow - 1000
        print(f"this machine allows {args.idle} idle connections only")
    folder = pathlib.Path(tempfile.mkdtemp(prefix="haarlight-all-off."))
    rig = Rig(args, folder)
    problems = []
    try:
        rig.start()
        wait_for(lambda: rig.state()["phase"] == "idle", 30)
        session = rig.begin(PLAN % (0, max(1, args.shots // 64 // 40)))
        wait_for(lambda: rig.state()["committed"] > 3, 60)
        rig.ask("/v1/abort", b"")
        wait_for(lambda: rig.state()["phase"] == "idle", 30)

        ready, over, counts = multiprocessing.Event(), multiprocessing.Event(), multiprocessing.Queue()
        attackers = multiprocessing.Process(
            target=attack_all, args=(rig.port, args, session, ready, over, counts), daemon=True)
        attackers.start()
        if not ready.wait(310):
            sys.exit("FAILED: the attackers do not get ready")

        idle_port, is_idle = multiprocessing.Value("i", 0), multiprocessing.Event()
        multiprocessing.Process(target=answer_idly, args=(is_idle, idle_port), daemon=True).start()
        is_idle.wait(60)
        times, control, lost = [], [], 0
        for _ in range(args.samples):
            control.append(1e3 * request(idle_port.value, b"POST", b"/")[1])
            status, seconds = request(rig.port, b"POST", b"/v1/all-off")
            lost += status != 202
            times.append(1e3 * seconds)
            time.sleep(dice.uniform(0.0, 0.1))
        times.sort()
        control.sort()
        print(f"all-off under all of it: median {times[len(times) // 2]:.1f} ms, 99 % "
              f"{times[int(0.99 * (len(times) - 1))]:.1f} ms, worst {times[-1]:.1f} ms; "
              f"{lost} of {len(times)} not answered")
        print(f"an idle server beside it: median {control[len(control) // 2]:.1f} ms, 99 % "
              f"{control[int(0.99 * (len(control) - 1))]:.1f} ms, worst {control[-1]:.1f} ms")
        if share_within(times, PROMISE_MS) < 0.99:
            if share_within(control, PROMISE_MS / 2) >= 0.99:
                problems.append("all-off is slower than promised")
            else:
                print("the 99 % are not checked: this machine is too busy for an idle server too")
        if times[len(times) // 2] > PROMISE_MS / 2:
            problems.append("all-off is slow each time")
        if lost > 0.01 * len(times):
            problems.append("all-off was not answered")
        if not page_hears(rig.port):
            problems.append("a page's listener does not get through")

        # From the request to a dark controller, in the midst of a capture.
        request(rig.port, b"POST", b"/v1/resume")
        wait_for(lambda: rig.state()["phase"] == "idle", 60)
        status = 0
        for _ in range(50):
            status, _ = request(rig.port, b"POST", b"/v1/run", PLAN % (1, 40))
            if status == 202:
                break
            time.sleep(0.2)
        if status != 202:
            problems.append(f"a run does not get through: {status}")
        dark = []
        for _ in range(args.puts_out if status == 202 else 0):
            wait_for(lambda: rig.state().get("lights") == "on", 60)
            begin = time.monotonic()
            request(rig.port, b"POST", b"/v1/all-off")
            wait_for(lambda: rig.state().get("lights") == "off", 30, 0.001)
            dark.append(1e3 * (time.monotonic() - begin))
            request(rig.port, b"POST", b"/v1/resume")
        if dark:
            dark.sort()
            print(f"from the request to a dark controller: median {dark[len(dark) // 2]:.1f} ms, "
                  f"worst {dark[-1]:.1f} ms of {len(dark)}")
            if dark[len(dark) // 2] > 2 * PROMISE_MS:
                problems.append("the lights go out later than promised")
        over.set()
        count = counts.get(timeout=120)
        print(", ".join(f"{n} {what}" for what, n in sorted(count.items())))
        if not count.get("dry run 200"):
            problems.append("no dry run was answered")
        if rig.daemon.poll() is not None:
            problems.append("the daemon has ended")
    finally:
        rig.end()
        shutil.rmtree(folder, ignore_errors=True)
    for line in problems:
        print("FAILED:", line)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
