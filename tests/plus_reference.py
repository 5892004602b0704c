"""What the PLUS toolkit does, one pixel after another in plain Python: slow, for small sweeps."""

import math

import numpy as np

STICKS = [
    (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, -1, 0), (1, 0, -1),
    (0, 1, -1), (1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, 1),
]  # fmt: skip
F32 = np.float32


class Fixed:
    """14 fractional bits."""

    def __init__(self, i):
        self.i = i

    @staticmethod
    def of(x):
        return Fixed(round(float(x) * 2**14))

    def __add__(self, other):
        return Fixed(self.i + other.i)

    def __sub__(self, other):
        return Fixed(self.i - other.i)

    def __mul__(self, other):
        return Fixed((self.i * other.i + 2**13) >> 14)

    def __truediv__(self, other):
        return Fixed(round(self.i / other.i * 2**14))

    def times(self, n):
        return Fixed(self.i * n)

    def __float__(self):
        return self.i / 2**14


def floor(x):
    if isinstance(x, Fixed):
        return x.i >> 14
    return math.floor(round(x * 2**16) / 2**16)


def rounded(x):
    if isinstance(x, Fixed):
        return (x.i + 2**13) >> 14
    return math.floor(round(x * 2**16 + 2**15) / 2**16)


def insert(config, frames, matrices, size, sources, importance):
    """Values and accumulator (Z, Y, X)."""
    real, out = frames.dtype == np.float32, np.zeros(size[::-1], frames.dtype)
    acc, fixed = np.zeros(size[::-1], np.int64), config.optimization == "FULL"
    number = Fixed.of if fixed else float
    for frame, m in zip(frames, matrices, strict=True):
        flat, m = frame.ravel(), [[number(v) for v in row] for row in m.tolist()]
        for row, column in np.ndindex(*frame.shape):
            s = int(sources[row, column])
            if s < 0 or (config.rejection is not None and flat[s] < config.rejection):
                continue
            if fixed:
                p = [r[3] + r[1].times(row) + r[0].times(column) for r in m]
            elif config.optimization == "PARTIAL":
                p = [(r[3] + row * r[1]) + column * r[0] for r in m]
            else:
                p = [(r[0] * column + r[1] * row) + r[3] for r in m]
            value = F32(flat[s]) if real else int(flat[s])
            weight = 256 if importance is None else int(importance.ravel()[s])
            if config.interpolation == "NEAREST_NEIGHBOR":
                v = tuple(rounded(c) for c in p)
                if all(0 <= c < n for c, n in zip(v, size, strict=True)):
                    nearest(config, out, acc, v[::-1], value, weight)
            else:
                linear(config, out, acc, p, value, weight, size, number)
    return out, acc


def nearest(config, out, acc, at, value, weight):
    old = F32(out[at]) if out.dtype == np.float32 else int(out[at])
    mode = config.compounding
    if mode in ("MAXIMUM", "LATEST"):
        out[at] = value if mode == "LATEST" else max(value, old)
        acc[at] = min(acc[at] + 256, 65535) if config.optimization == "NONE" else 256
    elif acc[at] > 65279:
        out[at] = float(value) * (1 / 256) + float(old) * (255 / 256)
    elif weight:
        total = int(acc[at]) + weight
        if out.dtype == np.float32:
            out[at] = (value * F32(weight) + old * F32(acc[at])) / F32(total)
        else:
            out[at] = (value * weight + old * int(acc[at])) // total
        acc[at] = min(total, 65535)


def linear(config, out, acc, p, value, importance, size, number):
    low = [floor(c) for c in p]
    f = [c - number(i) for c, i in zip(p, low, strict=True)]
    high = [i + (float(w) != 0) for i, w in zip(low, f, strict=True)]
    if any(i < 0 or j >= n for i, j, n in zip(low, high, size, strict=True)):
        return
    r, real = [number(1) - w for w in f], out.dtype == np.float32
    fixed = isinstance(p[0], Fixed)
    for j in range(7, -1, -1):
        bits = (j >> 2 & 1, j >> 1 & 1, j & 1)
        w = [f[k] if bits[k] else r[k] for k in range(3)]
        weight = w[0] * (w[1] * w[2])
        if float(weight) == 0:
            continue
        at = tuple((high if bits[k] else low)[k] for k in (2, 1, 0))
        old = F32(out[at]) if real else int(out[at])
        if config.compounding in ("MAXIMUM", "LATEST"):
            if float(weight) < 0.125 or (config.compounding == "MAXIMUM" and not value > old):
                continue
            out[at] = value
            total = weight.times(256) if fixed else weight * 256
        elif config.compounding == "MEAN":
            share = number(acc[at] / 256)
            a = weight + share
            if fixed and real:
                out[at] = (F32(weight) * value + F32(share) * old) / F32(a)
            elif fixed:
                out[at] = rounded((weight.times(value) + share.times(old)) / a)
            else:
                mean = (weight * float(value) + share * float(old)) / a
                out[at] = mean if real else rounded(mean)
            total = a.times(256) if fixed else a * 256
        else:
            if importance == 0:
                continue
            have = int(acc[at])
            if fixed:
                total = weight.times(importance) + Fixed(have << 14)
                if real:
                    x = value * F32(importance) * F32(weight) / F32(total)
                    out[at] = float(Fixed.of(x + F32(Fixed(have << 14) / total) * old))
                else:
                    x = weight.times(value * importance) / total
                    out[at] = rounded(x + (Fixed(have << 14) / total).times(old))
            else:
                total = importance * weight + have
                product = value * F32(importance) if real else value * importance
                held = old * F32(have) if real else old * have
                mean = (float(product) * weight + float(held)) / total
                out[at] = mean if real else rounded(mean)
        acc[at] = min(rounded(total), 65535)


def fill(fillers, values, acc):
    out = values.copy()
    for at in np.ndindex(values.shape):
        if acc[at]:
            continue
        for filler in fillers:
            out[at], done = one(filler, values, acc, at)
            if done:
                break
    return out


def one(filler, values, acc, at):
    if filler.type == "STICK":
        return stick(filler, values, acc, at)
    z, y, x = at
    half, weights = (filler.size - 1) // 2, filler.weights()
    radii = range(1, half + 1) if filler.type == "NEAREST_NEIGHBOR" else [half]
    total = known = weight_sum = 0.0
    for r in radii:
        for i in range(x - r, x + r + 1):
            for j in range(y - r, y + r + 1):
                for k in range(z - r, z + r + 1):
                    if not (0 <= i < values.shape[2] and 0 <= j < values.shape[1] and 0 <= k < values.shape[0]):
                        continue
                    a = acc[k, j, i]
                    if not a:
                        continue
                    w = 1.0
                    if filler.type != "NEAREST_NEIGHBOR":
                        w = weights[k - z + half, j - y + half, i - x + half]
                        w = float(F32(a) * w) if filler.type == "GAUSSIAN_ACCUMULATION" else float(w)
                    total += float(values[k, j, i]) * w
                    weight_sum += w
                    known += 1
        if known:
            break
    if weight_sum == 0 or not known / filler.size**3 > float(F32(filler.least_ratio)):
        return 0, False
    return cast(total / weight_sum, values.dtype), True


def cast(v, dtype):
    return F32(v) if dtype == np.float32 else int(v)


def stick(filler, values, acc, at):
    found, weights = [], []
    for dx, dy, dz in STICKS:
        ends, limit = [], filler.size - 1
        for sign in (1, -1):
            for j in range(1, limit + 1):
                v = (at[0] + sign * j * dz, at[1] + sign * j * dy, at[2] + sign * j * dx)
                if not all(0 <= c < n for c, n in zip(v, values.shape, strict=True)):
                    break
                if acc[v]:
                    ends.append((j, float(values[v])))
                    break
            if not ends:
                break
            limit -= ends[0][0]
        if len(ends) < 2:
            continue
        (j, ahead), (k, behind) = ends
        length = float(j + k + 1)
        w = (k + 1) / length
        found.append(cast((1.0 - w) * behind + w * ahead, values.dtype))
        weights.append(1.0 / (length * math.sqrt(float(dx * dx + dy * dy + dz * dz))))
    total = weight_sum = 0.0
    used = 0
    while used < filler.n_sticks and any(weights):
        best = max(weights)
        for i, w in enumerate(weights):
            if w == best:
                total += float(found[i]) * best
                weight_sum += best
                weights[i] = 0.0
                used += 1
    if weight_sum == 0:
        return 0, False
    return cast(total / weight_sum, values.dtype), True
