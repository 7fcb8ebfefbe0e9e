#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""read_hlb.py FILE.hlb OUT.npy: a haarlight basis file as an array (channels, height, width, lights).
Needs python3-numpy and libzstd1 (Debian). The format is written down in docs/reference/basis-format.md."""
import ctypes, json, struct, sys
import numpy as np

zstd = ctypes.CDLL("libzstd.so.1").ZSTD_decompress

def inflate(packed, size):
    raw = ctypes.create_string_buffer(max(size, 1))
    assert not size or not packed or zstd(raw, ctypes.c_size_t(size), packed, ctypes.c_size_t(len(packed))) == size
    return np.frombuffer(raw.raw[:size], "u1")

def numbers(raw): return raw.reshape(4, -1).T.copy().view("<u4").ravel()  # four byte planes
def signed(z): return (z >> 1) ^ (0 - (z & 1))  # zigzag; still unsigned, modulo 2^32

def steps(rows, cols):  # sides before each level, finest first
    while rows > 1 or cols > 1:
        yield rows, cols
        rows, cols = (rows + 1) // 2, (cols + 1) // 2

def pair_parts(n):  # along n lights, for each level: parts of a pair's two values in their sum
    counts, out = np.ones(n), []
    while len(counts) > 1:
        a, b = counts[:-1:2], counts[1::2]
        out.append((np.sqrt(a / (a + b)), np.sqrt(b / (a + b))))
        counts = np.append(a + b, counts[len(counts) // 2 * 2:])
    return out

def join(v, half, first, second):  # in place along the last axis: s and d to the values they came from
    s, d, odd = v[..., :len(first)].copy(), v[..., half:].copy(), v[..., half - 1].copy()
    v[..., 0:2 * len(first):2], v[..., 1:2 * len(first):2] = first * s + second * d, second * s - first * d
    if v.shape[-1] % 2:
        v[..., -1] = odd

def inverse_haar(x):  # in place on (pixels, rows, cols)
    rows, cols = x.shape[1:]
    along = pair_parts(rows), pair_parts(cols)
    for i, (r, c) in reversed(list(enumerate(steps(rows, cols)))):
        if r > 1:
            join(x[:, :r, :c].swapaxes(1, 2), (r + 1) // 2, *along[0][i])
        if c > 1:
            join(x[:, :r, :c], (c + 1) // 2, *along[1][i])

def inverse_standard(x):  # in place on (pixels, rows, cols): every column through all levels, then every row
    for v in (x.swapaxes(1, 2), x):
        m = 2
        while m <= v.shape[-1]:
            join(v[..., :m], m // 2, *(np.full(m // 2, np.sqrt(0.5)),) * 2)
            m *= 2

def dct(n):  # (frequencies, lights)
    i, k = np.arange(n)[:, None], np.arange(n)
    return np.sqrt(np.where(i == 0, 1.0, 2.0) / n) * np.cos(np.pi * ((2 * k + 1) * i % (4 * n)) / (2 * n))

def inverse_dct(x):  # in place on (pixels, rows, cols)
    x[:] = dct(x.shape[1]).T @ x @ dct(x.shape[2])

INVERSE = {"haar": inverse_haar, "unbalanced haar": inverse_haar, "haar-standard": inverse_standard,
           "dct": inverse_dct, "direct": None}

def inverse_s(x):  # in place on (pixels, rows, cols), whole numbers
    for r, c in reversed(list(steps(*x.shape[1:]))):
        for v in (x[:, :r, :c].swapaxes(1, 2), x[:, :r, :c]):  # along y, then x
            n, h = v.shape[-1] // 2, (v.shape[-1] + 1) // 2
            s, d, odd = v[..., :n].copy(), v[..., h:].copy(), v[..., h - 1].copy()
            b = s - (d >> 1)
            v[..., 0:2 * n:2], v[..., 1:2 * n:2] = b + d, b
            if v.shape[-1] % 2:
                v[..., -1] = odd

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
    grid = head["lights"].get("rows", n), head["lights"].get("cols", n)
    basis, quantised = head["basis"], head["coding"] == "quantised"
    assert basis in INVERSE and head["coding"] in ("quantised", "lossless", "integers"), f"unknown: {basis}, {head['coding']}"
    is_haar = basis in ("haar", "unbalanced haar")
    assert is_haar or basis == "direct" or head["coding"] != "integers", f"unknown: {basis}, integers"
    rank, terms = head["plate"]["rank"], (head["plate"]["degree"] + 1)**2
    level = np.zeros(lights)
    if quantised and basis != "direct":
        one = np.frexp(np.maximum(*np.indices(grid)))[1]  # bit length
        if is_haar:
            one = np.zeros(grid)
            for r, c in steps(*grid):  # coarser than the details that end here
                one[:(r + 1) // 2, :(c + 1) // 2] -= 1
        level = np.concatenate([one.ravel() + 32 * g for g in range(lights // one.size)])
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
                if quantised:
                    values = np.ascontiguousarray(values.T * (head["step"] / 2.0 ** raw[:p, None]))
                    if INVERSE[basis]:
                        INVERSE[basis](values.reshape(-1, *grid))
                    values = values.T + plate
                elif head["coding"] == "integers":
                    values = np.ascontiguousarray(values.T.astype("i8"))
                    if is_haar:
                        inverse_s(values.reshape(-1, *grid))
                    units = np.array(head["units"])[:, None]
                    values = ((values.T + np.floor(plate / units + 0.5)) * units).astype("<f4")
                view[:] = values.T.reshape(view.shape)
    return out

if __name__ == "__main__":
    np.save(sys.argv[2], read_hlb(sys.argv[1]))
