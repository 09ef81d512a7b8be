"""Parts that several scenes share: columns, balusters, arches, mouldings, curtains, pots and plants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .primitives import Shape, arc, box, joined, lathe, polygons, sheet
from .stage import Detail

SMOOTH = np.radians(35)  # edges sharper than this stay sharp


def _torus(radius: float, low: float, high: float) -> np.ndarray:
    """A half-round moulding (N, 2) of radius and height that bulges outwards from `radius`."""
    half = (high - low) / 2
    return arc(half, -np.pi / 2, np.pi / 2, 5, (radius, low + half))


def column(detail: Detail, height: float, radius: float, leaves: int = 8) -> Shape:
    """A column on a square plinth, with a swelling shaft and a capital (of leaves at full detail); its foot is at z = 0.

    The plinth and the abacus are 2.9 radii wide.
    """
    segments = detail.segments(28, 6)
    plinth, abacus, capital = 0.35 * radius, 0.3 * radius, 2.0 * radius
    foot, head = plinth, height - abacus
    neck = head - capital
    if detail.full:
        shaft = np.linspace(0, 1, 6)
        swelling = 1.0 - 0.16 * shaft**2
        profile = np.concatenate(
            [
                [[0.3 * radius, foot - 0.01]],
                _torus(1.18 * radius, foot, foot + 0.28 * radius),
                [[1.13 * radius, foot + 0.30 * radius], [1.04 * radius, foot + 0.42 * radius]],
                _torus(1.06 * radius, foot + 0.44 * radius, foot + 0.6 * radius),
                np.column_stack([radius * swelling, foot + 0.7 * radius + shaft * (neck - foot - 0.9 * radius)]),
                _torus(0.86 * radius, neck - 0.12 * radius, neck),
                [[0.84 * radius, neck + 0.02 * radius], [0.86 * radius, neck + 0.6 * capital], [1.15 * radius, neck + 0.88 * capital]],
                [[1.28 * radius, head - 0.01], [1.28 * radius, head + 0.01], [0.3 * radius, head + 0.01]],
            ]
        )
    else:
        profile = np.array(
            [(1.3, foot - 0.01), (1.0, foot + 0.7 * radius), (0.86, neck), (0.86, neck + 0.6 * capital), (1.28, head + 0.01)]
        ) * [radius, 1]
    chamfer = detail.chamfer(0.05 * radius)
    parts = [
        box((2.9 * radius, 2.9 * radius, plinth), (0, 0, plinth / 2), chamfer),
        lathe(profile, segments),
        box((2.9 * radius, 2.9 * radius, abacus), (0, 0, height - abacus / 2), chamfer),
    ]
    if detail.full:
        for row, (start, length, turn) in enumerate([(0.0, 0.55, 0.0), (0.25, 0.68, 0.5)]):
            leaf = _acanthus(0.87 * radius, neck + start * capital, length * capital, 2 * np.pi / leaves * radius * (0.95 - 0.1 * row))
            parts += [leaf.turned((i + turn) * 2 * np.pi / leaves) for i in range(leaves)]
    return joined(parts)


def _acanthus(radius: float, foot: float, height: float, width: float) -> Shape:
    """One leaf of a capital, that rises at `radius` from the axis (towards +x) and curls outwards at its tip."""
    v, u = np.meshgrid(np.linspace(0, 1, 6), np.linspace(-1, 1, 4), indexing="ij")
    outline = np.sqrt(np.clip(1.02 - v**3, 0, 1))
    out = 0.02 * radius + 0.42 * radius * v**3 - 0.08 * radius * u**2 * (1 - v)
    curl = np.where(v > 0.85, (v - 0.85) * 0.9, 0) * height
    points = np.stack([radius + out, u * width / 2 * outline, foot + v * height - curl], axis=-1)
    return sheet(points, thickness=np.array([-0.06 * radius, 0, 0.01 * radius]))


def baluster(height: float, radius: float) -> Shape:
    """A turned baluster between two square blocks; its foot is at z = 0."""
    block = 0.1 * height
    belly = np.array(
        [
            (0.62, 0.1),
            (0.7, 0.13),
            (0.55, 0.18),
            (0.9, 0.26),
            (1.0, 0.34),
            (0.92, 0.43),
            (0.6, 0.58),
            (0.45, 0.72),
            (0.45, 0.8),
            (0.7, 0.84),
            (0.62, 0.9),
        ]
    )
    profile = np.concatenate([[[0.2, 0.09]], belly, [[0.2, 0.91]]]) * [radius, height]
    blocks = [box((2 * radius, 2 * radius, block), (0, 0, z)) for z in (block / 2, height - block / 2)]
    return joined([lathe(profile, 12), *blocks])


def arcade_outline(length: float, bays: int, opening: float, top: float, segments: int) -> np.ndarray:
    """The outline (N, 2), counter-clockwise, of a wall over round arches: x from 0 to length, z from 0 (springing) to top."""
    pitch = length / bays
    lower = [np.array([[0.0, 0.0]])]
    for bay in range(bays):
        lower.append(arc(opening / 2, np.pi, 0.0, segments, ((bay + 0.5) * pitch, 0.0)))
    return np.concatenate([*lower, [[length, 0.0], [length, top], [0.0, top]]])


def curtain(
    detail: Detail, seed: int, width: float, height: float, cloth: float, gathered: float, tie: float = 0.45, folds: int = 7
) -> Shape:
    """A curtain in the xz plane that hangs from x = 0 to width at z = height and is tied back to x = 0; its hem is at z = 0.

    cloth: width of the flat cloth, which decides how deep the folds are.  gathered: its width at the tie, a part `tie` of
    the height above the hem.
    """
    rng = np.random.default_rng(seed)
    folds = folds if detail.full else (folds + 1) // 2
    t, s = np.meshgrid(np.linspace(0, 1, detail.segments(24, 4)), np.linspace(0, 1, detail.segments(8, 3) * folds + 1), indexing="ij")
    above, below = np.clip(t / (1 - tie), 0, 1), np.clip((t - 1 + tie) / tie, 0, 1)
    ease = above**2 * (3 - 2 * above)
    span = width * (1 - ease) + gathered * ease + 0.35 * width * below**0.7
    bend = rng.uniform(-0.4, 0.4, 3)
    phase = bend[0] * np.sin(2.2 * t + bend[1]) + 0.6 * np.sin(2 * np.pi * (s + bend[2])) * t
    depth = cloth / folds / 4 * np.sqrt(np.clip(1 - (span / cloth) ** 2, 0.02, 1))
    uneven = 1 + 0.35 * np.sin(2 * np.pi * (1.7 * s + rng.uniform()))
    y = depth * uneven * np.sin(2 * np.pi * folds * s + phase)
    slack = 0.12 * width * np.sin(np.pi * above) * s
    points = np.stack([s * span, y, height * (1 - t) - slack], axis=-1)
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    uv = np.stack([s * cloth, height * (1 - t)], axis=-1)
    return sheet(points, uv, thickness=-0.006 * normal)


def pot(detail: Detail, height: float, radius: float) -> Shape:
    """A pot with a rolled rim, filled with earth (material slot 1); its foot is at z = 0."""
    wall = 0.1 * radius
    outer = np.array([(0.66, 0.0), (0.7, 0.03), (0.86, 0.45), (0.93, 0.86), (1.04, 0.87), (1.08, 0.93), (1.04, 1.0)]) * [radius, height]
    inner = np.array([(0.97 * radius - wall, height), (0.93 * radius - wall, 0.86 * height), (0.2 * radius, 0.84 * height)])
    vessel = lathe(np.concatenate([outer, inner]), detail.segments(32, 6))
    earth = lathe(
        np.array([(0.9 * radius - wall, 0.7 * height), (0.95 * radius - wall, 0.9 * height), (0.1 * radius, 0.93 * height)]),
        detail.segments(24, 6),
    )
    return joined([vessel, earth.slotted(1)])


def _blade(root: np.ndarray, heading: float, rise: float, length: float, width: float, droop: float, steps: int) -> Shape:
    """A bent strip that starts at `root`, heading (rad, about z) and rising (rad), and droops by `droop` rad towards its tip.

    It has no thickness; u and v run over it from 0 to 1.
    """
    t = np.linspace(0, 1, steps + 1)
    slope = rise - droop * t**1.3
    along = np.concatenate([[0], np.cumsum(np.cos(slope[:-1]))]) * length / steps
    up = np.concatenate([[0], np.cumsum(np.sin(slope[:-1]))]) * length / steps
    centre = root + np.column_stack([along * np.cos(heading), along * np.sin(heading), up])
    side = np.array([-np.sin(heading), np.cos(heading), 0.0]) * width / 2
    normal = np.column_stack([-np.sin(slope) * np.cos(heading), -np.sin(slope) * np.sin(heading), np.cos(slope)])
    fold = 0.18 * width * normal  # both halves stand up a little from the midrib
    points = np.stack([centre + side + fold, centre, centre - side + fold], axis=1)
    uv = np.stack(np.broadcast_arrays(np.array([0, 0.5, 1])[None], t[:, None]), axis=-1)
    return sheet(points, uv)


def palm(detail: Detail, seed: int, height: float, fronds: int = 18) -> Shape:
    """A bushy feather palm without thickness, for the texture of one frond; it grows from the origin."""
    rng = np.random.default_rng(seed)
    count = detail.segments(fronds, fronds // 3)
    parts = []
    for i in range(count):
        rise = np.radians(np.interp(i, [0, count - 1], [48, 84]))
        length = height * rng.uniform(0.85, 1.12) * (0.75 + 0.25 * i / count)
        root = np.array([*rng.normal(0, 0.02, 2), 0.0])
        parts.append(
            _blade(root, i * 2.39996 + rng.normal(0, 0.15), rise, length, 0.42 * length, rng.uniform(1.0, 1.7), detail.segments(12, 4))
        )
    return joined(parts)


def shrub(detail: Detail, seed: int, radius: float, leaf: float, leaves: int = 450) -> Shape:
    """A clipped round shrub of single leaves without thickness, centred on the origin; `leaf` is a leaf's length."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(detail.segments(leaves, leaves // 26)):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        root = direction * radius * rng.uniform(0.55, 1.0) ** 0.5
        rise = np.arcsin(np.clip(direction[2] * 0.6 + rng.normal(0, 0.25), -1, 1))
        heading = np.arctan2(direction[1], direction[0]) + rng.normal(0, 0.7)
        size = leaf * rng.uniform(0.7, 1.15) * (1.0 if detail.full else 3.0)
        parts.append(_blade(root, heading, rise, size, 0.5 * size, rng.uniform(0.3, 1.2), 2))
    return joined(parts)


def panel_door(detail: Detail, width: float, height: float) -> Shape:
    """A door leaf (with six raised panels at full detail) in the xz plane, 6 cm thick, its foot at z = 0 and its front towards -y."""
    parts = [box((width, 0.06, height), (0, 0, height / 2), detail.chamfer(0.004))]
    for column in (-1, 1) if detail.full else ():
        for low, high in ((0.06, 0.3), (0.36, 0.68), (0.74, 0.94)):
            size = (0.36 * width, 0.03, (high - low) * height)
            for side in (-1, 1):
                parts.append(box(size, (column * 0.22 * width, side * 0.028, (low + high) / 2 * height), 0.01))
    return joined(parts)


def frame(width: float, height: float, bar: float, depth: float) -> Shape:
    """A rectangular frame in the xz plane round an opening of width x height whose lower left corner is the origin, centred on y = 0."""
    inner = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    outer = inner + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * bar
    vertices = np.concatenate(
        [np.column_stack([ring[:, 0], np.full(4, y), ring[:, 1]]) for ring in (inner, outer) for y in (-depth / 2, depth / 2)]
    )
    faces = []
    for i in range(4):
        j = (i + 1) % 4
        inner_front, inner_back, outer_front, outer_back = ((k + i, k + j) for k in (0, 4, 8, 12))
        faces += [
            [outer_front[0], outer_front[1], inner_front[1], inner_front[0]],
            [inner_back[0], inner_back[1], outer_back[1], outer_back[0]],
            [inner_front[0], inner_front[1], inner_back[1], inner_back[0]],
            [outer_back[0], outer_back[1], outer_front[1], outer_front[0]],
        ]
    return polygons(vertices, faces)


def upright(shape: Shape) -> Shape:
    """A shape drawn in the xy plane and raised along z, set up: its y becomes z, its thickness runs along -y from 0."""
    return shape.turned(np.pi / 2, "x")


def rectangle(half_x: float, half_y: float, centre: Sequence[float] = (0, 0)) -> np.ndarray:
    """The outline (4, 2) of a rectangle, counter-clockwise."""
    return np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]]) + np.asarray(centre, float)
