"""What a session says about itself against what its frames show: tag rows decoded, evidence checked.
Python's own library only."""

import json
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "scripts"))
from fault_test import decode_tag, tiff_rows  # noqa: E402


class Session:
    """The one session of a job folder."""

    def __init__(self, folder):
        found = sorted((folder / "sessions").glob("*/session.json"))
        if len(found) != 1:
            raise ValueError(f"{len(found)} finished sessions in {folder}/sessions")
        self.folder = found[0].parent
        self.info = json.loads(found[0].read_text())
        self.form = self.info["form"]
        self.frames = self.info["frames"]

    def pixels(self, frame):
        """All rows of a stored frame, tag rows too."""
        return tiff_rows(self.folder / frame["file"], 0, self.form["stored_height"])

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
