# SPDX-License-Identifier: Apache-2.0
"""A project of somebody else's against an installed haarlight."""

import os
import pathlib
import subprocess

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent


def check(prefix, folder):
    """Builds tests/consumer in `folder` against `prefix`, and relights with it."""
    made = folder / "consumer"
    for words in (
            [prefix / "bin/haarlight", "plate", SOURCE / "configs/rigs/small8.toml", "-o", "object.hlb"],
            ["cmake", "-S", SOURCE / "tests/consumer", "-B", made, f"-DCMAKE_PREFIX_PATH={prefix}",
             "-DCMAKE_BUILD_TYPE=Release"],
            ["cmake", "--build", made],
            [made / "relit", "object.hlb", SOURCE / "configs/environments/room.hdr", "relit.png"],
            [made / "compressed", "made.hlb"],
            [prefix / "bin/haarlight", "relight", "made.hlb", "--light", "9", "-o", "made.png"],
            [made / "everything"]):
        done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False,
                              cwd=folder, env={**os.environ, "CMAKE_GENERATOR": "Ninja"})
        assert done.returncode == 0, done.stdout + done.stderr
    assert (folder / "relit.png").read_bytes().startswith(b"\x89PNG")
