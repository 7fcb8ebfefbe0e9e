# SPDX-License-Identifier: Apache-2.0
"""The unbiased integrators of `haarlight render surface` agree in the mean: each beside another, by tiles of a picture and as
a whole, in Welch's test of seeds (Student's t, as in configs/conformance). Prints the table of docs/numerics/surface.md.

    agreement_test.py PROGRAMS [-v]    the folder of the programs
"""

import functools
import json
import math
import pathlib
import re
import struct
import subprocess
import sys
import tempfile
import unittest

try:
    import numpy as np
except ImportError:
    np = None

SOURCE = pathlib.Path(__file__).resolve().parents[2]
PROGRAMS = pathlib.Path(sys.argv.pop(1)).resolve() if len(sys.argv) > 1 else None
SCENES = SOURCE / "configs/scenes"

ALPHA = 0.01  # chance that right integrators differ in any tile of any row
SEEDS = 16
SIDE = 32  # pixels of a picture
TILES = 4  # a side
SURE = 2.6  # standard errors: with more than 99 of 100 seeds a difference by these and what is allowed is seen

# (scene, what both are given, integrator and samples, its partner and samples); partners have other seeds. By area: in a part of the back wall, a vertex of
# which is not where surfaces touch, up to the second vertex: the variance has no bound elsewhere. Mirrors and glass are black to it.
PAIRS = (
    ("cornell", "--bounces 8", ("path", 64), ("path-naive", 16)),
    ("cornell", "--bounces 8", ("path", 64), ("bidirectional", 16)),
    ("cornell", "--bounces 2 --crop 8x8+12+6", ("path", 512), ("path-by-area", 512)),
    ("cornell", "--bounces 1", ("direct", 64), ("path", 64)),
    ("cornell", "--bounces 1", ("direct", 64), ("bidirectional", 64)),
    ("cornell", "--bounces 1", ("direct", 64), ("path-by-area", 64)),
    ("caustic", "--bounces 8", ("path", 128), ("path-naive", 32)),
    ("caustic", "--bounces 8", ("path", 128), ("bidirectional", 32)),
    ("caustic", "--bounces 1", ("direct", 64), ("bidirectional", 32)),
    ("balls", "--bounces 8", ("path", 32), ("path-naive", 16)),
    ("balls", "--bounces 1", ("direct", 64), ("bidirectional", 32)),
    ("balls", "--bounces 1", ("direct", 64), ("path-naive", 32)),
    ("balls_by_panel", "--bounces 8", ("path", 64), ("bidirectional", 32)),
    ("balls_without_glass", "--bounces 8", ("path", 64), ("bidirectional", 32)),
)


def write_caustic(folder):
    """cornell_caustic.toml with a lamp four times as wide, of the same power. By the scene's own, a path finds the caustic one time in
    thousands, and 16 seeds are nowhere near normal."""
    text = (SCENES / "cornell_caustic.toml").read_text()
    for old, new in (("298, -", "358, -"), ("258, -", "198, -"), ("-259.5", "-199.5"), ("-299.5", "-359.5"),
                     ("[250, 180, 60]", "[15.625, 11.25, 3.75]")):
        assert old in text, old
        text = text.replace(old, new)
    (folder / "caustic.toml").write_text(text)


def write_balls(path, spoil):
    """balls.glb, its document changed by `spoil`."""
    data = (SCENES / "balls.glb").read_bytes()
    n, = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20:20 + n])
    spoil(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + n:]
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON") +
                     text + rest)


def panel_alone(document):
    """Without the lamps of no extent: their light by way of the glass is found by paths from the lights alone."""
    for node in document["nodes"]:
        node.pop("extensions", None)


def without_glass(document):
    for material in document["materials"]:
        if "KHR_materials_transmission" in material.get("extensions", {}):
            del material["extensions"]
            material["pbrMetallicRoughness"]["roughnessFactor"] = 0.3


def tile_means(picture, tiles):
    """(tiles, tiles)"""
    side = len(picture) // tiles
    return picture.reshape(tiles, side, tiles, side).mean(axis=(1, 3))


class Row:
    """Two integrators. First and second: (seeds, tiles and the whole); in units of the mean of all."""

    def __init__(self, first, second, alpha, t_limit):
        unit = first[:, -1].mean()
        n = SEEDS
        self.off = (second.mean(axis=0) - first.mean(axis=0)) / unit
        squares = [values.var(axis=0, ddof=1) / n / unit ** 2 for values in (first, second)]
        self.sigma = np.sqrt(squares[0] + squares[1])
        # [Welch47]
        freedom = (squares[0] + squares[1]) ** 2 / ((squares[0] ** 2 + squares[1] ** 2) / (n - 1))
        self.allowed = np.array([t_limit(alpha, f) for f in freedom]) * self.sigma
        self.seen = (self.allowed + SURE * self.sigma) * unit / first.mean(axis=0)  # over the tile's own light

    def differs(self):
        return (np.abs(self.off) > self.allowed).any()

    def text(self):
        worst = np.abs(self.off / self.allowed).max()
        t = self.off / self.sigma
        return (f"{100 * self.off[-1]:+.3f} | {100 * self.sigma[-1]:.3f} | {t[-1]:+.2f} | {worst:.2f} | {100 * self.seen[-1]:.2f} | "
                f"{100 * np.median(self.seen[:-1]):.1f}")


@unittest.skipIf(np is None, "NumPy is not there")
class Agreement(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        sys.path[:0] = [str(SOURCE / "configs/conformance"), str(SOURCE / "bench")]
        from conformance import t_limit
        from float_tif import read_tif
        cls.t_limit, cls.read_tif = functools.cache(lambda alpha, f: t_limit(alpha, f)), read_tif
        cls.kept = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.kept.name)
        write_caustic(cls.folder)
        write_balls(cls.folder / "balls_by_panel.glb", panel_alone)
        write_balls(cls.folder / "balls_without_glass.glb", without_glass)
        cls.pictures = {}
        n = sum(TILES ** 2 + 1 for _ in PAIRS)
        cls.alpha = 1.0 - (1.0 - ALPHA) ** (1.0 / n)  # [Sidak67]
        cls.rows = {}
        for pair in PAIRS:
            scene, words, one, other = pair
            cls.rows[pair] = (cls.seeds(scene, words, *one), cls.seeds(scene, words, *other, first=SEEDS))

    @classmethod
    def tearDownClass(cls):
        cls.kept.cleanup()

    @classmethod
    def seeds(cls, scene, words, integrator, samples, first=0):
        """Of each seed the light of its tiles, and of the whole last. Rendered once; partners have other seeds."""
        key = (scene, words, integrator, samples, first)
        if key not in cls.pictures:
            # What shows a lamp itself, where noise is that of its rim, which all have alike.
            shows_lamp = cls.picture(scene, re.sub("--bounces .", "--bounces 0", words), "path", 64, 0) > 0.0
            made = []
            for seed in range(first, first + SEEDS):
                picture = cls.picture(scene, words, integrator, samples, seed)
                picture[shows_lamp] = 0.0
                means = tile_means(picture, TILES)
                made.append([*means.ravel(), means.mean()])
            cls.pictures[key] = np.array(made)
        return cls.pictures[key]

    @classmethod
    def picture(cls, scene, words, integrator, samples, seed):
        """(side, side): mean of red, green and blue"""
        path = next(p for folder in (cls.folder, SCENES) for p in folder.glob(f"{scene}.[gt]*"))
        if integrator == "direct":
            words = words.replace("--bounces 1", "")  # has no others
        made = cls.folder / "picture.tif"
        subprocess.run([PROGRAMS / "haarlight/haarlight", "render", "surface", path, "-o", made, "--force", "--quiet", "--size",
                        f"{SIDE}x{SIDE}", "--spp", str(samples), "--seed", str(seed), "--integrator", integrator, *words.split()],
                       check=True, stdout=subprocess.DEVNULL)
        values = cls.read_tif(made)
        side = math.isqrt(values.size // 3)
        return values.reshape(side, side, 3).mean(axis=2)

    def row(self, pair, fault=None):
        first, second = self.rows[pair]
        if fault is not None:
            second = second * fault
        return Row(first, second, self.alpha, type(self).t_limit)

    def test_they_agree(self):
        print(f"\n{SEEDS} seeds each; {len(PAIRS)} pairs of {TILES ** 2} tiles and the whole; right ones differ anywhere with probability {ALPHA}")
        print("| scene | given to both | integrators | off % | sigma % | t | worst of its limit | seen: whole % | a tile % |")
        print("|---|---|---|---|---|---|---|---|---|")
        rows = {pair: self.row(pair) for pair in PAIRS}
        for (scene, words, one, other), row in rows.items():
            print(f"| `{scene}` | `{words}` | {one[0]}, {other[0]} | {row.text()} |")
        for pair, row in rows.items():
            with self.subTest(pair=pair):
                self.assertFalse(row.differs(), row.text())

    def test_what_would_be_seen_is_seen(self):
        """A tile, and the whole, by what the table says, in each direction."""
        for pair in PAIRS:
            row = self.row(pair)
            for sign in (1.0, -1.0):
                with self.subTest(pair=pair, sign=sign):
                    # The mean is SURE standard errors beyond what is allowed, but for where these seeds happen to be.
                    factor = 1.0 + sign * row.seen[-1] - row.off[-1]
                    self.assertTrue(self.row(pair, factor).differs())
                    one_tile = np.ones(TILES ** 2 + 1)
                    one_tile[5] += sign * row.seen[5]
                    one_tile[5] -= row.off[5] * self.rows[pair][0][:, -1].mean() / self.rows[pair][0][:, 5].mean()
                    self.assertTrue(self.row(pair, one_tile).differs())

    def test_the_power(self):
        """What would be seen of the whole, else the test is too weak to say anything."""
        for pair in PAIRS:
            scene, _, _, (other, _) = pair
            most = 0.015 if scene == "cornell" else 0.04 if (scene, other) == ("caustic", "path-naive") else 0.025
            with self.subTest(pair=pair):
                self.assertLess(self.row(pair).seen[-1], most)


if __name__ == "__main__":
    unittest.main()
