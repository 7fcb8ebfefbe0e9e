#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How long `haarlight serve` takes for a picture: median and 99 % of requests at 1 and 8 clients, the server's
CPU time for one, and its memory. serve.py HAARLIGHT BASIS.hlb [--sky SKY] [--max-error E] [--requests 1000] [--json RECORDS.json]"""

import argparse
import json
import pathlib
import re
import signal
import subprocess
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent.parent / "docs/reference"))
from serve_client import Relight  # noqa: E402


def cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def resident_mb(pid):
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024.0


def ask(url, basis, requests, n_clients, n):
    """Seconds of every request, by n_clients at once."""
    seconds = []

    def client(first):
        lab = Relight(url)
        for i in range(first, n, n_clients):
            start = time.perf_counter()
            lab.picture(basis, **requests(i))
            seconds.append(time.perf_counter() - start)

    threads = [threading.Thread(target=client, args=(c,)) for c in range(n_clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(seconds)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("haarlight")
    parser.add_argument("basis", type=pathlib.Path)
    parser.add_argument("--sky", type=pathlib.Path)
    parser.add_argument("--max-error", type=float, help="of every picture (default: all terms)")
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    server = subprocess.Popen([given.haarlight, "serve", given.basis], stdout=subprocess.PIPE, text=True)
    url = None
    while url is None:
        url = (re.search(r"on (http://\S+?)/ ", server.stdout.readline()) or [None, None])[1]
    records = []
    try:
        lab = Relight(url)
        about = json.loads(lab.ask("GET", "/v1/bases"))["bases"][0]
        n_lights = about["lights"]
        kinds = {f"one light, {kind}": lambda i, kind=kind: {"kind": kind, "lights": {i % n_lights: 1.0}}
                 for kind in ("png", "exr", "f32")}
        kinds["all lights, png"] = lambda i: {"weights": [(k + i) % 7 / 7 for k in range(n_lights)]}
        if given.sky:
            sky = lab.add_sky(given.sky)
            kinds["sky, a new turn each, png"] = lambda i: {"sky": sky, "rotate": i * 0.36}
            kinds["sky, turns known, png"] = lambda i: {"sky": sky, "rotate": i % 16}
            kinds["sky, turns known, f32"] = lambda i: {"kind": "f32", "sky": sky, "rotate": i % 16}
        print(f"{about['width']} x {about['height']} x {about['channels']}, {n_lights} lights, "
              f"{resident_mb(server.pid):.0f} MB")
        for name, requests in kinds.items():
            if given.max_error:
                requests = lambda i, all_terms=requests: {**all_terms(i), "max_error": given.max_error}  # noqa: E731
            for n_clients in (1, 8):
                ask(url, given.basis.stem, requests, n_clients, 16)
                before = cpu_seconds(server.pid)
                seconds = ask(url, given.basis.stem, requests, n_clients, given.requests)
                record = {"what": name, "clients": n_clients, "requests": len(seconds),
                          "median_ms": 1e3 * seconds[len(seconds) // 2],
                          "ms_99": 1e3 * seconds[len(seconds) * 99 // 100],
                          "cpu_ms": 1e3 * (cpu_seconds(server.pid) - before) / len(seconds),
                          "resident_mb": resident_mb(server.pid)}
                records.append(record)
                print(f"{name:28} {n_clients} clients  median {record['median_ms']:7.1f} ms  99 % "
                      f"{record['ms_99']:7.1f} ms  CPU {record['cpu_ms']:6.1f} ms  "
                      f"{record['resident_mb']:.0f} MB", flush=True)
    finally:
        server.send_signal(signal.SIGINT)
        server.wait()
    if given.json:
        given.json.write_text(json.dumps(records, indent=1))


if __name__ == "__main__":
    main()
