#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight view` of a volume's scene, without a browser: its pictures against those of `haarlight render volume`,
what it saves, refuses and replaces. volume_view_test.py BIN, the build's folder apps/."""

import concurrent.futures
import http.client
import json
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.error
import urllib.request

from picture_files import read_exr, read_png
from programs import SOURCE, Programs

VOLUMES = SOURCE / "configs/volumes"
CUBE = (VOLUMES / "cube.toml").read_text()
CONTOUR = '\n[[contour]]\nfield = "linear"\nvalue = 0.5\ncolour = [0.9, 0.8, 0.2]\nopacity = 0.4\n'


class Server:
    def __init__(self, folder, scene, *words):
        self.process = subprocess.Popen([PROGRAMS.haarlight, "view", scene, *words], cwd=folder, text=True,
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        line = self.process.stdout.readline()
        found = re.search(r" on (http://127\.0\.0\.1:\d+)/", line)
        assert found, line + self.process.stderr.read()
        self.url = found[1]

    def ask(self, path, body=None, headers=()):
        """Status, headers and body of an answer."""
        data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data=data, headers=dict(headers))
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return answer.status, answer.headers, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.headers, error.read()

    def about(self):
        return json.loads(self.ask("/v1/volume")[2])

    def want(self, look, client="a"):
        status, _, body = self.ask(f"/v1/volume/views?client={client}", look)
        assert status == 200, body
        return json.loads(body)["view"]

    def picture(self, view, kind, words="", client="a"):
        """Asks until it is complete. Width, height, bytes, and what the server says of it."""
        while True:
            status, headers, body = self.ask(f"/v1/volume/views/{view}/{kind}?client={client}{words}")
            if status != 202:
                assert status == 200, (status, body)
                return *read_png(body), json.loads(headers["Haarlight-Picture"])

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(timeout=60)
        self.process.stdout.close()
        self.process.stderr.close()
        return code


class VolumeView(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        shutil.copy(VOLUMES / "cube.vtu", self.folder)

    def serve(self, text=CUBE, *words):
        (self.folder / "scene.toml").write_text(text)
        server = Server(self.folder, "scene.toml", *words)
        self.addCleanup(server.end)
        return server

    def render(self, scene, *words):
        done = PROGRAMS.run("render", "volume", scene, "-o", "true.png", "--force", *words, cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return read_png((self.folder / "true.png").read_bytes())

    def test_previews_and_the_exact_picture_are_those_of_the_command(self):
        server = self.serve()
        view = server.want(server.about()["look"])
        for method in ("m0", "m1", "m3"):
            *shown, facts = server.picture(view, "preview", f"&preview={method}")
            self.assertEqual(tuple(shown), self.render("scene.toml", "--algorithm", "projected-tetrahedra",
                                                       "--preview", method), method)
            self.assertEqual(facts["kind"], "preview")
        *shown, facts = server.picture(view, "exact")
        self.assertEqual(tuple(shown), self.render("scene.toml"))
        self.assertEqual((facts["width"], facts["height"], facts["shrink"]), (256, 256, 1))
        # What the last preview is off by is what --compare tells of it, for the worst of its colours.
        self.render("scene.toml", "--algorithm", "projected-tetrahedra", "--preview", "m3", "--compare",
                    "off.png", "--report", "report.json")
        achieved = json.loads((self.folder / "report.json").read_text())["reached"]
        for ours, theirs in (("mean", "mean_error"), ("at_99", "error_at_99_percent"), ("worst", "worst_error")):
            self.assertEqual(facts["preview_errors"][ours],
                             max(achieved[f"{theirs}_{colour}"] for colour in ("red", "green", "blue")))
        self.assertEqual(facts["preview_errors"]["preview"], "m3")
        *shown, facts = server.picture(view, "exact", "&exposure=0.25")
        self.assertEqual(tuple(shown), self.render("scene.toml", "--exposure", "0.25"))
        *shown, facts = server.picture(view, "exact", "&exposure=0.25&stops=-1")
        self.assertEqual((tuple(shown), facts["exposure"]), (self.render("scene.toml", "--exposure", "0.125"), 0.125))
        *shown, facts = server.picture(view, "exact", "&shrink=4")
        self.assertEqual(tuple(shown), self.render("scene.toml", "--size", "64x64"))

    def test_the_exr_is_the_command_s(self):
        server = self.serve()
        view = server.want(server.about()["look"])
        server.picture(view, "exact")
        status, _, body = server.ask(f"/v1/volume/views/{view}/exact.exr?client=a")
        self.assertEqual(status, 200)
        (self.folder / "viewed.exr").write_bytes(body)
        done = PROGRAMS.run("render", "volume", "scene.toml", "-o", "true.exr", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(read_exr(self.folder / "viewed.exr"), read_exr(self.folder / "true.exr"))

    def saved_alike(self, text, change):
        """Changes the look, saves it in another folder, and renders that."""
        server = self.serve(text)
        look = server.about()["look"]
        change(look)
        status, _, body = server.ask("/v1/volume/scene", look)
        self.assertEqual(status, 200, body)
        (self.folder / "elsewhere").mkdir(exist_ok=True)
        (self.folder / "elsewhere/saved.toml").write_bytes(body)
        *shown, _ = server.picture(server.want(look), "exact")
        self.assertEqual(tuple(shown), self.render("elsewhere/saved.toml"))
        self.assertNotEqual(tuple(shown), self.render("scene.toml"))
        server.end()

    def test_what_is_saved_renders_as_it_was_seen(self):
        def change(look):
            look["camera"]["eye"] = [-1.7, 1.0 / 3.0, 2.9]
            look["density"][1] = [0.1 + 0.2, 7.1e-1]
            look["colour"][2] = [0.6, 1e-3, 2.5, 0.1]

        self.saved_alike(CUBE, change)
        self.saved_alike(CUBE + CONTOUR + "\n[background]\ntop = [0.1, 0.2, 0.3]\nbottom = [0.0, 0.0, 0.1]\n", change)
        self.saved_alike(CUBE + '\n[background]\nchecker = [[1, 1, 1], [0, 0.5, 0]]\nsquare = 12\n', change)
        self.saved_alike(re.sub(r"fov_y_deg = .*", "width_mm = 2.0\nnear_mm = 0.5\nfar_mm = 3.25", CUBE), change)
        without_colour = re.sub(r"(?s)\[colour\].*?\n\n", "", CUBE)
        self.assertNotIn("[colour]", without_colour)
        self.saved_alike(without_colour, lambda look: look["colour"].append([2.0, 0.2, 0.4, 0.6]))

    def test_scenes_without_previews_have_small_exact_pictures(self):
        server = self.serve(CUBE + CONTOUR)
        about = server.about()
        self.assertEqual(about["no_preview"], "previews draw no contours")
        view = server.want(about["look"])
        status, _, body = server.ask(f"/v1/volume/views/{view}/preview?client=a")
        self.assertEqual(status, 400)
        self.assertIn("contours", body.decode())
        *shown, facts = server.picture(view, "exact", "&shrink=4")
        self.assertEqual(tuple(shown), self.render("scene.toml", "--size", "64x64"))
        self.assertIsNone(facts["preview_errors"])

    def test_broken_requests_say_what_to_do(self):
        server = self.serve()
        look = server.about()["look"]

        def broken(change):
            copy = json.loads(json.dumps(look))
            change(copy)
            return json.dumps(copy).encode()

        def put(key, value):
            return broken(lambda copy: copy.update({key: value}))

        def camera(key, value):
            return broken(lambda copy: copy["camera"].update({key: value}))

        for body, words in (
                (b"", "JSON"), (b"{", "JSON"), (b"[" * 100000, "brackets"), (b"{}", "size"),
                (broken(lambda copy: copy["camera"].update(fov_y_deg=12345)).replace(b"12345", b"NaN"), "JSON"),
                (put("size", [1000000000, 1000000000]), "size"), (put("size", [65536, 65536]), "pixels"),
                (put("size", [0, 10]), "size"), (put("size", [10.5, 10]), "size"), (put("size", [10]), "size"),
                (put("density", []), "density"), (put("density", [[0, 1]] * 5000), "density"),
                (put("density", [[0, 1], [0, 2]]), "ascend"), (put("density", [[0, -1]]), "negative"),
                (put("density", [[0, 1, 2]]), "density"), (put("colour", [[0, "red", 0, 0]]), "colour"),
                (put("density", [[0, 1e300]]), "density"), (put("camera", None), "camera"),
                (camera("eye", [0.5, 0.5, 0.5]), "up"), (camera("up", [0, 0, 0]), "up"),
                (camera("eye", [1e30, 0, 0]), "eye"), (camera("fov_y_deg", 0), "fov_y_deg"),
                (camera("target", [0, 0]), "target")):
            with self.subTest(body=body[:80], words=words):
                for path in ("/v1/volume/views?client=a", "/v1/volume/scene"):
                    status, _, answer = server.ask(path, body)
                    self.assertEqual(status, 400, answer)
                    error = json.loads(answer)["error"]
                    self.assertIn(words, error["what"] + error["where"] + error["cure"])
                    self.assertTrue(error["cure"])
        view = server.want(look)
        for path in (f"{view}/exact", f"{view}/exact?client=A/b", f"{view}/sketch?client=a", f"x/exact?client=a",
                     f"{view}/exact?client=a&shrink=0", f"{view}/exact?client=a&shrink=1e9",
                     f"{view}/preview?client=a&preview=m2", f"{view}/exact?client=a&exposure=nan",
                     f"{view}/exact?client=a&exposure=-1", f"{view}/exact?client=a&stops=inf"):
            status, _, answer = server.ask(f"/v1/volume/views/{path}")
            self.assertEqual(status, 400, (path, answer))
            self.assertTrue(json.loads(answer)["error"]["cure"])
        link = http.client.HTTPConnection(server.url.removeprefix("http://"), timeout=60)
        link.putrequest("POST", "/v1/volume/views?client=a")  # refused by its length, before the rest is sent
        link.putheader("Content-Length", str(2 << 20))
        link.endheaders()
        self.assertEqual(link.getresponse().status, 413)
        link.close()
        self.assertEqual(server.ask("/v1/volume", headers={"Host": "evil.example"})[0], 403)
        self.assertEqual(server.ask("/v1/volume", headers={"Origin": "http://evil.example"})[0], 403)
        # A medium of the largest numbers is drawn, and so is the next one.
        densest = server.want(dict(look, density=[[0, 1e100]], colour=[[0, 1e100, 0, 0]]))
        self.assertEqual(server.picture(densest, "exact")[:2], (256, 256))
        self.assertEqual(server.picture(server.want(look), "exact")[:2], (256, 256))

    def test_the_newest_view_wins_and_two_clients_get_both(self):
        server = self.serve()
        look = server.about()["look"]
        large = dict(look, size=[2000, 2000])
        old = server.want(large)
        status, _, body = server.ask(f"/v1/volume/views/{old}/exact?client=a")
        self.assertEqual(status, 202, "a slice of it")
        share = json.loads(body)["share"]
        self.assertTrue(0.0 < share < 1.0, share)
        status, _, body = server.ask(f"/v1/volume/views/{old}/exact?client=a")
        self.assertTrue(status == 200 or json.loads(body)["share"] > share, "the next one goes on from there")
        new = server.want(look)
        status, _, body = server.ask(f"/v1/volume/views/{old}/exact?client=a")
        self.assertEqual((status, json.loads(body)), (202, {"is_replaced": True}))
        with concurrent.futures.ThreadPoolExecutor() as pool:
            other = server.want(dict(look, size=[300, 300]), client="b")
            first = pool.submit(server.picture, new, "exact")
            second = pool.submit(server.picture, other, "exact", "", "b")
            *shown, _ = first.result()
            self.assertEqual(tuple(shown), self.render("scene.toml"))
            *shown, _ = second.result()
            self.assertEqual(tuple(shown), self.render("scene.toml", "--size", "300x300"))
        # A fifth client takes the place of the one that has waited longest.
        for client in ("c", "d", "e"):
            server.want(look, client)
        self.assertTrue(json.loads(server.ask(f"/v1/volume/views/{new}/exact?client=a")[2])["is_replaced"])
        self.assertEqual(server.ask(f"/v1/volume/views/{other}/exact?client=b")[0], 200)

    def test_it_ends_when_told_while_it_draws(self):
        server = self.serve()
        view = server.want(dict(server.about()["look"], size=[2000, 2000]))
        with concurrent.futures.ThreadPoolExecutor() as pool:
            def ask_on():
                try:
                    while server.ask(f"/v1/volume/views/{view}/exact?client=a")[0] == 202:
                        pass
                except OSError:
                    pass  # it has gone

            asking = pool.submit(ask_on)
            time.sleep(0.5)
            self.assertEqual(server.end(), 0)
            asking.result()

    def test_what_it_refuses_to_show(self):
        def refused(text, *words):
            (self.folder / "scene.toml").write_text(text)
            done = PROGRAMS.run("view", "scene.toml", *words, cwd=self.folder)
            self.assertNotEqual(done.returncode, 0)
            return done.stderr

        self.assertIn("cube.vtu", refused(CUBE.replace("linear", "pressure")))
        self.assertIn("--memory", refused(CUBE, "--memory", "1M"))
        self.assertIn("size", refused(CUBE.replace("[256, 256]", "[9000, 9000]")))
        self.assertIn("--voxel", refused(CUBE, "--voxel", "2"))
        camera = CUBE[:CUBE.index("[camera]")] + (
            "[camera]\nsize = [64, 48]\nK = [[90, 0, 30], [0, 90, 24], [0, 0, 1]]\n"
            "world_from_cam = [[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, -3]]\n")
        self.assertIn("fov_y_deg", refused(camera))
        server = self.serve(camera.replace("0, 30]", "0, 32]"))
        shown = server.picture(server.want(server.about()["look"]), "exact")
        true = self.render("scene.toml")
        self.assertLessEqual(max(abs(a - b) for a, b in zip(shown[2], true[2])), 1)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
