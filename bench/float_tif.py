# SPDX-License-Identifier: Apache-2.0
"""Pictures as `haarlight ... -o NAME.tif` writes them, with nothing but NumPy."""

import struct
import zlib

import numpy as np


def read_tif(path):
    """One of haarlight's own: float strips, deflated, byte planes of differences."""
    data = path.read_bytes()
    at, = struct.unpack_from("<I", data, 4)
    tags = {}
    for i in range(struct.unpack_from("<H", data, at)[0]):
        tag, kind, n, value = struct.unpack_from("<HHII", data, at + 2 + 12 * i)
        width = {1: 1, 3: 2, 4: 4}.get(kind, 0)
        where = at + 2 + 12 * i + 8 if n * width <= 4 else value
        tags[tag] = np.frombuffer(data, f"<u{width}", n, where) if width else None
    width, channels = int(tags[256][0]), int(tags[277][0])
    rows = []
    for offset, n in zip(tags[273], tags[279]):
        coded = np.frombuffer(zlib.decompress(data[offset:offset + n]), np.uint8).reshape(-1, 4 * width, channels)
        planes = np.cumsum(coded, axis=1, dtype=np.uint8).reshape(len(coded), 4, width * channels)
        rows.append(np.ascontiguousarray(planes.transpose(0, 2, 1)).view(">f4")[..., 0])
    return np.concatenate(rows).astype(float)
