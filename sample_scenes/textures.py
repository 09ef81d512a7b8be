"""Seamless textures as NumPy arrays of linear reflectances, (size, size, 3) or with opacity (size, size, 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SIZE = 512


def noise(seed: int, slope: float = 1.5, size: int = SIZE, stretch: float = 1.0) -> np.ndarray:
    """(size, size) seamless noise of mean 0 and deviation 1, whose amplitude falls as frequency^-slope.

    stretch: above 1 the features are longer along v (axis 0) by that factor.
    """
    white = np.random.default_rng(seed).standard_normal((size, size))
    frequency = np.fft.fftfreq(size) * size
    radius = np.hypot(frequency[:, None] * stretch, frequency[None, : size // 2 + 1])
    radius[0, 0] = np.inf
    field = np.fft.irfft2(np.fft.rfft2(white) * radius**-slope, (size, size))
    return field / field.std()


def _tinted(colour: Sequence[float], brightness: np.ndarray) -> np.ndarray:
    """A colour times a brightness (size, size), kept within the albedos that real surfaces have."""
    return np.clip(np.asarray(colour, float) * brightness[..., None], 0.01, 0.9)


def _grid(columns: int, rows: int, joint: float, shift: float = 0.0, size: int = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """Blocks in rows: (size, size) index of each pixel's block, and 1 inside a block falling to 0 in the joint.

    joint: width of the joints as a part of the texture; every second row is shifted by `shift` of a block.
    """
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    row = np.floor(v * rows).astype(int)
    across = u * columns + shift * (row % 2)
    column = np.floor(across).astype(int) % columns
    edge_u = (0.5 - np.abs(across % 1 - 0.5)) / columns
    edge_v = (0.5 - np.abs(v * rows % 1 - 0.5)) / rows
    return row * columns + column, np.clip(np.minimum(edge_u, edge_v) / joint * 2 - 0.5, 0, 1)


def stone(seed: int, colour: Sequence[float], contrast: float = 0.06) -> np.ndarray:
    """Limestone: soft clouds, grain and a few darker veins."""
    clouds, grain = noise(seed, 1.6), noise(seed + 1, 0.4)
    veins = np.exp(-30 * np.abs(noise(seed + 2, 1.9)))
    return _tinted(colour, 1 + contrast * clouds + 0.4 * contrast * grain - 1.5 * contrast * veins)


def marble(seed: int, colour: Sequence[float], vein: Sequence[float]) -> np.ndarray:
    """Polished marble with sharp veins of a second colour."""
    warp = noise(seed, 1.9)
    lines = np.exp(-9 * np.abs(warp)) * (0.5 + 0.5 * np.clip(noise(seed + 1, 1.5), -1, 1))
    share = np.clip(lines + 0.12 * noise(seed + 2, 1.2), 0, 1)[..., None]
    return np.clip(np.asarray(colour) * (1 - share) + np.asarray(vein) * share, 0.01, 0.9)


def plaster(seed: int, colour: Sequence[float], contrast: float = 0.035) -> np.ndarray:
    """Hand-floated plaster: large stains, little grain."""
    return _tinted(colour, 1 + contrast * noise(seed, 1.8) + 0.5 * contrast * noise(seed + 1, 0.7))


def paving(
    seed: int,
    colours: Sequence[Sequence[float]],
    columns: int,
    rows: int,
    joint: float = 0.006,
    shift: float = 0.0,
    chequered: bool = False,
) -> np.ndarray:
    """Slabs with joints; each slab takes one of the colours, at random or as on a chess board, and its own piece of grain."""
    block, inside = _grid(columns, rows, joint, shift)
    rng = np.random.default_rng(seed)
    index = np.arange(columns * rows)
    choice = (index // columns + index) % len(colours) if chequered else rng.integers(len(colours), size=columns * rows)
    tone = rng.normal(1, 0.05, columns * rows)
    grain = np.stack([noise(seed + 1, 1.5), noise(seed + 2, 1.5)])[block % 2, np.arange(SIZE)[:, None], np.arange(SIZE)[None]]
    colour = np.asarray(colours, float)[choice][block] * (tone[block] * (1 + 0.05 * grain))[..., None]
    return np.clip(colour * (0.45 + 0.55 * inside[..., None]), 0.01, 0.9)


def wood(seed: int, colour: Sequence[float], planks: int = 1) -> np.ndarray:
    """Boards along v with grain; `planks` of them side by side, with a dark joint between them if there are several."""
    board, inside = _grid(planks, 1, 0.006)
    rng = np.random.default_rng(seed)
    rings = noise(seed + 1, 1.6, stretch=14.0)
    fibre = noise(seed + 2, 0.8, stretch=30.0)
    brightness = rng.normal(1, 0.09, planks)[board] * (1 + 0.13 * rings + 0.07 * fibre)
    return _tinted(colour, brightness if planks == 1 else brightness * (0.5 + 0.5 * inside))


def fabric(seed: int, colour: Sequence[float], stripe: Sequence[float] | None = None) -> np.ndarray:
    """Woven cloth: a fine twill, uneven dye, and perhaps a pair of stripes along v."""
    v, u = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    weave = 0.06 * np.sin((u + v) * (2 * np.pi / 8)) + 0.04 * np.sin(v * (2 * np.pi / 4))
    base = np.broadcast_to(np.asarray(colour, float), (SIZE, SIZE, 3))
    if stripe is not None:
        place = u / SIZE
        on = ((np.abs(place - 0.5) < 0.03) | (np.abs(np.abs(place - 0.5) - 0.07) < 0.012))[..., None]
        base = np.where(on, np.asarray(stripe, float), base)
    return np.clip(base * (1 + weave + 0.06 * noise(seed, 1.4))[..., None], 0.005, 0.9)


def leaf(seed: int, colour: Sequence[float], size: int = 128) -> np.ndarray:
    """One leaf with opacity, its stalk at v = 0; the midrib and side veins are paler."""
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size - 0.5, indexing="ij")
    half_width = 0.42 * np.sin(np.pi * np.clip(v * 1.04 - 0.03, 0, 1) ** 0.75)
    opacity = (np.abs(u) < half_width) | ((np.abs(u) < 0.025) & (v < 0.2))
    veins = 0.45 * (np.abs(u) < 0.018) + 0.2 * (np.abs((v - 0.8 * np.abs(u)) * 9 % 1 - 0.5) < 0.07)
    rgb = _tinted(colour, 1 + veins + 0.1 * noise(seed, 1.2, size))
    return np.concatenate([rgb, opacity[..., None]], axis=2)


def frond(seed: int, colour: Sequence[float], size: int = 256) -> np.ndarray:
    """A feather palm's frond with opacity: slender leaflets on both sides of a rib along v."""
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size - 0.5, indexing="ij")
    side = np.abs(u) * 2
    reach = 0.98 * np.sin(np.pi * np.clip(0.12 + 0.88 * v, 0, 1)) ** 0.6
    position = (v - 0.16 * side**1.2) * 32 + 0.35 * (u > 0)
    slender = np.abs(position % 1 - 0.5) < 0.36 * (1 - (side / np.maximum(reach, 1e-3)) ** 3)
    leaflets = slender & (side < reach) & (v > 0.16 + 0.1 * side)
    rib = np.abs(u) < 0.012 * (1.3 - v)
    tone = np.random.default_rng(seed).normal(1, 0.12, 64)[np.floor(position).astype(int) % 64]
    rgb = _tinted(colour, np.where(rib, 1.5, tone) * (1 + 0.06 * noise(seed, 1.0, size)))
    return np.concatenate([rgb, (leaflets | rib)[..., None]], axis=2)


def painting(seed: int, size: int = 192) -> np.ndarray:
    """A landscape in oil: sky, far hills, a nearer ridge and a field, each with its own palette and brushwork."""
    rng = np.random.default_rng(seed)
    sky = rng.uniform([0.25, 0.35, 0.45], [0.75, 0.6, 0.65])
    hills = rng.uniform([0.08, 0.12, 0.16], [0.3, 0.3, 0.38])
    ridge = rng.uniform([0.05, 0.09, 0.04], [0.28, 0.24, 0.12])
    field = rng.uniform([0.2, 0.18, 0.05], [0.6, 0.42, 0.16])
    v = np.broadcast_to((np.arange(size)[:, None] + 0.5) / size, (size, size))
    clouds = noise(seed + 1, 1.7, size)
    skyline = rng.uniform(0.45, 0.62) + 0.06 * noise(seed + 2, 1.8, size)[0]
    brow = rng.uniform(0.25, 0.4) + 0.05 * noise(seed + 3, 1.6, size)[0]
    picture = sky * (1.0 + 0.25 * clouds + 0.5 * (1 - v))[..., None]
    picture = np.where((v < skyline)[..., None], hills * (1.2 + 0.2 * noise(seed + 4, 1.0, size))[..., None], picture)
    picture = np.where((v < brow)[..., None], ridge * (1.0 + 0.3 * noise(seed + 5, 0.9, size))[..., None], picture)
    meadow = brow - 0.16 + 0.03 * clouds
    picture = np.where((v < meadow)[..., None], field * (1.0 + 0.25 * noise(seed + 6, 0.8, size))[..., None], picture)
    return np.clip(picture, 0.01, 0.85)


def stained_glass(seed: int, columns: int, rows: int, pale: bool = False, size: int = SIZE) -> np.ndarray:
    """Transmittance of leaded glass: a border, lozenges of several colours (`pale`: mostly clear), dark leads between them."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    first, second = u * columns + v * rows, u * columns - v * rows
    lead = (np.abs(first % 1 - 0.5) > 0.45) | (np.abs(second % 1 - 0.5) > 0.45)
    border = np.minimum(u, 1 - u) < 0.1
    lead |= np.abs(np.minimum(u, 1 - u) - 0.1) < 0.008
    palette = np.array(
        [(0.70, 0.06, 0.04), (0.05, 0.13, 0.62), (0.85, 0.55, 0.10), (0.08, 0.42, 0.16), (0.75, 0.72, 0.62), (0.35, 0.08, 0.45)]
    )
    weights = [0.02, 0.03, 0.1, 0.0, 0.85, 0.0] if pale else [0.26, 0.34, 0.16, 0.1, 0.1, 0.04]
    choice = rng.choice(len(palette), size=(64, 64), p=weights)
    lozenge = choice[np.floor(first).astype(int) % 64, np.floor(second).astype(int) % 64]
    frieze = np.where(np.floor(v * rows * 2).astype(int) % 2 == 0, 0, 2)
    colour = palette[np.where(border, frieze, lozenge)]
    colour = colour * (1 + 0.12 * noise(seed, 0.9, size))[..., None]
    return np.clip(np.where(lead[..., None], 0.015, colour), 0.0, 0.95)


def rose_glass(seed: int, petals: int = 12, size: int = SIZE) -> np.ndarray:
    """Transmittance of a rose window: rings of petals round the middle of the texture, with leads between them."""
    v, u = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, (np.arange(size) + 0.5) / size * 2 - 1, indexing="ij")
    radius, angle = np.hypot(u, v), np.arctan2(v, u) / (2 * np.pi)
    palette = np.array([(0.05, 0.13, 0.62), (0.70, 0.06, 0.04), (0.85, 0.55, 0.10), (0.08, 0.42, 0.16), (0.72, 0.70, 0.62)])
    colour, lead = np.zeros((size, size, 3)), np.zeros((size, size), bool)
    rings = ((0.0, 0.2, 1), (0.2, 0.45, petals // 2), (0.45, 0.72, petals), (0.72, 1.5, 2 * petals))
    for index, (inner, outer, count) in enumerate(rings):
        here = (radius >= inner) & (radius < outer)
        place = angle * count + 0.5 * (index % 2)
        pick = np.array([2, 0, 1, 0, 4, 3])[(np.floor(place).astype(int) + index) % (2 if count > 1 else 1) + index]
        colour[here] = palette[pick[here]]
        lead |= here & ((np.abs(place % 1 - 0.5) > 0.5 - 0.012 * count / np.maximum(2 * np.pi * radius, 0.05)) & (count > 1))
        lead |= np.abs(radius - outer) < 0.012
    colour = colour * (1 + 0.12 * noise(seed, 0.9, size))[..., None]
    return np.clip(np.where(lead[..., None], 0.015, colour), 0.0, 0.95)
