# SPDX-License-Identifier: Apache-2.0
"""Pictures and arrays that haarlight writes, read without the libraries that wrote them; a mesh that it refuses."""

import array
import ast
import re
import struct
import zlib

try:
    import numpy
except ImportError:
    numpy = None


def read_exr(path):
    """Channels of an .exr of floats in scan lines, by name: lists of values, row by row."""
    data = path.read_bytes()
    assert struct.unpack_from("<iI", data) == (20000630, 2), "one part, scan lines"
    attributes, at = {}, 8
    while data[at]:
        name, kind, rest = data[at:at + 600].split(b"\0", 2)
        at += len(name) + len(kind) + 2
        size, = struct.unpack_from("<i", data, at)
        attributes[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    at += 1
    assert attributes[b"compression"] == b"\3", "deflated, 16 rows at a time"
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names = re.findall(rb"([A-Za-z.]+)\0\x02\0\0\0.{12}", attributes[b"channels"], re.S)
    channels = {name.decode(): array.array("f") for name in names}
    for offset in struct.unpack_from(f"<{-(-height // 16)}Q", data, at):
        row, size = struct.unpack_from("<ii", data, offset)
        rows = min(16, height - (row - top))
        block = data[offset + 8:offset + 8 + size]
        if size < 4 * width * rows * len(names):
            packed = bytearray(zlib.decompress(block))
            for i in range(1, len(packed)):
                packed[i] = (packed[i - 1] + packed[i] - 128) & 255
            block = bytearray(len(packed))
            block[0::2], block[1::2] = packed[:(len(packed) + 1) // 2], packed[(len(packed) + 1) // 2:]
        for i in range(rows):
            for k, values in enumerate(channels.values()):
                begin = 4 * width * (i * len(names) + k)
                values.frombytes(bytes(block[begin:begin + 4 * width]))
    return width, height, channels


def read_npy(path):
    """Shape and values of an array of doubles: by NumPy where it is installed."""
    if numpy is not None:
        read = numpy.load(path)
        assert read.dtype == numpy.float64
        return read.shape, read.ravel().tolist()
    data = path.read_bytes()
    assert data[:8] == b"\x93NUMPY\1\0"
    begin = 10 + struct.unpack_from("<H", data, 8)[0]
    header = ast.literal_eval(data[10:begin].decode())
    assert header["descr"] == "<f8" and not header["fortran_order"]
    return header["shape"], array.array("d", data[begin:]).tolist()


def with_overlap(mesh):
    """A .vtu of the cube with a tetrahedron more, of points of its own, where others are."""
    points = "0.05 0.05 0.05 0.3 0.05 0.05 0.3 0.3 0.05 0.3 0.3 0.3"
    return re.sub(r"(?s)<Piece .*?</Piece>", lambda piece: piece[0] + f"""
<Piece NumberOfPoints="4" NumberOfCells="1">
<PointData><DataArray type="Float64" Name="linear" format="ascii">0 0 0 0</DataArray></PointData>
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">{points}</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">10</DataArray></Cells>
</Piece>""", mesh)


def read_png(data):
    """Width, height and samples of a .png of 8-bit colours, not interlaced."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if kind == b"IHDR":
            width, height, depth, colours, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, at + 8)
            assert (depth, colours, interlaced) == (8, 2, 0)
        elif kind == b"IDAT":
            packed += data[at + 8:at + 8 + size]
        at += size + 12
    rows, stride = zlib.decompress(packed), 3 * width
    samples, above = bytearray(), bytearray(stride)
    for y in range(height):
        begin = y * (stride + 1)
        way, row = rows[begin], bytearray(rows[begin + 1:begin + 1 + stride])
        for i in range(stride if way else 0):
            left, up, corner = (row[i - 3], above[i], above[i - 3]) if i >= 3 else (0, above[i], 0)
            if way == 4:
                guess = left + up - corner
                add = min((left, up, corner), key=lambda value, guess=guess: abs(guess - value))
            else:
                add = (0, left, up, (left + up) // 2)[way]
            row[i] = (row[i] + add) & 255
        samples += row
        above = row
    return width, height, bytes(samples)
