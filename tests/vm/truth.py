# SPDX-License-Identifier: Apache-2.0
"""What a session says about itself against what its frames show: metadata rows decoded, evidence checked.
Python's own library only."""

import copy
import json
import pathlib
import struct
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "scripts"))
from fault_test import decode_tag, tiff_rows  # noqa: E402


class Session:
    """The one session in a folder of sessions."""

    def __init__(self, folder):
        found = sorted(folder.glob("*/session.json"))
        if len(found) != 1:
            raise ValueError(f"{len(found)} finished sessions in {folder}")
        self.folder = found[0].parent
        self.info = json.loads(found[0].read_text())
        self.form = self.info["form"]
        self.frames = self.info["frames"]

    def pixels(self, frame):
        """All rows of a stored frame, embedded metadata rows too."""
        return tiff_rows(self.folder / frame["file"], 0, self.form["stored_height"])

    def raw(self, frame):
        """The same as bytes, little-endian words."""
        return b"".join(struct.pack(f"<{len(row)}H", *row) for row in self.pixels(frame))

    def wrong_pairings(self):
        """Frames whose embedded metadata rows show another light than their evidence, or a change of light."""
        decoded = [(frame, decode_tag(self.pixels(frame)[self.form["height"]:]))
                   for frame in self.frames]
        return [(frame["shot"], frame["evidence"]["tag"], seen) for frame, seen in decoded
                if seen is not None and seen != (frame["evidence"]["tag"], False)]

    def with_evidence_shifted(self):
        """The same frames, each with the evidence of the next: a session in which every pairing is wrong."""
        shifted = copy.copy(self)
        evidence = [frame["evidence"] for frame in self.frames]
        shifted.frames = [{**frame, "evidence": other}
                          for frame, other in zip(self.frames, evidence[1:] + evidence[:1])]
        return shifted

    def problems(self, n_shots):
        """A frame for every shot, each of which saw its own light and no other."""
        problems = []
        shots = self.info["shots"]
        seen = {frame["shot"] for frame in self.frames}
        if len(shots) != n_shots or len(seen) != n_shots:
            problems.append(f"{len(seen)} of {len(shots)} shots, {n_shots} wanted")
        for frame in self.frames:
            evidence = frame["evidence"]
            decoded = decode_tag(self.pixels(frame)[self.form["height"]:])
            if decoded is None:
                problems.append(f"shot {frame['shot']}: no tag can be decoded")
            elif decoded != (evidence["tag"], False):
                problems.append(f"shot {frame['shot']}: WRONG PAIRING: evidence has tag "
                                f"{evidence['tag']}, the frame saw {decoded}")
            if evidence["tag"] != evidence["tag_echo"]:
                problems.append(f"shot {frame['shot']}: tag {evidence['tag']}, echo "
                                f"{evidence['tag_echo']}")
        return problems


class Record:
    """Every frame that the simulated camera wrote, and the truth about it."""

    def __init__(self, folder, frame_bytes):
        raw = (folder / "frames.raw").read_bytes()
        lines = (folder / "frames.txt").read_text().splitlines()
        self.n = min(len(lines), len(raw) // frame_bytes)
        self.truth = {}
        for i in range(self.n):
            start, end, tag, is_mixed = map(int, lines[i].split())
            self.truth[raw[i * frame_bytes:(i + 1) * frame_bytes]] = (i, start, end, tag, is_mixed)

    def problems(self, session):
        """Each frame of the session is one that was written, under the light of its evidence, at a
        time within the evidence's. @return problems, latencies from exposure's end to timestamp in ns"""
        problems, latencies, used = [], [], {}
        for frame in session.frames:
            name, evidence = f"shot {frame['shot']}", frame["evidence"]
            truth = self.truth.get(session.raw(frame))
            if truth is None:
                problems.append(f"{name}: no such frame was written")
                continue
            i, start, end, tag, is_mixed = truth
            latencies.append(evidence["timestamp_ns"] - end)
            if i in used:
                problems.append(f"{name} and shot {used[i]} have the same frame")
            used[i] = frame["shot"]
            if tag != evidence["tag"] or is_mixed:
                problems.append(f"{name}: WRONG PAIRING: evidence has tag {evidence['tag']}, the frame "
                                f"was written under {tag}{', in a change' if is_mixed else ''}")
            if not evidence["t_exposure_start_ns"] <= start <= end <= evidence["t_exposure_end_ns"]:
                problems.append(
                    f"{name}: was exposed from {start} to {end}, its evidence says from "
                    f"{evidence['t_exposure_start_ns']} to {evidence['t_exposure_end_ns']}")
        return problems, latencies
