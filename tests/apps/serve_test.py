#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight serve`: its pictures beside those of `haarlight relight`, byte for byte; who may ask; what it refuses; files
that change below it; peers that lie. serve_test.py BIN, the build's folder apps/."""

import http.client
import json
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

from picture_files import read_exr
from programs import SOURCE, Programs, write_capture

sys.path.insert(0, str(SOURCE / "docs/reference"))
from serve_client import Relight  # noqa: E402

ROOM = SOURCE / "configs/environments/room.hdr"
N_LIGHTS = 24
SIZE = 18


class Server:
    def __init__(self, folder, *words):
        self.process = subprocess.Popen([PROGRAMS.haarlight, "serve", *map(str, words)], cwd=folder, text=True,
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        line = ""
        while " on http://" not in line:
            line = self.process.stdout.readline()
            assert line, self.process.stderr.read()
        self.port = int(re.search(r":(\d+)/", line)[1])

    def ask(self, path, body=None, token=None, method=None):
        """Status, headers and body of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method or ("GET" if body is None else "POST"), path, body,
                           {"Authorization": f"Bearer {token}"} if token else {})
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, answer.headers, content

    def raw(self, data=b""):
        peer = socket.create_connection(("127.0.0.1", self.port), timeout=30)
        peer.sendall(data)
        return peer

    def resident_kb(self):
        return int(re.search(r"VmRSS:\s+(\d+)", pathlib.Path(f"/proc/{self.process.pid}/status").read_text())[1])

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(timeout=60)
        self.process.stdout.close()
        self.process.stderr.close()
        return code


def request(path, body=b"", length=None):
    """A request's bytes; `length`: what it claims of its body."""
    method = "POST" if body or length is not None else "GET"
    said = f"Content-Length: {len(body) if length is None else length}\r\n" if method == "POST" else ""
    return f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{said}\r\n".encode() + body


def read_answers(peer):
    """What a connection gives until it ends or falls silent for two seconds."""
    peer.settimeout(2)
    data = b""
    try:
        while part := peer.recv(1 << 16):
            data += part
    except (TimeoutError, ConnectionError):
        pass
    peer.close()
    return data


class Serve(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.place = tempfile.TemporaryDirectory(prefix="haarlight-serve.")
        cls.folder = pathlib.Path(cls.place.name)
        write_capture(cls.folder / "photos", N_LIGHTS, SIZE)
        cls.do("import", "photos", "--lights", "photos/dirs.lp", "-o", "session")
        cls.do("compress", "session", "--max-error", "0.01", "-o", "object.hlb")
        cls.do("compress", "session", "--max-error", "0", "-o", "exact.hlb")
        (cls.folder / "skies").mkdir()
        shutil.copy(ROOM, cls.folder / "skies")

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    @classmethod
    def do(cls, *words):
        done = PROGRAMS.run(*words, "--quiet", "--force", cwd=cls.folder)
        assert done.returncode in (0, 1), (words, done.stdout + done.stderr)

    def serve(self, *words):
        server = Server(self.folder, *words)
        self.addCleanup(server.end)
        return server

    def relit(self, basis, kind, *words):
        """What the command writes."""
        self.do("relight", f"{basis}.hlb", *words, "-o", f"made.{kind}")
        return (self.folder / f"made.{kind}").read_bytes()

    def test_pictures_are_those_of_the_command(self):
        server = self.serve("object.hlb", "exact.hlb", "--skies", "skies")
        weights = [round(0.1 * k - 0.4, 3) for k in range(N_LIGHTS)]
        (self.folder / "weights.json").write_text(json.dumps(weights))
        coloured = [[w, 2 * w, 0.3] for w in weights]
        (self.folder / "coloured.json").write_text(json.dumps(coloured))
        cases = [
            ("png", "lights=3", None, ["--light", "3"]),
            ("exr", "lights=3,7=0.25", None, ["--light", "3,7=0.25"]),
            ("tif", "lights=3", None, ["--light", "3"]),
            ("png", "lights=3&exposure=0.7&stops=1", None, ["--light", "3", "--exposure", "0.7", "--stops", "1"]),
            ("png", "stops=-0.5", weights, ["--weights", "weights.json", "--stops", "-0.5"]),
            ("exr", "", coloured, ["--weights", "coloured.json"]),
            ("png", "sky=room.hdr", None, ["--cubemap", "skies/room.hdr"]),
            ("exr", "sky=room.hdr&rotate=-77.5", None, ["--cubemap", "skies/room.hdr", "--rotate", "-77.5"]),
            ("exr", "sky=room.hdr&max_error=0.05", None, ["--cubemap", "skies/room.hdr", "--max-error", "0.05"]),
            ("exr", "terms=4&order=light", weights,
             ["--weights", "weights.json", "--terms", "4", "--order", "light"]),
        ]
        for basis in ("object", "exact"):
            for kind, query, body, words in cases:
                with self.subTest(basis=basis, kind=kind, query=query):
                    status, headers, content = server.ask(f"/v1/bases/{basis}/picture.{kind}?{query}",
                                                          json.dumps(body) if body else None)
                    self.assertEqual(status, 200, content)
                    told = json.loads(headers["Haarlight-Picture"])
                    if "max_error" in query and basis == "object":  # the command takes as many terms as are quickest
                        words = [*words[:-2], "--terms", str(told["terms"])]
                        content = content.replace(b"0.05haarlightErrorReached", b"nonehaarlightErrorReached")
                    self.assertEqual(content, self.relit(basis, kind, *words))
                    self.assertEqual((told["width"], told["height"], told["method"]), (SIZE, SIZE, "memory"))
                    if "max_error" in query:
                        self.assertEqual(told["is_error_kept"], told["error_bound"] <= 0.05)
        _, headers, floats = server.ask("/v1/bases/object/picture.f32?sky=room.hdr&rotate=30")
        self.relit("object", "exr", "--cubemap", "skies/room.hdr", "--rotate", "30")
        channels = read_exr(self.folder / "made.exr")[2]
        n = json.loads(headers["Haarlight-Picture"])["channels"]
        values = struct.unpack(f"<{SIZE * SIZE * n}f", floats)
        names = "RGB" if n == 3 else "Y"
        for c, name in enumerate(names):
            self.assertEqual(list(values[c::n]), list(channels[name]))

    def test_a_sky_that_a_client_sends(self):
        server = self.serve("object.hlb")
        lab = Relight(f"http://127.0.0.1:{server.port}")
        sky = lab.add_sky(ROOM)
        self.assertEqual(sky, lab.add_sky(ROOM), "the same picture is the same sky")
        self.assertEqual(lab.picture("object", "exr", sky=sky, rotate=90),
                         self.relit("object", "exr", "--cubemap", ROOM, "--rotate", "90"))
        self.assertGreater(lab.told["error_bound"], 0.0)
        self.assertEqual(lab.picture("object", lights={3: 1.0, 5: 0.5}),
                         self.relit("object", "png", "--light", "3,5=0.5"))
        self.assertEqual(lab.picture("object", "png", weights=[1.0] * N_LIGHTS),
                         self.relit("object", "png", *[w for k in range(N_LIGHTS) for w in ("--light", k)]))
        with self.assertRaisesRegex(RuntimeError, "404: there is no basis"):
            lab.picture("absent", lights={0: 1.0})

    def test_the_token_is_needed_where_there_is_one(self):
        (self.folder / "token").write_text("a token of some length\n")
        server = self.serve("object.hlb", "--token-file", "token")
        for path, body in (("/v1/bases", None), ("/v1/bases/object/picture.png?lights=1", None),
                           ("/v1/bases/object/picture.png", "[1]"), ("/v1/skies", "x")):
            for token in (None, "a token of some lengtH", ""):
                self.assertEqual(server.ask(path, body, token)[0], 401, path)
        self.assertEqual(server.ask("/v1/healthz")[0], 200)
        self.assertEqual(server.ask("/v1/bases/object/picture.png?lights=1", None, "a token of some length")[0], 200)
        (self.folder / "short").write_text("short\n")
        for words in (("--token-file", "short"), ("--address", "0.0.0.0"), ("--allowed-host", "lab.example"),
                      ("--address", "lab")):
            done = PROGRAMS.run("serve", "object.hlb", *words, cwd=self.folder)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(words[0], done.stderr)

    def test_what_is_refused(self):
        server = self.serve("object.hlb", "--skies", "skies")
        picture = "/v1/bases/object/picture.png"
        many = json.dumps([1.0] * 100000)
        for path, body, status in (
                ("/v1/bases/absent/picture.png?lights=1", None, 404), ("/v1/bases/object/picture.gif", None, 404),
                (picture + "?sky=absent", None, 404), (picture + "?sky=..%2fobject.hlb", None, 404),
                (picture, None, 400), (picture + "?lights=99", None, 400), (picture + "?lights=-1", None, 400),
                (picture + "?lights=", None, 400), (picture + "?lights=1%3dnan", None, 400),
                (picture + "?lights=1%3dinf", None, 400), (picture + "?lights=1%3d1e30", None, 400),
                (picture + "?lights=1&sky=room.hdr", None, 400), (picture + "?lights=1&rotate=5", None, 400),
                (picture + "?sky=room.hdr&rotate=nan", None, 400), (picture + "?sky=room.hdr&rotate=x", None, 400),
                (picture + "?lights=1&max_error=2", None, 400), (picture + "?lights=1&max_error=nan", None, 400),
                (picture + "?lights=1&terms=-1", None, 400), (picture + "?lights=1&terms=1e3", None, 400),
                (picture + "?lights=1&terms=3&max_error=0.1", None, 400),
                (picture + "?lights=1&order=size", None, 400), (picture + "?lights=1&stops=99", None, 400),
                (picture + "?lights=1&exposure=-1", None, 400), (picture + "?light=1", None, 400),
                (picture, "[NaN]", 400), (picture, "[1, 2", 400), (picture, "{}", 400), (picture, "\0\1", 400),
                (picture, "[1e999]", 400), (picture, many, 400), (picture, "[" * 100000, 400),
                (picture, json.dumps([1e300] * N_LIGHTS), 400), (picture + "?lights=1", "[]", 400),
                ("/v1/skies", "no picture", 400), ("/v1/skies", ROOM.read_bytes()[:3000], 400)):
            with self.subTest(path=path, body=str(body)[:30]):
                found, _, content = server.ask(path, body)
                self.assertEqual(found, status, content)
                error = json.loads(content)["error"]
                self.assertTrue(error["what"] and error["where"] and error["cure"], error)
        self.assertEqual(server.ask(picture, method="PUT", body="x")[0], 405)
        for path, size in ((picture, 64 << 20), ("/v1/skies", 300 << 20)):
            peer = server.raw(request(path, length=size))
            answer = peer.recv(1 << 16)
            self.assertIn(b" 413 ", answer.split(b"\r\n")[0])
            self.assertIn(b'"cure"', answer + peer.recv(1 << 16) if b"cure" not in answer else answer)
            peer.close()
        self.assertEqual(server.ask(picture + "?lights=1")[0], 200)

    def test_files_that_change_below_it(self):
        for basis in ("object", "exact"):
            file = self.folder / f"changing_{basis}.hlb"
            whole = (self.folder / f"{basis}.hlb").read_bytes()
            file.write_bytes(whole)
            server = self.serve(file.name)
            path = f"/v1/bases/changing_{basis}/picture.exr?lights=2"
            before = server.ask(path)[2]
            with file.open("r+b") as opened:
                opened.truncate(100)
            self.assertEqual(server.ask(path)[2], before)
            file.write_bytes(b"\0" * len(whole))
            self.assertEqual(server.ask(path)[2], before)
            file.unlink()
            self.assertEqual(server.ask(path)[2], before)

    def test_a_broken_file_is_refused_at_the_start(self):
        whole = (self.folder / "object.hlb").read_bytes()
        damaged = bytearray(whole)
        damaged[200] ^= 1
        for name, content, words in (("cut", whole[:-7], "bytes"), ("flipped", bytes(damaged), "byte"),
                                     ("text", b"no basis", "not a basis file"), ("empty", b"", "not a basis file")):
            (self.folder / f"{name}.hlb").write_bytes(content)
            done = PROGRAMS.run("serve", f"{name}.hlb", cwd=self.folder)
            self.assertEqual(done.returncode, 65, done.stderr)
            self.assertIn(f"{name}.hlb", done.stderr)
            self.assertIn(words, done.stderr)
            self.assertIn("hint:", done.stderr)
        (self.folder / "again").mkdir()
        shutil.copy(self.folder / "object.hlb", self.folder / "again")
        done = PROGRAMS.run("serve", "object.hlb", "again/object.hlb", cwd=self.folder)
        self.assertIn("two basis files are named object", done.stderr)
        done = PROGRAMS.run("serve", "exact.hlb", "--memory", "1K", cwd=self.folder)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("exact.hlb", done.stderr)

    def test_peers_that_lie(self):
        server = self.serve("object.hlb")
        path = "/v1/bases/object/picture.exr?lights=2"
        good = server.ask(path)[2]
        two = read_answers(server.raw(request(path) + request(path)))
        self.assertEqual(two.count(good), 2, "two requests in one packet")
        body = json.dumps([0.5] * N_LIGHTS).encode()
        weighed = server.ask(path.split("?")[0], body)[2]
        both = read_answers(server.raw(request(path.split("?")[0], body) + request(path)))
        self.assertIn(weighed, both)
        self.assertIn(good, both)
        short = read_answers(server.raw(request(path.split("?")[0], body, len(body) - 5)))
        self.assertIn(b" 400 ", short.split(b"\r\n")[0])
        idle = [server.raw(request(path.split("?")[0], body, len(body) + 9)) for _ in range(4)]  # the rest never comes
        idle += [server.raw(b"GET /v1/ba") for _ in range(4)]
        idle += [server.raw(request(path) * 20) for _ in range(8)]  # whose answers are never read
        for garbage in (b"\0" * 5000, b"\x16\x03\x01\x02", b"GET / HTTP/9.9\r\n\r\n", b"\r\n" * 2000, b"POST\r\n\r\n",
                        request(path).replace(b"localhost", b"evil.example"),
                        request(path.split("?")[0], body).replace(b"Content-Length: ", b"Content-Length: -")):
            answer = read_answers(server.raw(garbage))
            self.assertFalse(answer.startswith(b"HTTP/1.1 2"), answer[:80])
        for _ in range(20):
            server.raw(request(path)).close()  # gone before the answer
        self.assertEqual(server.ask(path)[2], good)
        for peer in idle:
            peer.close()
        self.assertEqual(server.end(), 0)

    def test_memory_stays(self):
        server = self.serve("object.hlb", "--skies", "skies")
        lab = Relight(f"http://127.0.0.1:{server.port}")

        def ask_all(n):
            for i in range(n):
                lab.picture("object", ("png", "exr", "f32")[i % 3], lights={i % N_LIGHTS: 1.0 + i})
                lab.picture("object", "exr", sky="room.hdr", rotate=i % 40)
                server.ask("/v1/bases/object/picture.png?lights=bad")

        ask_all(120)
        before = server.resident_kb()
        ask_all(240)
        self.assertLess(server.resident_kb() - before, 4096, "kB more after 720 requests")


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main(verbosity=2)
