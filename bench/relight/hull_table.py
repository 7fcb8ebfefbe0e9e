#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""How much of a cast shadow is wrong, with the shadow hull and without: the table of
docs/numerics/hull.md, by the user's own commands from file to file.

    /usr/bin/python3 bench/relight/hull_table.py build/release/apps --work DIR

Captures each object on the virtual rig (cube32: 1024 lights, 320 x 240 pixels, noise; --rig names
others), compresses as the demo does, casts its shadow on each receiver under each light, and compares with the
ray-traced truth, in pictures of 160 x 120. Values are in %:

    ||picture - truth||_1 / ||unshadowed - truth||_1

--ideal takes the noise out of the capture and compresses to 1e-4. The rows' lights are those of
cube32, or the rig's in the nearest directions.

Spread: at how many of the values in shadow that of `both` holds the truth, and its median over the
error's root mean square.

What DIR holds already is not made again, so that a run that was interrupted goes on: another build
needs another DIR, or one without its rows/. Objects of the kinds solid, thin, porous, hanging and
twigs are generated; one --seed gives one .obj, byte for byte. Needs Debian's python3-numpy."""

import argparse
import json
import math
import pathlib
import random
import re
import shutil
import statistics
import sys
import time

import numpy as np

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(SOURCE / "tests/apps"), str(SOURCE / "bench")]
from float_tif import read_tif  # noqa: E402
from programs import Programs, VirtualRig, free_port, png_bytes, rig_on_free_ports  # noqa: E402

SIZE = "160x120"
LIGHTS = {
    "1": [528],
    "4": [198, 217, 806, 825],
    "9": [165, 176, 186, 517, 528, 538, 837, 848, 858],
    "room": SOURCE / "configs/environments/room.hdr",
    "sun": "sun.hdr",  # written into DIR
}
METHODS = ("plane", "both", "hull")
COLUMNS = ("lit", "dark", *METHODS)
KINDS = ("solid", "thin", "porous", "hanging", "twigs")

# ---- receivers: (scene file's objects, height of the surface over (x, y)) ---------------------

STONE = '[[material]]\nname = "stone"\nkd = [0.7]\n\n'
CAMERA = """[camera]
size = [320, 240]
eye = [-160.0, -640.0, 640.0]
target = [0.0, 10.0, -10.0]
up = [0.0, 0.0, 1.0]
fov_y_deg = 30.0
"""
RIM, DEEP, SIDE, WALL_Y, RADIUS = -0.5, -120.0, 150.0, 150.0, 70.0


def quad(*corners):
    return f'[[quad]]\ncorners = {[list(map(float, c)) for c in corners]}\nmaterial = "stone"\n\n'


def floor(z, x0=-300, x1=300, y0=-300, y1=300, z1=None):
    z1 = z if z1 is None else z1
    return quad((x0, y0, z), (x1, y0, z1), (x1, y1, z1), (x0, y1, z))


def pit():
    s, sides = SIDE, [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    walls = [quad((s * a[0], s * a[1], DEEP), (s * b[0], s * b[1], DEEP), (s * b[0], s * b[1], RIM),
                  (s * a[0], s * a[1], RIM)) for a, b in zip(sides, sides[1:] + sides[:1])]
    rim = [floor(RIM, y1=-s), floor(RIM, y0=s), floor(RIM, x1=-s, y0=-s, y1=s), floor(RIM, x0=s, y0=-s, y1=s)]
    return "".join([floor(DEEP, -s, s, -s, s), *walls, *rim])


def tread(x):
    return next(z for end, z in ((-110, -100), (-45, -50), (45, 0), (85, 25), (1e9, 50)) if x <= end)


RECEIVERS = {
    "stairs": (None, lambda x, y: tread(x)),  # configs/scenes/stairs.toml
    "flat": (floor(RIM), lambda x, y: RIM),
    "incline": (floor(-90, z1=60), lambda x, y: -15 + 0.25 * x),
    "pit": (pit(), lambda x, y: DEEP if max(abs(x), abs(y)) < SIDE else RIM),
    "wall": (floor(RIM, y1=WALL_Y) + quad((-300, WALL_Y, RIM), (300, WALL_Y, RIM), (300, WALL_Y, 180),
                                          (-300, WALL_Y, 180)),
             lambda x, y: RIM if y < WALL_Y else 180),
    "sphere": (floor(RIM - 2 * RADIUS) + f'[[sphere]]\ncentre = [0.0, 0.0, {RIM - RADIUS}]\nradius = {RADIUS}\n'
               'material = "stone"\n\n', lambda x, y: RIM),
}


def write_receivers(folder):
    folder.mkdir(exist_ok=True)
    files = {"stairs": SOURCE / "configs/scenes/stairs.toml"}
    for name, (objects, _) in RECEIVERS.items():
        if objects:
            files[name] = folder / f"{name}.toml"
            files[name].write_text(f'schema = 1\nname = "{name}"\n\n{STONE}{objects}{CAMERA}')
    return files


def write_sun(path, width=1024, tilt=math.radians(15), turn=math.radians(40), radius=math.radians(0.7)):
    """A lat-long picture, black but for a disc `tilt` from the zenith."""
    towards = (math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt))
    theta = (np.arange(width // 2) + 0.5)[:, None] * (2 * math.pi / width)
    phi = (np.arange(width) + 0.5)[None, :] * (2 * math.pi / width)
    cosine = (np.sin(theta) * np.cos(phi) * towards[0] + np.sin(theta) * np.sin(phi) * towards[1] +
              np.cos(theta) * towards[2])
    pixels = np.zeros((width // 2, width, 4), np.uint8)
    pixels[cosine > math.cos(radius)] = (128, 128, 128, 128 + 12)
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {width // 2} +X {width}\n".encode() + pixels.tobytes())


# ---- generated objects: vertices and faces ----------------------------------------------------


class Mesh:
    def __init__(self):
        self.vertices, self.faces = [], []

    def add(self, vertices, faces):
        n = len(self.vertices)
        self.vertices += [tuple(map(float, v)) for v in vertices]
        self.faces += [[n + i for i in face] for face in faces]

    def rod(self, a, b, ra, rb, n=8):
        """A closed prism around the line from a to b."""
        a, b = np.array(a, float), np.array(b, float)
        axis = (b - a) / np.linalg.norm(b - a)
        u = np.cross(axis, (1, 0, 0) if abs(axis[0]) < 0.9 else (0, 1, 0))
        u /= np.linalg.norm(u)
        v = np.cross(axis, u)
        around = [math.cos(2 * math.pi * i / n) * u + math.sin(2 * math.pi * i / n) * v for i in range(n)]
        self.add([a + ra * w for w in around] + [b + rb * w for w in around],
                 [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)] +
                 [list(range(n))[::-1], list(range(n, 2 * n))])

    def voxels(self, full, low, size):
        """The faces between full and empty voxels of a boolean array (x, y, z)."""
        full = np.pad(full, 1)
        index = {}
        for axis in range(3):
            for step in (-1, 1):
                for at in np.argwhere(full & ~np.roll(full, -step, axis)):
                    corner = at - 1
                    corner[axis] += step > 0
                    ring = [(0, 0), (1, 0), (1, 1), (0, 1)][::step]
                    others = [(axis + 1) % 3, (axis + 2) % 3]
                    face = []
                    for p, q in ring:
                        c = corner.copy()
                        c[others[0]] += p
                        c[others[1]] += q
                        if tuple(c) not in index:
                            index[tuple(c)] = len(self.vertices)
                            self.vertices.append(tuple(low + size * c))
                        face.append(index[tuple(c)])
                    self.faces.append(face)


def pick(rng, low, high):
    return low + (high - low) * rng.random()  # the one method whose values Python promises to keep


def blocky(rng, bottom):
    """Boxes and balls joined, others taken away, in voxels of 3 mm from `bottom` on."""
    size, low = 3.0, np.array([-90.0, -90.0, bottom])
    x, y, z = (low[i] + size * (np.arange(n) + 0.5) for i, n in enumerate((60, 60, 36)))
    at = np.meshgrid(x, y, z, indexing="ij")
    full = np.zeros(at[0].shape, bool)
    for i in range(8):
        c = [pick(rng, -50, 50), pick(rng, -50, 50), bottom + pick(rng, 10, 60)]
        half = [pick(rng, 12, 38) for _ in range(3)]
        if i % 2 == 0:
            inside = np.all([abs(a - m) < h for a, m, h in zip(at, c, half)], axis=0)
        else:
            inside = sum((a - m) ** 2 for a, m in zip(at, c)) < half[0] ** 2
        full = full | inside if i < 5 else full & ~inside
    mesh = Mesh()
    mesh.voxels(full, low, size)
    return mesh


def thin(rng):
    mesh = Mesh()
    for _ in range(8):
        a, r = (pick(rng, -80, 80), pick(rng, -70, 70), 2.0), pick(rng, 1.0, 2.0)
        mesh.rod(a, (a[0] + pick(rng, -50, 50), a[1] + pick(rng, -40, 40), pick(rng, 50, 120)), r, r)
    for _ in range(3):  # sheets: flat prisms of four sides
        c, turn, z = np.array([pick(rng, -60, 60), pick(rng, -50, 50), 0]), pick(rng, 0, math.pi), pick(rng, 30, 90)
        u = np.array([math.cos(turn), math.sin(turn), 0]) * 30
        v, n = np.array([0, 0, z]), np.array([-math.sin(turn), math.cos(turn), 0]) * 0.6
        corners = [c - u, c + u, c + u + v, c - u + v]
        mesh.add([p - n for p in corners] + [p + n for p in corners],
                 [[0, 1, 2, 3], [7, 6, 5, 4], *([i, i + 4, (i + 1) % 4 + 4, (i + 1) % 4] for i in range(4))])
    return mesh


def porous(rng):
    """A grid of bars on four legs, tilted."""
    mesh = Mesh()
    pitch, r = pick(rng, 12, 18), pick(rng, 1.5, 2.5)
    z0, slope = pick(rng, 45, 70), pick(rng, -0.25, 0.25)
    top = lambda x: z0 + slope * x  # noqa: E731
    n = int(75 / pitch)
    for i in range(-n, n + 1):
        mesh.rod((-80, i * pitch, top(-80)), (80, i * pitch, top(80)), r, r, 6)
        mesh.rod((i * pitch, -75, top(i * pitch)), (i * pitch, 75, top(i * pitch)), r, r, 6)
    for x, y in ((-70, -65), (70, -65), (70, 65), (-70, 65)):
        mesh.rod((x, y, 0), (x, y, top(x)), 3, 3)
    return mesh


def twigs(rng):
    mesh = Mesh()

    def grow(at, towards, length, r, level):
        end = at + length * towards
        mesh.rod(at, end, r, 0.7 * r, 6)
        for _ in range(3 if level else 0):
            t = towards + np.array([pick(rng, -1, 1), pick(rng, -1, 1), pick(rng, -0.3, 0.5)])
            grow(at + pick(rng, 0.5, 1.0) * (end - at), t / np.linalg.norm(t), length * pick(rng, 0.55, 0.75), 0.65 * r, level - 1)

    grow(np.zeros(3), np.array([0.0, 0.0, 1.0]), 60.0, 5.0, 4)
    return mesh


def generate(kind, seed, folder):
    """Writes the object's .obj and scene. @return the scene"""
    rng = random.Random(seed)
    mesh = {"solid": lambda: blocky(rng, 0.0), "thin": lambda: thin(rng), "porous": lambda: porous(rng),
            "hanging": lambda: blocky(rng, 40 + 20 * rng.random()), "twigs": lambda: twigs(rng)}[kind]()
    name = f"{kind}{seed}"
    lines = [f"# {name}: mm, z up", f"o {name}", "usemtl kd0.5_ks0_n0"]
    lines += ["v " + " ".join(f"{c + 0.0:.3f}" for c in v) for v in mesh.vertices]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in mesh.faces]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    scene = folder / f"{name}.toml"
    ground = floor(0.0, -1000, 1000, -1000, 1000).replace("stone", "ground")
    scene.write_text(f'schema = 1\nname = "{name}"\n\n[[material]]\nname = "ground"\nkd = [0.8]\n\n{ground}'
                     f'[[mesh]]\nfile = "{name}.obj"\n')
    return scene


def vertices_of(scene):
    """Of its .obj, without the ground's corners."""
    lines = (scene.parent / f"{scene.stem}.obj").read_text().splitlines()
    found = [tuple(map(float, line.split()[1:4])) for line in lines if line.startswith("v ")]
    return [v for v in found if max(map(abs, v)) < 999]


# ---- rigs --------------------------------------------------------------------------------------

OBJECT_CENTRE = np.array([0.0, 0.0, 45.0])
LED = {"watts": 5.0, "max_watts": 5120.0, "emitter": [28.0, 28.0], "lobe_mu": 1.0}


def array(side):
    """One face of side x side LEDs over cube32's 960 mm."""
    return [{"id": "top", "centre": [0.0, 0.0, 900.0], "u": [1.0, 0.0, 0.0], "v": [0.0, 1.0, 0.0],
             "emits": [0.0, 0.0, -1.0], "rows": side, "cols": side, "pitch": 960.0 / side}]


def dome(rings=((15, 6), (30, 12), (48, 18), (65, 24)), radius=900.0):
    """60 LEDs around the origin, which they face: (degrees from the zenith, how many) of each ring."""
    faces = []
    for i, (tilt, n) in enumerate(rings):
        for k in range(n):
            turn, a = 2 * math.pi * (k + 0.5 * (i % 2)) / n, math.radians(tilt)
            out = np.array([math.sin(a) * math.cos(turn), math.sin(a) * math.sin(turn), math.cos(a)])
            u = np.array([-math.sin(turn), math.cos(turn), 0.0])
            faces.append({"id": f"led{len(faces)}", "centre": list(map(float, radius * out)),
                          "u": list(map(float, u)), "v": list(map(float, np.cross(u, out))),
                          "emits": list(map(float, -out)), "rows": 1, "cols": 1, "pitch": 28.0})
    return faces


RIGS = {"cube32": array(32), "grid16": array(16), "grid8": array(8), "dome60": dome()}


def positions(faces):
    """(lights, 3), mm, in the order of the rig file's lights."""
    lights = []
    for face in faces:
        c, u, v = (np.array(face[key]) for key in ("centre", "u", "v"))
        lights += [c + face["pitch"] * ((col - 0.5 * (face["cols"] - 1)) * u + (row - 0.5 * (face["rows"] - 1)) * v)
                   for row in range(face["rows"]) for col in range(face["cols"])]
    return np.array(lights)


def nearest_lights(rig, lights):
    """The rig's lights in the directions of cube32's, as seen from the object."""
    def towards(name):
        p = positions(RIGS[name]) - OBJECT_CENTRE
        return p / np.linalg.norm(p, axis=1, keepdims=True)
    nearest = [int(np.argmax(towards(rig) @ towards("cube32")[k])) for k in lights]
    if len(set(nearest)) < len(lights):
        raise SystemExit(f"{rig} has too few lights for a row of {len(lights)}: leave it out of --lights")
    return nearest


def rig_text(rig, is_ideal, finer=1):
    """cube32's file with other lights; ideal: 16 bits, and so many electrons that their noise is 2e-5; a camera
    that is `finer` times as fine."""
    text = (SOURCE / "configs/rigs/cube32.toml").read_text()
    if rig != "cube32":
        faces = "".join("[[face]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in {**face, **LED}.items())
                        + "\n" for face in RIGS[rig])
        text, n = re.subn(r"(?s)\[\[face\]\].*?(?=\[\[plane\]\])", faces, text)
        assert n == 1
    if is_ideal:
        for key, value in (("noise", "{ gain = 1e6, read = 0.0, full_well = 6.4e10, black = 256.0 }"), ("bits", "16")):
            text, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", text)
            assert n == 1
    if finer != 1:
        proof, (w, h) = 8, (int(320 * finer), int(240 * finer))  # rows below the picture
        for key, value in (("size", f"[{w}, {h + proof}]"), ("active_area", h), ("K", "[[%s, 0.0, %s], [0.0, %s, %s], "
                           "[0.0, 0.0, 1.0]]" % (439.596387 * finer, w / 2, 439.596387 * finer, h / 2))):
            text, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", text)
            assert n == 1
    return text


# ---- captures ----------------------------------------------------------------------------------

OTHER_SIDE = """world_from_cam = [
    [-1, 0, 0, 0],
    [0, 0.643509750887, -0.765437914212, 560],
    [0, -0.765437914212, -0.643509750887, 520]]"""


def capture(programs, rig_text, compress, scene, is_second, target, starts_within=300):
    """Picture by picture on the virtual rig, then compressed, as the demo does. `compress`: options."""
    folder = target.parent / f"{target.stem}.capture"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    if is_second:
        rig_text, n = re.subn(r"world_from_cam = \[\n.*\n.*\n.*\]\]", OTHER_SIDE, rig_text)
        assert n == 1
    (folder / "cube32.toml").write_text(rig_text)
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    rig_on_free_ports(folder / "cube32.toml", folder / "rig.toml", folder, port)
    virtual = VirtualRig(programs, folder / "rig.toml", scene, folder, url,
                         starts_within=starts_within)
    try:
        require(programs.run("capture", SOURCE / "configs/plans/highlights.toml", "--daemon", url, "-o",
                             folder / "session", "--quiet", timeout=1200))
    finally:
        virtual.end()
    require(programs.run("compress", folder / "session", "-o", folder / "basis.hlb", *compress, "--quiet",
                         timeout=1200))
    (folder / "basis.hlb").rename(target)
    shutil.rmtree(folder)


def require(done):
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, done.args))}\n{done.stderr}")


# ---- rows --------------------------------------------------------------------------------------


def measure(programs, job, source, folder):
    """One row: each method's picture beside one ray-traced truth. @return what the table shows"""
    folder.mkdir(parents=True, exist_ok=True)
    words = ["shadow", *job["captures"], "--scene", job["receiver"], "--size", SIZE, "--subpixels", "1", "--quiet",
             "--force"]
    words += ["--object-height", ",".join(f"{h:g}" for h in job["height"])] if job["height"] else []
    words += [w for k in source for w in ("--light", k)] if isinstance(source, list) else ["--cubemap", source]
    start = time.monotonic()
    for method in METHODS:
        truth = ["--truth-object", job["scene"], "--truth", folder / "truth.tif", "--spread",
                 folder / "spread.tif"] if method == "both" else []
        require(programs.run(*words, *truth, "--method", method, "-o", folder / f"{method}.tif", "--unseen",
                             folder / f"{method}_unseen.tif", "--report", folder / f"{method}.json", timeout=3600))
    said = json.loads((folder / "both.json").read_text())["reached"]
    pictures = {name: read_tif(folder / f"{name}.tif") for name in ("truth", "plane_unseen", *METHODS)}
    # What "plane" did not see is half the distance between all of it lit and all of it dark.
    pictures["lit"] = pictures["plane"] + pictures["plane_unseen"]
    pictures["dark"] = pictures["plane"] - pictures["plane_unseen"]
    # The truth is traced once: the errors of the others in the unit of the reported one.
    distance = {name: float(np.abs(pictures[name] - pictures["truth"]).sum()) for name in COLUMNS}
    row = {name: said["shadow_wrong_share"] * distance[name] / distance["both"] for name in COLUMNS}
    return {**row, "from_hull": said["hull_fraction"], "missing": said.get("missing_share"),
            "holds": said["spread_holds_truth_share"], "spread": said["spread_median"] / said["spread_rms_error"],
            "seconds": round(time.monotonic() - start, 1)}


def write_picture(path, folders):
    """A line per row: truth, what is hidden taken as lit, `plane`, `both`, and what is wrong in `both`: red too bright,
    blue too dark, full at a quarter of the truth's brightest value. Three times the size."""
    lines = []
    for folder in folders:
        truth, plane, unseen, both = (read_tif(folder / f"{name}.tif")[:, ::3] for name in
                                      ("truth", "plane", "plane_unseen", "both"))  # of the RGB, red
        seen = truth.any(1)
        truth, plane, unseen, both = (p[seen] for p in (truth, plane, unseen, both))
        grey = [np.clip(255 * np.clip(p / truth.max(), 0, 1) ** (1 / 2.2), 0, 255)[..., None].repeat(3, 2)
                for p in (truth, plane + unseen, plane, both)]
        wrong = np.clip(4 * (both - truth) / truth.max(), -1, 1)[..., None]
        grey.append(255 - 255 * np.abs(wrong) * np.where(wrong > 0, [0, 1, 1], [1, 1, 0]))
        lines.append(np.concatenate(grey, 1))
    picture = np.concatenate(lines, 0).round().astype(np.uint8).repeat(3, 0).repeat(3, 1)
    path.write_bytes(png_bytes(picture.shape[1], picture.shape[0], [row.tobytes() for row in picture], True))


def json_rows(file, make):
    """What the file holds, or what is made now and kept there."""
    if not file.exists():
        made = make()
        file.write_text(json.dumps(made))
    return json.loads(file.read_text())


def line(cells):
    print("| " + " | ".join(cells) + " |", flush=True)


def percent(value):
    return f"{100 * value:.1f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", help="the build's folder apps/")
    parser.add_argument("--work", required=True, help="folder for everything that is made")
    parser.add_argument("--finer", type=int, default=1, help="pixels of the camera per pixel of cube32's, in each axis")
    parser.add_argument("--objects", default="airplane,blocks," + ",".join(KINDS),
                        help="scenes of configs/scenes, or kinds to be generated")
    parser.add_argument("--seed", type=int, default=1, help="of generated objects")
    parser.add_argument("--receivers", default=",".join(RECEIVERS))
    parser.add_argument("--lights", default=",".join(LIGHTS))
    parser.add_argument("--rig", choices=RIGS, default="cube32", help="the array of lights; the camera is cube32's")
    parser.add_argument("--ideal", action="store_true", help="capture without noise, compressed to 1e-4")
    parser.add_argument("--views", default="1,2", help="cameras: 1, 2 (the other one on the other side), or 1,2")
    parser.add_argument("--picture", type=pathlib.Path, help="PNG: the rows' pictures below each other")
    arguments = parser.parse_args()
    programs, work = Programs(arguments.bin), pathlib.Path(arguments.work).resolve()
    made = work / (arguments.rig + ("_ideal" if arguments.ideal else "") +
                   (f"_finer{arguments.finer}" if arguments.finer != 1 else ""))
    made.mkdir(parents=True, exist_ok=True)
    rig = rig_text(arguments.rig, arguments.ideal, arguments.finer)
    (made / "rig.toml").write_text(rig)
    receivers = write_receivers(work / "receivers")
    LIGHTS["sun"] = work / "sun.hdr"
    write_sun(LIGHTS["sun"])
    line(["object", "views", "receiver", "light", "hidden lit", "hidden dark", *(f"`{m}`" for m in METHODS),
          "spread holds", "spread/rms"])
    line(["---"] * 11)
    rows, folders = [], []
    for views in map(int, arguments.views.split(",")):
        for thing in arguments.objects.split(","):
            scene = generate(thing, arguments.seed, work) if thing in KINDS else SOURCE / f"configs/scenes/{thing}.toml"
            files = [made / f"{scene.stem}.hlb", made / f"{scene.stem}_other_side.hlb"][:views]
            for i, file in enumerate(files):
                if not file.exists():
                    capture(programs, rig, ["--max-error", "1e-4"] if arguments.ideal else [], scene, i == 1, file,
                            300 * arguments.finer**2)
            job = {"captures": [files[0], *(w for f in files[1:] for w in ("--also", f))], "scene": scene}
            vertices = vertices_of(scene)
            job["height"] = [76, 128] if thing == "airplane" else [f(v[2] for v in vertices) for f in (min, max)]
            for receiver in arguments.receivers.split(","):
                if any(z < RECEIVERS[receiver][1](x, y) - 0.01 for x, y, z in vertices):
                    line([scene.stem, str(views), receiver, "the object would stand in it", *[""] * 7])
                    continue
                for light in arguments.lights.split(","):
                    folder = made / "rows" / f"{scene.stem}-{views}-{receiver}-{light}"
                    folders.append(folder)
                    source = LIGHTS[light]
                    source = nearest_lights(arguments.rig, source) if isinstance(source, list) else source
                    rows.append(json_rows(folder / "row.json", lambda: measure(
                        programs, {**job, "receiver": receivers[receiver]}, source, folder)))
                    line([scene.stem, str(views), receiver, light, *(percent(rows[-1][c]) for c in COLUMNS),
                          percent(rows[-1]["holds"]), f"{rows[-1]['spread']:.1f}"])
    if arguments.picture:
        write_picture(arguments.picture, folders)
    for name, of in (("median", statistics.median), ("worst", max)):
        line([name, "", "", "", *(percent(of(row[c] for row in rows)) for c in COLUMNS), "", ""])


if __name__ == "__main__":
    main()
