# SPDX-License-Identifier: Apache-2.0
"""What the tests of the programs share: running them, a tiny capture of pictures, a virtual rig on
free ports, and a validator of reports. Python's own library only."""

import json
import math
import os
import pathlib
import re
import signal
import socket
import struct
import subprocess
import time
import zlib

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent


class Programs:
    """The built programs: `bin` is the build's folder apps/."""

    def __init__(self, bin_folder):
        self.bin = pathlib.Path(bin_folder).resolve()
        self.haarlight = self.bin / "haarlight/haarlight"
        self.daemon = self.bin / "haarlightd/haarlightd"
        self.sim = self.bin / "haarlight-sim/haarlight-sim"

    def run(self, *words, cwd=None, timeout=120, **environment):
        return subprocess.run([self.haarlight, *map(str, words)], capture_output=True, text=True,
                              cwd=cwd, timeout=timeout, env={**os.environ, **environment})

    def verbs(self, *above):
        """Those of the command, or of a verb that has some of its own."""
        text = self.run(*above, "--help").stdout
        block = text.split("Subcommands:", 1)[1] if "Subcommands:" in text else ""
        return re.findall(r"^  ([a-z][a-z-]*)\s", block, re.M)

    def whole_verbs(self, *above):
        """Those that do something: "rig doctor", not "rig"."""
        return [whole for verb in self.verbs(*above)
                for whole in self.whole_verbs(*above, verb) or [" ".join((*above, verb))]]


def footer_examples(help_text):
    """The commands at the end of a --help text, lines that end in a backslash joined."""
    text = re.split(r"^Examples?:$", help_text, flags=re.M)[-1].replace("\\\n", " ")
    return [" ".join(line.split()) for line in text.splitlines() if line.startswith("  haarlight")]


def png_bytes(width, height, rows, is_colour=False):
    """An 8-bit picture, grey or RGB; `rows` are the bytes of each row."""
    def chunk(kind, body):
        return (struct.pack(">I", len(body)) + kind + body +
                struct.pack(">I", zlib.crc32(kind + body)))

    return (b"\x89PNG\r\n\x1a\n" +
            chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2 if is_colour else 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows))) +
            chunk(b"IEND", b""))


def write_png(path, width, height, value):
    """An 8-bit grey picture; value(x, y) gives 0..255."""
    path.write_bytes(png_bytes(width, height, [bytes(value(x, y) for x in range(width))
                                               for y in range(height)]))


def spiral(k, n):
    """The k-th of n unit directions, evenly over most of the half sphere."""
    z = 0.3 + 0.65 * (k + 0.5) / n
    return (math.sqrt(1 - z * z) * math.cos(2.399963 * k), math.sqrt(1 - z * z) * math.sin(2.399963 * k), z)


def write_capture(folder, n_lights=4, size=8, scale=1.0):
    """Someone's capture: one picture per light and dirs.lp. `scale`: length of the light's position."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [str(n_lights)]
    for k in range(n_lights):
        write_png(folder / f"light{k}.png", size, size,
                  lambda x, y, k=k: 40 + 7 * x + 3 * y + (11 * k if n_lights <= 4 else k))
        place = ([(0.6, 0.0, 0.8), (0.0, 0.6, 0.8), (-0.6, 0.0, 0.8), (0.0, -0.6, 0.8)][k]
                 if n_lights <= 4 else spiral(k, n_lights))
        lines.append(f"light{k}.png " + " ".join(str(scale * c) for c in place))
    (folder / "dirs.lp").write_text("\n".join(lines) + "\n")
    return folder


def write_ball(folder, n_lights=6):
    """A dark ball before a grey wall, its highlight elsewhere in each picture."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(n_lights):
        def value(x, y, k=k):
            if math.hypot(x + 0.5 - 50 - 3 * k, y + 0.5 - 30 - 4 * (k % 3)) < 1.7:
                return 250
            return 20 if math.hypot(x + 0.5 - 58.2, y + 0.5 - 35.7) < 24.4 else 120 + (x + 2 * k) % 7

        write_png(folder / f"light{k}.png", 120, 80, value)
    return folder


def write_relightable(path, width=16, height=8):
    """A small .ptm: a luminance of six coefficients per pixel, then its colours."""
    luminance = bytes((40 * j + 3 * i) % 256 for i in range(width * height) for j in range(6))
    colours = bytes((90 + 5 * i + 40 * c) % 256 for i in range(width * height) for c in range(3))
    path.write_bytes(f"PTM_1.2\nPTM_FORMAT_LRGB\n{width}\n{height}\n"
                     "0.5 0.5 0.25 0.5 0.25 1.0\n167 97 0 0 0 0\n".encode() + luminance + colours)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def rig_on_free_ports(source, target, sockets, http_port, changes=()):
    """Copies a rig file; its sockets, ports and sessions become the test's own. `changes`: pairs of
    a key and its new value."""
    text = source.read_text()
    own = [("device", f'"{sockets}/camera.sock"'), ("port", str(http_port)),
           ("folder", f'"{sockets}/sessions"')]
    for key, value in [*own, *changes]:
        text, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", text)
        assert n == 1, f"{source} has {n} lines '{key} = ...'"
    text = text.replace(re.search(r"127\.0\.0\.1:\d+", text)[0], f"127.0.0.1:{free_port()}")
    target.write_text(text)


def wait_for(condition, seconds, what):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds} s for {what}"
        time.sleep(0.05)


class VirtualRig:
    """haarlight-sim and haarlightd on a rig file; end() stops both."""

    def __init__(self, programs, rig, scene, folder, url, cwd=None, starts_within=300):
        self.cwd = cwd
        self.log = open(folder / "rig.log", "wb")
        ready = folder / "ready"
        self.processes = [self.start(programs.sim, rig, "--scene", scene, "--ready-file", ready,
                                     "--cache", folder / "cache")]
        try:
            wait_for(ready.exists, starts_within, "the simulator")
            self.processes.append(self.start(programs.daemon, rig))
            wait_for(lambda: programs.run("status", "--daemon", url).returncode == 0, 30, "the daemon")
        except AssertionError:
            self.end()
            raise AssertionError((folder / "rig.log").read_text()) from None

    def start(self, *words):
        return subprocess.Popen(list(map(str, words)), stdout=self.log, stderr=self.log,
                                cwd=self.cwd)

    def end(self):
        """Both must end cleanly when asked. @return their exit codes, daemon first"""
        codes = []
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            codes.append(process.wait(timeout=30))
        self.log.close()
        return codes


TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int,
         "number": (int, float)}


def schema_problems(value, schema, where="report"):
    """What JSON Schema's words of docs/reference/report.schema.json ask and `value` lacks."""
    known = {"$schema", "title", "description", "type", "required", "properties",
             "additionalProperties", "items"}
    assert set(schema) <= known, f"the validator does not know {set(schema) - known}"
    kind = schema.get("type")
    if kind and (not isinstance(value, TYPES[kind]) or
                 (kind != "boolean" and isinstance(value, bool))):
        return [f"{where} is not of type {kind}"]
    problems = []
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        problems += [f"{where} lacks {key}" for key in schema.get("required", []) if key not in value]
        for key, held in value.items():
            if key in properties:
                problems += schema_problems(held, properties[key], f"{where}.{key}")
            elif schema.get("additionalProperties") is False:
                problems.append(f"{where} has the unknown key {key}")
    if isinstance(value, list) and "items" in schema:
        for i, held in enumerate(value):
            problems += schema_problems(held, schema["items"], f"{where}[{i}]")
    return problems


def report_problems(path, verb):
    """Problems of the report that `verb` wrote to `path`."""
    schema = json.loads((SOURCE / "docs/reference/report.schema.json").read_text())
    report = json.loads(path.read_text())
    problems = schema_problems(report, schema)
    if report.get("command") != verb:
        problems.append(f"its command is {report.get('command')}")
    return problems
