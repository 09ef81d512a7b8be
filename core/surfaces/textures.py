"""Image textures packed into two pools, and their lookup as Cycles does it.

A texel keeps the file's own encoding: 8-bit images stay bytes, everything else is float32.  Texels are
interpolated first and decoded afterwards (Cycles: svm_image_texture), so that an sRGB texture gives the
same values between its texels as Cycles.  Rows run from the bottom to the top, as Blender stores them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..jit import inlined, kernel, leaf
from ..threads import run_chunks

F = np.float32

# Columns of `MaterialTables.texture_header`.
WIDTH, HEIGHT, CHANNELS, IS_FLOAT, OFFSET, EXTENSION, INTERPOLATION, FLAGS = range(8)
# Of an image in tiles (UDIM): how many there are across and upwards; the headers of tiles follow its own, row by row from the bottom.
ACROSS, UPWARDS = 8, 9
HEADER = 16
# Extension beyond 0..1.
REPEAT, EXTEND, CLIP, MIRROR = range(4)
# Interpolation between texels.
CLOSEST, LINEAR, CUBIC = range(3)
MISSING = (1.0, 0.0, 1.0, 1.0)  # what Cycles shows where there is no image
# Flags.
SRGB, UNASSOCIATE = 1, 2

ROWS = 128  # of texels a chunk
_STEPS = 2048
_encoded = np.linspace(0, 1, _STEPS + 1)
# sRGB to linear at 2049 points: with linear interpolation the error is below 4e-7.
SRGB_TABLE = np.where(_encoded <= 0.04045, _encoded / 12.92, ((_encoded + 0.055) / 1.055) ** 2.4).astype(F)


@dataclass
class TexturePool:
    """Collects images and the ways they are looked up; `tables()` gives the packed arrays.

    The same image under several extensions or interpolations is stored once.
    """

    headers: list[np.ndarray] = field(default_factory=list)
    bytes: list[np.ndarray] = field(default_factory=list)
    floats: list[np.ndarray] = field(default_factory=list)
    _stored: dict = field(default_factory=dict)
    _known: dict = field(default_factory=dict)
    _bytes_used: int = 0
    _floats_used: int = 0

    def add(self, key, load, extension: int, interpolation: int, flags: int) -> int:
        """Index of the texture; `load()` gives (H, W, C) uint8 or float32 and is called once for each `key`."""
        known = (key, extension, interpolation, flags)
        if known not in self._known:
            if key not in self._stored:
                self._stored[key] = self._store(load())
            self.headers.append(_header(self._stored[key], extension, interpolation, flags))
            self._known[known] = len(self.headers) - 1
        return self._known[known]

    def add_tiles(self, key, tiles: dict[tuple[int, int], object], extension: int, interpolation: int, flags: int) -> int:
        """Index of a texture whose tile (i, j) shows where u and v lose their fraction to i and j; elsewhere it is pink, as in Cycles.

        tiles: of each, what `add` calls `load`.
        """
        known = (key, extension, interpolation, flags)
        if known not in self._known:
            across, upwards = (1 + max(tile[k] for tile in tiles) for k in range(2))
            for place, load in tiles.items():
                if (key, place) not in self._stored:
                    self._stored[key, place] = self._store(load())
            if MISSING not in self._stored:
                self._stored[MISSING] = self._store(np.array([[MISSING]], F))
            header = np.zeros(HEADER, np.int32)
            header[ACROSS], header[UPWARDS] = across, upwards
            self._known[known] = len(self.headers)
            self.headers.append(header)
            for j in range(upwards):
                for i in range(across):
                    stored = self._stored.get((key, (i, j)))
                    self.headers.append(_header(stored or self._stored[MISSING], extension, interpolation, flags if stored else 0))
        return self._known[known]

    def _store(self, pixels: np.ndarray) -> tuple[int, int, int, int, int]:
        flat = np.ascontiguousarray(pixels).reshape(-1)
        if pixels.dtype == np.uint8:
            offset, self._bytes_used = self._bytes_used, self._bytes_used + flat.size
            self.bytes.append(flat)
        else:
            offset, self._floats_used = self._floats_used, self._floats_used + flat.size
            self.floats.append(flat.astype(F, copy=False))
        if max(self._bytes_used, self._floats_used) >= 2**31:
            raise MemoryError("the scene's textures together exceed 2 GiB of bytes or 2 G floats")
        return (*pixels.shape, int(pixels.dtype != np.uint8), offset)

    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(X, 16) int32 headers, (B,) uint8 and (F,) float32 texels; never empty, so that kernels may index them."""
        headers = np.stack(self.headers) if self.headers else np.zeros((1, HEADER), np.int32)
        texels_u8 = np.concatenate(self.bytes) if self.bytes else np.zeros(4, np.uint8)
        texels_f32 = np.concatenate(self.floats) if self.floats else np.zeros(4, F)
        return headers, texels_u8, texels_f32


def quantised(pixels: np.ndarray) -> np.ndarray:
    """Values in 0..1, (H, W, C) float32, as bytes (H, W, C)."""
    out = np.empty(pixels.shape, np.uint8)
    run_chunks(lambda begin, end: _quantise(pixels, out, begin, end), len(pixels), ROWS)
    return out


@kernel
def _quantise(pixels, out, begin, end):
    for y in range(begin, end):
        for x in range(out.shape[1]):
            for c in range(out.shape[2]):
                out[y, x, c] = np.int32(min(max(pixels[y, x, c] * F(255) + F(0.5), F(0)), F(255)))


def _header(stored: tuple[int, int, int, int, int], extension: int, interpolation: int, flags: int) -> np.ndarray:
    height, width, channels, is_float, offset = stored
    header = np.zeros(HEADER, np.int32)
    header[: FLAGS + 1] = width, height, channels, is_float, offset, extension, interpolation, flags
    return header


@inlined
def _srgb_to_linear(x):
    if not (x < F(1)):
        return ((x + F(0.055)) / F(1.055)) ** F(2.4)
    if x <= F(0):
        return x / F(12.92)
    t = x * F(_STEPS)
    i = np.int32(t)
    return SRGB_TABLE[i] + (t - F(i)) * (SRGB_TABLE[i + 1] - SRGB_TABLE[i])


@inlined
def _wrap(i, size, extension):
    """Texel index for any integer; -1 is outside (CLIP)."""
    if extension == REPEAT:
        i = i % size
        return i + size if i < 0 else i
    if extension == EXTEND:
        return min(max(i, 0), size - 1)
    if extension == MIRROR:
        m = abs(i + 1 if i < 0 else i) % (2 * size)
        return 2 * size - 1 - m if m >= size else m
    return i if 0 <= i < size else -1


@inlined
def _add_texel(header, texels_u8, texels_f32, x, y, weight, r, g, b, a):
    """(r, g, b, a) plus the weighted texel."""
    if x < 0 or y < 0:
        return r, g, b, a
    channels = header[CHANNELS]
    at = np.int64(header[OFFSET]) + (np.int64(y) * header[WIDTH] + x) * channels
    if header[IS_FLOAT]:
        if channels == 4:
            return (
                r + weight * texels_f32[at],
                g + weight * texels_f32[at + 1],
                b + weight * texels_f32[at + 2],
                a + weight * texels_f32[at + 3],
            )
        if channels == 3:
            return r + weight * texels_f32[at], g + weight * texels_f32[at + 1], b + weight * texels_f32[at + 2], a + weight
        value = weight * texels_f32[at]
        return r + value, g + value, b + value, a + weight
    w = weight * F(1 / 255)
    if channels == 4:
        return (
            r + w * F(texels_u8[at]),
            g + w * F(texels_u8[at + 1]),
            b + w * F(texels_u8[at + 2]),
            a + w * F(texels_u8[at + 3]),
        )
    if channels == 3:
        return r + w * F(texels_u8[at]), g + w * F(texels_u8[at + 1]), b + w * F(texels_u8[at + 2]), a + weight
    value = w * F(texels_u8[at])
    return r + value, g + value, b + value, a + weight


@inlined
def _cubic_weight(k, t):
    """Weight of tap k (0..3) of the uniform cubic B-spline at fraction t."""
    if k == 0:
        return (F(1) - t) ** 3 * F(1 / 6)
    if k == 1:
        return (F(0.5) * t - F(1)) * t * t + F(2 / 3)
    if k == 2:
        return ((F(-0.5) * t + F(0.5)) * t + F(0.5)) * t + F(1 / 6)
    return t * t * t * F(1 / 6)


@leaf
def sample(texture_header, texels_u8, texels_f32, texture, u, v):
    """Linear RGB and alpha of texture `texture` at (u, v); a coordinate that is not finite gives black."""
    header = texture_header[texture]
    if header[ACROSS] > 0:
        if not (F(-1) < u < F(header[ACROSS]) and F(-1) < v < F(header[UPWARDS])):
            return F(MISSING[0]), F(MISSING[1]), F(MISSING[2]), F(MISSING[3])
        i, j = np.int32(u), np.int32(v)  # towards zero, as Cycles does: just below it the first tile goes on
        header = texture_header[texture + 1 + j * header[ACROSS] + i]
        u, v = u - F(i), v - F(j)
    width, height = header[WIDTH], header[HEIGHT]
    extension, interpolation = header[EXTENSION], header[INTERPOLATION]
    x, y = u * F(width), v * F(height)
    r = g = b = a = F(0)
    # Beyond this an int32 index overflows; such coordinates come from broken UV maps only.
    if abs(x) < F(1e9) and abs(y) < F(1e9):
        if interpolation == CLOSEST:
            i = _wrap(np.int32(np.floor(x)), width, extension)
            j = _wrap(np.int32(np.floor(y)), height, extension)
            r, g, b, a = _add_texel(header, texels_u8, texels_f32, i, j, F(1), r, g, b, a)
        else:
            x, y = x - F(0.5), y - F(0.5)
            i, j = np.int32(np.floor(x)), np.int32(np.floor(y))
            s, t = x - F(i), y - F(j)
            if interpolation == LINEAR:
                i0, i1 = _wrap(i, width, extension), _wrap(i + 1, width, extension)
                for k in range(2):
                    row = _wrap(j + k, height, extension)
                    weight = t if k == 1 else F(1) - t
                    r, g, b, a = _add_texel(header, texels_u8, texels_f32, i0, row, (F(1) - s) * weight, r, g, b, a)
                    r, g, b, a = _add_texel(header, texels_u8, texels_f32, i1, row, s * weight, r, g, b, a)
            else:
                for k in range(16):
                    column = _wrap(i + (k & 3) - 1, width, extension)
                    row = _wrap(j + (k >> 2) - 1, height, extension)
                    weight = _cubic_weight(k & 3, s) * _cubic_weight(k >> 2, t)
                    r, g, b, a = _add_texel(header, texels_u8, texels_f32, column, row, weight, r, g, b, a)
    flags = header[FLAGS]
    if flags & UNASSOCIATE and a != F(0) and a != F(1):
        r, g, b = r / a, g / a, b / a
    if flags & SRGB:
        r, g, b = _srgb_to_linear(r), _srgb_to_linear(g), _srgb_to_linear(b)
    return r, g, b, a


@inlined
def to_sphere(x, y, z):
    """Image coordinates of a point of the unit cube, projected from its centre on a sphere."""
    x, y, z = F(2) * x - F(1), F(2) * y - F(1), F(2) * z - F(1)
    length = np.sqrt(x * x + y * y + z * z)
    if length == F(0):
        return F(0), F(0)
    u = F(0.5) - np.arctan2(x, y) * F(0.5 / np.pi) if x != F(0) or y != F(0) else F(0)
    return u, F(1) - np.arccos(min(max(z / length, F(-1)), F(1))) * F(1 / np.pi)


@inlined
def to_tube(x, y, z):
    """Image coordinates of a point of the unit cube, projected from its z axis on a tube."""
    x, y = F(2) * x - F(1), F(2) * y - F(1)
    if x == F(0) and y == F(0):
        return F(0), F(0)
    return (F(1) - np.arctan2(x, y) * F(1 / np.pi)) * F(0.5), z


@inlined
def box_weights(x, y, z, mix):
    """Shares of the three sides for the absolute normal (x, y, z) and the blend `mix` (Cycles: svm_node_tex_image_box)."""
    total = x + y + z
    x, y, z = x / total, y / total, z / total
    limit = F(0.5) * (F(1) + mix)
    if x > limit * (x + y) and x > limit * (x + z):
        return F(1), F(0), F(0)
    if y > limit * (x + y) and y > limit * (y + z):
        return F(0), F(1), F(0)
    if z > limit * (x + z) and z > limit * (y + z):
        return F(0), F(0), F(1)
    if not mix > F(0):
        return F(1), F(0), F(0)
    if z < (F(1) - limit) * (y + x):
        w = _box_share(x, y, mix)
        return w, F(1) - w, F(0)
    if x < (F(1) - limit) * (y + z):
        w = _box_share(y, z, mix)
        return F(0), w, F(1) - w
    if y < (F(1) - limit) * (x + z):
        w = _box_share(x, z, mix)
        return w, F(0), F(1) - w
    k = F(1) / (F(2) * limit - F(1))
    a, b = (F(2) - limit) * k, (limit - F(1)) * k
    return a * x + b, a * y + b, a * z + b


@inlined
def _box_share(first, second, mix):
    return min(max((first / (first + second) - F(0.5) * (F(1) - mix)) / mix, F(0)), F(1))


@inlined
def box_side(side, x, y, z, nx, ny, nz):
    """Image coordinates on side 0, 1, 2 (x, y, z) of the box; none is mirrored."""
    if side == 0:
        return (F(1) - y if nx < F(0) else y), z
    if side == 1:
        return (F(1) - x if ny > F(0) else x), z
    return (F(1) - y if nz > F(0) else y), x
