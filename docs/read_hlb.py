#!/usr/bin/python3
"""read_hlb.py FILE.hlb OUT.npy: a haarlight basis file as an array (channels, height, width, lights).
Needs python3-numpy and libzstd1 (Debian). The format is written down in docs/basis-format.md."""
import ctypes, json, struct, sys
import numpy as np

zstd = ctypes.CDLL("libzstd.so.1").ZSTD_decompress

def inflate(packed, size):
    raw = ctypes.create_string_buffer(max(size, 1))
    assert not size or not packed or zstd(raw, ctypes.c_size_t(size), packed, ctypes.c_size_t(len(packed))) == size
    return np.frombuffer(raw.raw[:size], "u1")

def numbers(raw): return raw.reshape(4, -1).T.copy().view("<u4").ravel()  # four byte planes
def signed(z): return (z >> 1) ^ (0 - (z & 1))  # zigzag; still unsigned, modulo 2^32

def inverse_haar(x):  # in place on (pixels, n, n)
    m = 1
    while m < x.shape[1]:
        s, dx, dy, d = (x[:, r:r + m, c:c + m].copy() for r in (0, m) for c in (0, m))
        for r, c, value in ((0, 0, s + dx + dy + d), (0, 1, s - dx + dy - d), (1, 0, s + dx - dy - d), (1, 1, s - dx - dy + d)):
            x[:, r:2 * m:2, c:2 * m:2] = value / 2
        m *= 2

def inverse_s(x):  # in place on (pixels, n, n), whole numbers
    m = 1
    while m < x.shape[1]:
        for axis in (1, 2):  # along y, then x
            v = x[:, :2 * m, :2 * m].swapaxes(1, axis)
            s, d = v[:, :m].copy(), v[:, m:].copy()
            b = s - (d >> 1)
            v[:, 0::2], v[:, 1::2] = b + d, b
        m *= 2

def chebyshev(size, degree):
    x, t = (2.0 * np.arange(size) + 1.0) / size - 1.0, [np.ones(size)]
    for k in range(1, degree + 1):
        t.append(x if k == 1 else 2.0 * x * t[-1] - t[-2])
    return t

def plate_direction(u, vectors, height, width, degree):  # (lights, pixels): sums in this order, see "Integers"
    x, y = chebyshev(width, degree), chebyshev(height, degree)
    terms = [np.outer(b, a).ravel() for b in y for a in x]
    out = np.zeros((vectors.shape[1], height * width))
    for row, vector in zip(u.astype(float), vectors.astype(float)):
        weight = np.zeros(height * width)
        for number, term in zip(row, terms):
            weight = weight + number * term
        out = out + weight * vector[:, None]
    return out

def integer_rows(packed, rows, p):  # (rows, p) whole numbers
    bits, at = np.frombuffer(packed[:rows], "u1").astype("i8"), rows
    low = np.zeros((rows, p), "i8")
    for row, w in enumerate(bits):
        size = (p * w + 7) // 8
        plain = np.unpackbits(np.frombuffer(packed[at:at + size], "u1"), bitorder="little")
        low[row] = plain[:p * w].reshape(p, w) @ (1 << np.arange(w))
        at += size
    return (signed(numbers(inflate(packed[at:], 4 * p * rows))).view("<i4").reshape(-1, p).astype("i8") << bits[:, None]) + low

def read_hlb(name):
    file = open(name, "rb").read()
    h_at, h_size, _, i_at, i_size, _, t_at, t_size = struct.unpack_from("<8Q", file, 24)
    head = json.loads(file[h_at:h_at + h_size])
    width, height, channels = (head["picture"][k] for k in ("width", "height", "channels"))
    tile, lights, n = head["tile"], head["lights"]["count"], head["lights"]["grid"]
    rank, terms = head["plate"]["rank"], (head["plate"]["degree"] + 1)**2
    haar = head["basis"] == "haar" and head["coding"] == "quantised"
    level = [max(i // n % n, i % n).bit_length() + (i // n**2) * 32 for i in range(lights)] if haar else [0] * lights
    order = np.argsort(level, kind="stable")
    tables = signed(numbers(inflate(file[t_at:t_at + t_size], 4 * lights * (rank + 4 * channels)))).view("<f4")
    index = np.frombuffer(file[i_at:i_at + i_size], [("at", "<u8"), ("sum", "<u8"), ("size", "<u4"), ("count", "<u4")])
    blocks, out = iter(index), np.zeros((channels, height, width, lights))
    for y in range(0, height, tile):
        for x in range(0, width, tile):
            for c in range(channels):
                view = out[c, y:y + tile, x:x + tile]
                p = view.shape[0] * view.shape[1]
                b = next(blocks)
                raw = inflate(file[b["at"]:b["at"] + b["size"]], 5 * p + 4 * rank * terms)
                values = np.zeros((lights, p))
                for begin, end in zip([0] + head["group_ends"], head["group_ends"]):
                    b = next(blocks)
                    packed, k = file[b["at"]:b["at"] + b["size"]], int(b["count"])
                    if head["coding"] == "lossless":
                        rows = signed(numbers(inflate(packed, 4 * p * (end - begin)))).reshape(-1, p)
                        values[begin:end] = rows.cumsum(0, dtype="u4").view("<f4")
                    elif head["coding"] == "integers":
                        if packed:
                            at = 4 + int.from_bytes(packed[:4], "little")
                            classes = inflate(packed[4:at], p)
                            for mine in (np.flatnonzero(classes == i) for i in range(4)):
                                if len(mine):
                                    size = 4 + int.from_bytes(packed[at:at + 4], "little")
                                    values[begin:end, mine] = integer_rows(packed[at + 4:at + size], end - begin, len(mine))
                                    at += size
                    elif k:
                        both = inflate(packed, 8 * k)
                        cells = begin * p + np.cumsum(numbers(both[:4 * k]).astype("i8") + 1) - 1
                        values[order[cells // p], cells % p] = signed(numbers(both[4 * k:])).view("<i4")
                if head["coding"] != "lossless":
                    gains = signed(numbers(raw[p:5 * p])).cumsum(dtype="u4").view("<i4") * head["plate"]["gain_step"]
                    plate = gains * plate_direction(numbers(raw[5 * p:]).view("<f4").reshape(rank, terms),
                        tables[:rank * lights].reshape(rank, lights), *view.shape[:2], head["plate"]["degree"])
                if head["coding"] == "quantised":
                    values = np.ascontiguousarray(values.T * (head["step"] / 2.0 ** raw[:p, None]))
                    if haar:
                        inverse_haar(values.reshape(-1, n, n))
                    values = values.T + plate
                elif head["coding"] == "integers":
                    values = np.ascontiguousarray(values.T.astype("i8"))
                    if head["basis"] == "haar":
                        inverse_s(values.reshape(-1, n, n))
                    units = np.array(head["units"])[:, None]
                    values = ((values.T + np.floor(plate / units + 0.5)) * units).astype("<f4")
                view[:] = values.T.reshape(view.shape)
    return out

if __name__ == "__main__":
    np.save(sys.argv[2], read_hlb(sys.argv[1]))
