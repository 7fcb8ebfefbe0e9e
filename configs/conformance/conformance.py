#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Does a renderer show what closed forms say? Needs NumPy.

    conformance.py write DIR                       the scenes: NAME.json, and NAME.toml as haarlight reads it, with meshes
    conformance.py render DIR --haarlight PROGRAM  pictures by haarlight: NAME.SEED.npy; further options go to `render surface`
    conformance.py score DIR                       the table of what is in DIR; exit code 1: differs, 2: too noisy to tell

Another renderer: render NAME.json with at least four seeds each, and write the pictures to DIR as NAME.SEED.npy (height, width, 3)
or NAME.SEED.pfm, linear, without a denoiser or clamping. README.md has the formats, with_cycles.py is an example.
"""

import argparse
import functools
import json
import math
import pathlib
import subprocess
import sys

import numpy as np

import scenes

ALPHA = 0.01  # chance that a right renderer fails in any of the scenes
WEAK = 3e-4  # standard error over value: with more, faults pass unseen
LEAST_SEEDS = 4


# ---- statistics -----------------------------------------------------------------------------------


def t_tail(t, freedom):
    """P(|T| > t) of Student's distribution: the incomplete beta function by its continued fraction [Lentz 1976]."""
    a, b, x = freedom / 2.0, 0.5, freedom / (freedom + t * t)
    if t == 0.0:
        return 1.0
    front = math.exp(math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x))
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - front * _beta_fraction(b, a, 1.0 - x) / b
    return front * _beta_fraction(a, b, x) / a


def _beta_fraction(a, b, x):
    tiny = 1e-300
    c, d = 1.0, 1.0 / max(1.0 - (a + b) * x / (a + 1.0), tiny)
    value = d
    for m in range(1, 400):
        for step in (m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)), -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))):
            d = 1.0 / (1.0 + step * d or tiny)
            c = 1.0 + step / c or tiny
            value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value


def t_limit(alpha, freedom):
    """The t that |T| exceeds with probability alpha."""
    low, high = 0.0, 1.0
    while t_tail(high, freedom) > alpha:
        high *= 2.0
    for _ in range(200):
        middle = (low + high) / 2.0
        low, high = (middle, high) if t_tail(middle, freedom) > alpha else (low, middle)
    return high


# ---- files ----------------------------------------------------------------------------------------


def read_pfm(path):
    with path.open("rb") as file:
        kind, size, scale = file.readline().strip(), file.readline().split(), float(file.readline())
        channels = {b"PF": 3, b"Pf": 1}.get(kind)
        if channels is None:
            raise SystemExit(f"{path}: no PFM picture")
        width, height = map(int, size)
        values = np.frombuffer(file.read(), "<f4" if scale < 0 else ">f4", width * height * channels)
    return values.reshape(height, width, channels)[::-1].astype(float)


def read_picture(path):
    picture = np.load(path) if path.suffix == ".npy" else read_pfm(path)
    if picture.shape != (scenes.SIDE, scenes.SIDE, 3):
        raise SystemExit(f"{path}: is of shape {picture.shape}, not {(scenes.SIDE, scenes.SIDE, 3)}")
    if not np.isfinite(picture).all():
        raise SystemExit(f"{path}: has pixels that are not finite")
    return picture.astype(float)


def write_obj(path, part):
    points, faces = scenes.ball(part["radius"], part["subdivisions"], part["inwards"])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    path.write_text("\n".join(lines) + "\n")


def numbers(values):
    return "[" + ", ".join(numbers(v) if isinstance(v, (list, tuple)) else repr(float(v)) for v in values) + "]"


def toml_of(scene):
    """As haarlight reads it: docs/reference/scene-file.md."""
    lines, names = ["schema = 1", f'name = "{scene["name"]}"', ""], {}

    def material(part):
        look = (part.get("kind", "matte"), part.get("albedo", 0.0), tuple(part.get("emits") or ()))
        if look not in names:
            names[look] = f"surface {len(names)}"
            lines.extend(["[[material]]", f'name = "{names[look]}"'])
            lines.extend({"matte": [f"kd = [{look[1]!r}]"], "mirror": ['bsdf = "mirror"'],
                          "glass": ['bsdf = "dielectric"', "ior = 1.5"]}[look[0]])
            lines.extend([f"emits = {numbers(look[2])}"] if look[2] else [])
            lines.append("")
        return names[look]

    def table(kind, *keys):
        lines.extend([f"[[{kind}]]", *keys, ""])
    for part in scene.get("quads", []):
        table("quad", *(f'material = "{material(part)}"', f"corners = {numbers(part['corners'])}"))
    for part in scene.get("disks", []):
        table("disk", *(f'material = "{material(part)}"', f"centre = {numbers(part['centre'])}", "normal = [0, 0, -1]",
                        f"radius = {part['radius']!r}"))
    for part in scene.get("spheres", []):
        table("sphere", *(f'material = "{material(part)}"', f"centre = {numbers(part['centre'])}", f"radius = {part['radius']!r}",
                          "exact = true"))
    for part in scene.get("meshes", []):
        table("mesh", *(f'material = "{material(part)}"', f'file = "{part["file"]}"'))
    for part in scene.get("points", []):
        table("light", 'kind = "point"', f"position = {numbers(part['position'])}", f"intensity = {numbers(part['intensity'])}")
    for part in scene.get("suns", []):
        table("light", 'kind = "directional"', f"direction = {numbers(part['direction'])}",
              f"irradiance = {numbers(part['irradiance'])}")
    if "sky" in scene:
        lines.extend(["[environment]", 'file = "even.hdr"', f"scale = {scene['sky']!r}", ""])
    view = scene["camera"]
    lines.extend(["[camera]", f"size = [{view['size']}, {view['size']}]"] +
                 [f"{key} = {numbers(view[key])}" for key in ("eye", "target", "up")] + [f"width_mm = {view['width']!r}", ""])
    return "\n".join(lines)


def write(folder):
    folder.mkdir(parents=True, exist_ok=True)
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
    (folder / "even.hdr").write_bytes(header + bytes([128, 128, 128, 129]) * 32)
    for name, make in scenes.SCENES.items():
        scene = {"name": name, **make()}
        for i, part in enumerate(scene.get("meshes", [])):
            part["file"] = f"{name}_{i}.obj"
            write_obj(folder / part["file"], part)
        plain = {key: value for key, value in scene.items() if key != "faults"}
        plain["truth"] = scene["truth"].tolist()
        (folder / f"{name}.json").write_text(json.dumps(plain, indent=1))
        (folder / f"{name}.toml").write_text(toml_of(scene))
    print(f"{folder}: {len(scenes.SCENES)} scenes")


def render(folder, haarlight, seeds, words):
    sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "bench"))
    from float_tif import read_tif
    for name in scenes.SCENES:
        for seed in range(seeds):
            picture = folder / "picture.tif"
            subprocess.run([haarlight, "render", "surface", folder / f"{name}.toml", "-o", picture, "--force", "--quiet",
                            "--seed", str(seed), *words], check=True, stdout=subprocess.DEVNULL)
            np.save(folder / f"{name}.{seed}.npy", read_tif(picture).reshape(scenes.SIDE, scenes.SIDE, 3))
            picture.unlink()


@functools.cache
def scene_of(name):
    return scenes.SCENES[name]()


# ---- the table ------------------------------------------------------------------------------------


def score(folder):
    pictures = {name: sorted([*folder.glob(f"{name}.*.npy"), *folder.glob(f"{name}.*.pfm")]) for name in scenes.SCENES}
    rendered = {name: paths for name, paths in pictures.items() if paths}
    if not rendered:
        raise SystemExit(f"{folder}: no pictures; NAME.SEED.npy or NAME.SEED.pfm are looked for")
    alpha = 1.0 - (1.0 - ALPHA) ** (1.0 / len(rendered))  # Sidak
    print("| scene | seeds | off % | sigma % | t, limit | | faults that would be seen |\n|---|---|---|---|---|---|---|")
    differs = weak = False
    for name, paths in pictures.items():
        if not paths:
            print(f"| `{name}` | 0 | | | | not rendered | |")
            continue
        if len(paths) < LEAST_SEEDS:
            raise SystemExit(f"{folder}: {len(paths)} pictures of {name}; {LEAST_SEEDS} seeds at least")
        scene = scene_of(name)
        ratios = np.array([(read_picture(path).mean(axis=(0, 1)) / scene["truth"]).mean() - 1.0 for path in paths])
        n, mean = len(ratios), ratios.mean()
        sigma = ratios.std(ddof=1) / math.sqrt(n)
        limit = t_limit(alpha, n - 1)
        allowed = limit * sigma + scene["rounding"]
        is_off, is_weak = abs(mean) > allowed, sigma > WEAK
        differs, weak = differs or is_off, weak or is_weak
        word = "**differs**" if is_off else "weak" if is_weak else "ok"
        # A fault is seen, with more than 99 of 100 seeds, where it is off by what is allowed and 2.6 standard errors more.
        seen, unseen = [], []
        for fault, value in scene["faults"].items():
            size = abs((value / scene["truth"]).mean() - 1.0)
            (seen if size > allowed + 2.6 * sigma else unseen).append(f"{fault} ({100 * size:.2g} %)")
        told = "; ".join(seen) + ("; not: " + "; ".join(unseen) if unseen else "")
        t = mean / sigma if sigma > 0.0 else math.copysign(math.inf, mean) if mean else 0.0
        print(f"| `{name}` | {n} | {100 * mean:+.4f} | {100 * sigma:.4f} | {t:+.2f}, {limit:.2f} | {word} | {told} |")
    print(f"\nA right renderer differs in any scene with probability {ALPHA}; weak: sigma above {100 * WEAK:.2g} %.")
    return 1 if differs else 2 if weak else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    for verb in ("write", "render", "score"):
        one = verbs.add_parser(verb)
        one.add_argument("folder", type=pathlib.Path, metavar="DIR")
        if verb == "render":
            one.add_argument("--haarlight", required=True, metavar="PROGRAM")
            one.add_argument("--seeds", type=int, default=16)
    arguments, words = parser.parse_known_args()
    if words and arguments.verb != "render":
        parser.error(f"unknown: {' '.join(words)}")
    if arguments.verb == "write":
        write(arguments.folder)
    elif arguments.verb == "render":
        render(arguments.folder, arguments.haarlight, arguments.seeds, words)
    else:
        sys.exit(score(arguments.folder))


if __name__ == "__main__":
    main()
