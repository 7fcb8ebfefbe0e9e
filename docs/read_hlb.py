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

def plate_terms(height, width, degree):  # products of Chebyshev polynomials, (terms, pixels)
    x, y = ([np.cos(k * np.arccos((2 * np.arange(s) + 1) / s - 1)) for k in range(degree + 1)] for s in (width, height))
    return np.array([np.outer(b, a).ravel() for b in y for a in x])

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
                    elif k:
                        both = inflate(packed, 8 * k)
                        cells = begin * p + np.cumsum(numbers(both[:4 * k]).astype("i8") + 1) - 1
                        values[order[cells // p], cells % p] = signed(numbers(both[4 * k:])).view("<i4")
                if head["coding"] == "quantised":
                    values = np.ascontiguousarray(values.T * (head["step"] / 2.0 ** raw[:p, None]))
                    if haar:
                        inverse_haar(values.reshape(-1, n, n))
                    gain = head["plate"]["gain_step"] * signed(numbers(raw[p:5 * p])).cumsum(dtype="u4").view("<i4")
                    u = numbers(raw[5 * p:]).view("<f4").reshape(rank, terms) @ plate_terms(*view.shape[:2], head["plate"]["degree"])
                    values = (values + (gain * u).T @ tables[:rank * lights].reshape(rank, lights)).T
                view[:] = values.T.reshape(view.shape)
    return out

if __name__ == "__main__":
    np.save(sys.argv[2], read_hlb(sys.argv[1]))
