"""The Voronoi Texture in one to four dimensions (Cycles: kernel/svm/voronoi.h).

Each unit cell has one point in it; what is asked for is found among the cells around.  One dimension is along x here; axes that a pattern
has not are zero, and there its cells are not looked at.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf
from .hashing import float1, float2, float3, float4

F = np.float32
U = np.uint32

FEATURES = ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
_F1, _F2, _SMOOTH, _EDGE, _RADIUS = range(5)
METRICS = ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")
_EUCLIDEAN, _MANHATTAN, _CHEBYCHEV, _MINKOWSKI = range(4)
_FAR = F(8)
_LIMIT = F(1e9)  # cells beyond it have no number


@inlined
def _first(v):
    return U(U(v) * U(1664525) + U(1013904223))


@inlined
def _folded(v):
    # The shift keeps the sign.
    return U(v ^ U(np.int32(v) >> np.int32(16)))


@inlined
def _share(v):
    return F(np.int32(v & U(0x7FFFFFFF))) * F(1 / 0x7FFFFFFF)


@inlined
def _hash2(x, y):
    """PCG hash of two integers, 0..1 (Jarzynski and Olano, JCGT 2020, as util/hash.h of Cycles has it)."""
    k = U(1664525)
    x, y = _first(x), _first(y)
    for turn in range(2):
        x = U(x + U(y * k))
        y = U(y + U(x * k))
        if turn == 0:
            x, y = _folded(x), _folded(y)
    return _share(x), _share(y)


@inlined
def _hash3(x, y, z):
    """The same of three."""
    x, y, z = _first(x), _first(y), _first(z)
    for turn in range(2):
        x = U(x + U(y * z))
        y = U(y + U(z * x))
        z = U(z + U(x * y))
        if turn == 0:
            x, y, z = _folded(x), _folded(y), _folded(z)
    return _share(x), _share(y), _share(z)


@inlined
def _hash4(x, y, z, w):
    """The same of four."""
    x, y, z, w = _first(x), _first(y), _first(z), _first(w)
    for turn in range(2):
        x = U(x + U(y * w))
        y = U(y + U(z * x))
        z = U(z + U(x * y))
        w = U(w + U(y * z))
        if turn == 0:
            x, y, z, w = _folded(x), _folded(y), _folded(z), _folded(w)
    return _share(x), _share(y), _share(z), _share(w)


@leaf
def _point(old, dimensions, i, j, k, m):
    """Where the point of a cell lies in it, 0..1."""
    if dimensions == 1:
        return float1(F(i)), F(0), F(0), F(0)
    if old:
        x, y, z, w = F(i), F(j), F(k), F(m)
        if dimensions == 2:
            return float2(x, y), float3(x, y, F(1)), F(0), F(0)
        if dimensions == 3:
            return float3(x, y, z), float4(x, y, z, F(1)), float4(x, y, z, F(2)), F(0)
        return float4(x, y, z, w), float4(w, x, y, z), float4(z, w, x, y), float4(y, z, w, x)
    if dimensions == 2:
        x, y = _hash2(i, j)
        return x, y, F(0), F(0)
    if dimensions == 3:
        x, y, z = _hash3(i, j, k)
        return x, y, z, F(0)
    return _hash4(i, j, k, m)


@leaf
def _color(old, dimensions, i, j, k, m):
    """Of a cell."""
    x, y, z, w = F(i), F(j), F(k), F(m)
    if dimensions == 1:
        return float1(x), float2(x, F(1)), float2(x, F(2))
    if not old:
        if dimensions < 4:
            return _hash3(i, j, k)
        r, g, b, _ = _hash4(i, j, k, m)
        return r, g, b
    if dimensions == 2:
        return float2(x, y), float3(x, y, F(1)), float3(x, y, F(2))
    if dimensions == 3:
        return float3(x, y, z), float4(x, y, z, F(1)), float4(x, y, z, F(2))
    return float4(x, y, z, w), float4(z, x, w, y), float4(w, z, y, x)


@inlined
def _distance(metric, exponent, x, y, z, w):
    """Length of a vector."""
    x, y, z, w = abs(x), abs(y), abs(z), abs(w)
    if metric == _EUCLIDEAN:
        return np.sqrt(x * x + y * y + z * z + w * w)
    if metric == _MANHATTAN:
        return x + y + z + w
    if metric == _CHEBYCHEV:
        return max(max(x, y), max(z, w))
    return (x**exponent + y**exponent + z**exponent + w**exponent) ** (F(1) / exponent)


@inlined
def _reaches(dimensions, reach):
    """How many cells on either side are looked at along each axis."""
    return reach, reach if dimensions > 1 else 0, reach if dimensions > 2 else 0, reach if dimensions > 3 else 0


@inlined
def _smoothstep(x):
    x = min(max(x, F(0)), F(1))
    return x * x * (F(3) - F(2) * x)


@inlined
def _mix(a, b, t):
    return a + t * (b - a)


@inlined
def _cell(x, y, z, w):
    return np.int32(np.floor(x)), np.int32(np.floor(y)), np.int32(np.floor(z)), np.int32(np.floor(w))


@leaf
def _nearest(old, feature, dimensions, metric, exponent, randomness, x, y, z, w):
    """F1 or F2 at a place: (distance, r, g, b, position)."""
    ci, cj, ck, cm = _cell(x, y, z, w)
    x, y, z, w = x - F(ci), y - F(cj), z - F(ck), w - F(cm)
    ri, rj, rk, rm = _reaches(dimensions, 1)
    first = second = _FAR
    i1 = j1 = k1 = m1 = i2 = j2 = k2 = m2 = 0
    x1 = y1 = z1 = w1 = x2 = y2 = z2 = w2 = F(0)
    for m in range(-rm, rm + 1):
        for k in range(-rk, rk + 1):
            for j in range(-rj, rj + 1):
                for i in range(-ri, ri + 1):
                    px, py, pz, pw = _point(old, dimensions, ci + i, cj + j, ck + k, cm + m)
                    px, py, pz, pw = F(i) + px * randomness, F(j) + py * randomness, F(k) + pz * randomness, F(m) + pw * randomness
                    d = _distance(metric, exponent, px - x, py - y, pz - z, pw - w)
                    if d < first:
                        second, i2, j2, k2, m2, x2, y2, z2, w2 = first, i1, j1, k1, m1, x1, y1, z1, w1
                        first, i1, j1, k1, m1, x1, y1, z1, w1 = d, i, j, k, m, px, py, pz, pw
                    elif d < second:
                        second, i2, j2, k2, m2, x2, y2, z2, w2 = d, i, j, k, m, px, py, pz, pw
    if feature == _F2:
        first, i1, j1, k1, m1, x1, y1, z1, w1 = second, i2, j2, k2, m2, x2, y2, z2, w2
    r, g, b = _color(old, dimensions, ci + i1, cj + j1, ck + k1, cm + m1)
    return first, r, g, b, x1 + F(ci), y1 + F(cj), z1 + F(ck), w1 + F(cm)


@leaf
def _smooth(old, dimensions, metric, exponent, randomness, smoothness, x, y, z, w):
    """Smooth F1 at a place, as `_nearest`."""
    ci, cj, ck, cm = _cell(x, y, z, w)
    x, y, z, w = x - F(ci), y - F(cj), z - F(ck), w - F(cm)
    ri, rj, rk, rm = _reaches(dimensions, 2)
    distance = r = g = b = sx = sy = sz = sw = F(0)
    begun = False
    for m in range(-rm, rm + 1):
        for k in range(-rk, rk + 1):
            for j in range(-rj, rj + 1):
                for i in range(-ri, ri + 1):
                    px, py, pz, pw = _point(old, dimensions, ci + i, cj + j, ck + k, cm + m)
                    px, py, pz, pw = F(i) + px * randomness, F(j) + py * randomness, F(k) + pz * randomness, F(m) + pw * randomness
                    d = _distance(metric, exponent, px - x, py - y, pz - z, pw - w)
                    h = _smoothstep(F(0.5) + F(0.5) * (distance - d) / smoothness) if begun else F(1)
                    begun = True
                    less = smoothness * h * (F(1) - h)
                    distance = _mix(distance, d, h) - less
                    less /= F(1) + F(3) * smoothness
                    cr, cg, cb = _color(old, dimensions, ci + i, cj + j, ck + k, cm + m)
                    r, g, b = _mix(r, cr, h) - less, _mix(g, cg, h) - less, _mix(b, cb, h) - less
                    sx, sy, sz, sw = _mix(sx, px, h) - less, _mix(sy, py, h) - less, _mix(sz, pz, h) - less, _mix(sw, pw, h) - less
    return distance, r, g, b, sx + F(ci), sy + F(cj), sz + F(ck), sw + F(cm)


@leaf
def _edge(old, dimensions, randomness, x, y, z, w):
    """Distance to the border of the cell around a place."""
    ci, cj, ck, cm = _cell(x, y, z, w)
    x, y, z, w = x - F(ci), y - F(cj), z - F(ck), w - F(cm)
    if dimensions == 1:
        return _edge1(randomness, x, ci)
    ri, rj, rk, rm = _reaches(dimensions, 1)
    nearest = _FAR
    nx = ny = nz = nw = F(0)
    for turn in range(2):
        if turn == 1:
            nearest = _FAR
        for m in range(-rm, rm + 1):
            for k in range(-rk, rk + 1):
                for j in range(-rj, rj + 1):
                    for i in range(-ri, ri + 1):
                        px, py, pz, pw = _point(old, dimensions, ci + i, cj + j, ck + k, cm + m)
                        px, py = F(i) + px * randomness - x, F(j) + py * randomness - y
                        pz, pw = F(k) + pz * randomness - z, F(m) + pw * randomness - w
                        if turn == 0:
                            d = px * px + py * py + pz * pz + pw * pw
                            if d < nearest:
                                nearest, nx, ny, nz, nw = d, px, py, pz, pw
                        else:
                            ex, ey, ez, ew = px - nx, py - ny, pz - nz, pw - nw
                            square = ex * ex + ey * ey + ez * ez + ew * ew
                            if square > F(0.0001):
                                along = (nx + px) * ex + (ny + py) * ey + (nz + pz) * ez + (nw + pw) * ew
                                nearest = min(nearest, F(0.5) * along / np.sqrt(square))
    return nearest


@leaf
def _edge1(randomness, x, cell):
    """Along a line: half way to the points of the neighbours."""
    own, left, right = (
        float1(F(cell)) * randomness,
        F(-1) + float1(F(cell - 1)) * randomness,
        F(1) + float1(F(cell + 1)) * randomness,
    )
    return min(abs(F(0.5) * (own + left) - x), abs(F(0.5) * (own + right) - x))


@leaf
def _radius(old, dimensions, randomness, x, y, z, w):
    """Half of the way from the nearest point to the one nearest to it."""
    ci, cj, ck, cm = _cell(x, y, z, w)
    _, _, _, _, x, y, z, w = _nearest(old, _F1, dimensions, _EUCLIDEAN, F(2), randomness, x, y, z, w)
    # Its cell: the point may lie on the border when it is not moved.
    ri, rj, rk, rm = _reaches(dimensions, 1)
    own = _FAR
    oi = oj = ok = om = 0
    for m in range(-rm, rm + 1):
        for k in range(-rk, rk + 1):
            for j in range(-rj, rj + 1):
                for i in range(-ri, ri + 1):
                    px, py, pz, pw = _point(old, dimensions, ci + i, cj + j, ck + k, cm + m)
                    px, py = F(ci + i) + px * randomness - x, F(cj + j) + py * randomness - y
                    pz, pw = F(ck + k) + pz * randomness - z, F(cm + m) + pw * randomness - w
                    d = px * px + py * py + pz * pz + pw * pw
                    if d < own:
                        own, oi, oj, ok, om = d, ci + i, cj + j, ck + k, cm + m
    nearest = _FAR * _FAR
    for m in range(-rm, rm + 1):
        for k in range(-rk, rk + 1):
            for j in range(-rj, rj + 1):
                for i in range(-ri, ri + 1):
                    if i == 0 and j == 0 and k == 0 and m == 0:
                        continue
                    px, py, pz, pw = _point(old, dimensions, oi + i, oj + j, ok + k, om + m)
                    px, py = F(oi + i) + px * randomness - x, F(oj + j) + py * randomness - y
                    pz, pw = F(ok + k) + pz * randomness - z, F(om + m) + pw * randomness - w
                    nearest = min(nearest, px * px + py * py + pz * pz + pw * pw)
    return F(0.5) * np.sqrt(nearest)


@leaf
def voronoi(old, feature, metric, dimensions, normalize, x, y, z, w, detail, roughness, lacunarity, smoothness, exponent, randomness):
    """The Voronoi Texture at a place that is scaled already: (distance or radius, r, g, b, x, y, z, w of the position).

    old: with the hashes of Blender before 5.0.  feature, metric: indices of FEATURES and METRICS.  smoothness: the node's.  The position is not yet divided by the scale.
    """
    if not (abs(x) < _LIMIT and abs(y) < _LIMIT and abs(z) < _LIMIT and abs(w) < _LIMIT):
        return F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0)
    detail, roughness = min(max(detail, F(0)), F(15)), min(max(roughness, F(0)), F(1))
    randomness, smoothness = min(max(randomness, F(0)), F(1)), min(max(F(0.5) * smoothness, F(0)), F(0.5))
    if feature == _RADIUS:
        return _radius(old, dimensions, randomness, x, y, z, w), F(0), F(0), F(0), F(0), F(0), F(0), F(0)
    half = F(0.5) + F(0.5) * randomness
    is_edge, single = feature == _EDGE, detail == F(0) or roughness == F(0) or lacunarity == F(0)
    amplitude = scale = F(1)
    most = half if is_edge else F(0)
    distance = _FAR if is_edge else F(0)
    r = g = b = px = py = pz = pw = F(0)
    for octave in range(int(np.ceil(detail)) + 1):
        ox, oy, oz, ow = x * scale, y * scale, z * scale, w * scale
        d = cr = cg = cb = qx = qy = qz = qw = F(0)
        if is_edge:
            d = _edge(old, dimensions, randomness, ox, oy, oz, ow)
        elif feature == _SMOOTH and smoothness > F(0):
            d, cr, cg, cb, qx, qy, qz, qw = _smooth(old, dimensions, metric, exponent, randomness, smoothness, ox, oy, oz, ow)
        else:
            d, cr, cg, cb, qx, qy, qz, qw = _nearest(old, feature, dimensions, metric, exponent, randomness, ox, oy, oz, ow)
        if single:
            most, distance, r, g, b, px, py, pz, pw = half if is_edge else F(1), d, cr, cg, cb, qx, qy, qz, qw
            break
        # The last octave counts by the fraction that is left of the detail.
        part = F(1) if F(octave) <= detail else detail - np.floor(detail)
        if is_edge:
            most = _mix(most, _mix(most, half / scale, amplitude), part)
            distance = _mix(distance, min(distance, _mix(distance, min(distance, d / scale), amplitude)), part)
        else:
            most += amplitude * part
            distance += d * amplitude * part
            r, g, b = r + cr * amplitude * part, g + cg * amplitude * part, b + cb * amplitude * part
            px, py = _mix(px, qx / scale, amplitude * part), _mix(py, qy / scale, amplitude * part)
            pz, pw = _mix(pz, qz / scale, amplitude * part), _mix(pw, qw / scale, amplitude * part)
        scale *= lacunarity
        amplitude *= roughness
    if normalize:
        if is_edge:
            distance /= most
        else:
            widest = (
                half
                if dimensions == 1
                else _distance(metric, exponent, half, half, half if dimensions > 2 else F(0), half if dimensions > 3 else F(0))
            )
            distance /= most * widest * (F(2) if feature == _F2 else F(1))
            r, g, b = r / most, g / most, b / most
    return distance, r, g, b, px, py, pz, pw
