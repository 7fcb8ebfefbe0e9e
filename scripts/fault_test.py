#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Captures the whole virtual rig with the real daemon while frames come late, twice, swapped, stale
or not at all and the controller restarts in mid-run; then decodes the embedded metadata rows of every stored
frame: each must have seen its own shot's light, and no other.

    scripts/fault_test.py [--share 0.01] [--restart 3.0] [--rig configs/rigs/cube32.toml]

Exit code 0 when every shot is there and right, and the faults did happen."""

import argparse
import json
import pathlib
import shutil
import struct
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from kill_test import HERE, Rig, wait_for  # noqa: E402


def tiff_rows(path, first, count):
    """Rows of an uncompressed little-endian 16-bit TIFF, as lists of words."""
    data = path.read_bytes()
    kind, magic, offset = struct.unpack_from("<2sHI", data)
    if kind != b"II" or magic != 42:
        raise ValueError(f"{path}: not a little-endian TIFF")
    tags = {}
    for i in range(struct.unpack_from("<H", data, offset)[0]):
        tag, form, n, value = struct.unpack_from("<HHII", data, offset + 2 + 12 * i)
        size = {3: 2, 4: 4}.get(form)
        if size is None:
            continue
        letter = {2: "H", 4: "I"}[size]
        at = offset + 2 + 12 * i + 8 if size * n <= 4 else value
        tags[tag] = struct.unpack_from(f"<{n}{letter}", data, at)
    width, per_strip, strips = tags[256][0], tags[278][0], tags[273]
    rows = []
    for y in range(first, first + count):
        start = strips[y // per_strip] + 2 * width * (y % per_strip)
        rows.append(struct.unpack_from(f"<{width}H", data, start))
    return rows


def crc16(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def decode_tag(rows):
    """(tag, is_mixed), as capture/camera/metadata_rows.h defines it; None when there is none."""
    height, width = len(rows), len(rows[0])
    side = max(s for s in range(2, height + 1) if (width // s) * (height // s) >= 96)
    columns = width // side
    sums = [sum(sum(rows[(i // columns) * side + y][(i % columns) * side:(i % columns) * side + side])
                for y in range(side)) for i in range(96)]
    middle = (min(sums) + max(sums)) / 2
    number = int("".join("1" if s > middle else "0" for s in sums), 2)
    sync, tag, flags = number >> 88, (number >> 56) & 0xFFFFFFFF, (number >> 48) & 0xFF
    inverse, crc = (number >> 16) & 0xFFFFFFFF, number & 0xFFFF
    if sync != 0xB2 or inverse != tag ^ 0xFFFFFFFF or crc != crc16(struct.pack(">IB", tag, flags)):
        return None
    return tag, bool(flags & 1)


def wrong_frames(session):
    info = json.loads((session / "session.json").read_text())
    form = info["form"]
    wrong = []
    seen = set()
    for frame in info["frames"]:
        rows = tiff_rows(session / frame["file"], form["height"],
                         form["stored_height"] - form["height"])
        seen.add(frame["shot"])
        if decode_tag(rows) != (frame["shot"] + 1, False):
            wrong.append((frame["shot"], decode_tag(rows)))
    missing = [s["index"] for s in info["shots"] if s["index"] not in seen]
    return len(info["shots"]), wrong, missing


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bin", default=str(HERE / "build/release/apps"))
    parser.add_argument("--rig", default="configs/rigs/cube32.toml")
    parser.add_argument("--scene", default="configs/scenes/empty.toml")
    parser.add_argument("--plan", default="configs/plans/quick.toml")
    parser.add_argument("--share", type=float, default=0.01, help="of frames, for each fault")
    parser.add_argument("--restart", type=float, default=3.0, help="seconds, 0 = never")
    parser.add_argument("--cache", default="")
    args = parser.parse_args()
    folder = pathlib.Path(tempfile.mkdtemp(prefix="haarlight-fault."))
    faults = folder / "faults.toml"
    faults.write_text(
        f"[frames]\nlate_share = {args.share}\nlate_ms = 30.0\ndrop_share = {args.share}\n"
        f"duplicate_share = {args.share}\nstale_share = {args.share}\nswap_share = {args.share}\n" +
        (f"[[restart]]\nat_s = {args.restart}\noff_ms = 300\n" if args.restart > 0 else ""))
    args.more = ["--faults", faults] + (["--cache", args.cache] if args.cache else [])
    rig = Rig(args, folder)
    try:
        rig.start()
        wait_for(lambda: rig.state()["phase"] == "idle", 30)
        begin = time.monotonic()
        session = rig.begin((HERE / args.plan).read_bytes())
        wait_for(lambda: rig.state()["phase"] == "done", 1200, 0.2)
        seconds = time.monotonic() - begin
        n_shots, wrong, missing = wrong_frames(folder / "sessions" / session)
        counters = {line.split()[0].removeprefix("haarlight_"): float(line.split()[1])
                    for line in rig.text("/metrics").splitlines()
                    if line.startswith("haarlight_") and "_total" in line}
        print(f"{n_shots - len(missing)} of {n_shots} shots committed in {seconds:.1f} s, "
              f"{counters['frames_total']:.0f} frames ({counters['frames_total'] / n_shots:.2f} a "
              f"shot); {len(wrong)} decoded to another light")
        print("  " + ", ".join(f"{name.removesuffix('_total')} {value:.0f}"
                               for name, value in counters.items() if value))
        for shot, seen in wrong[:20]:
            print(f"shot {shot}: decoded {seen}")
        n_broken = sum(counters[name] for name in
                       ("sequence_gaps_total", "frames_out_of_order_total", "duplicates_total"))
        if args.share > 0 and n_broken == 0 or args.restart > 0 and not counters["controller_reboots_total"]:
            print("the faults did not happen")
            return 1
        return 1 if wrong or missing else 0
    finally:
        rig.end()
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
