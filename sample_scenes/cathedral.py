"""A Gothic nave with aisles, rib vaults and coloured windows over a polished floor.

All light is the sun and the sky's, and comes through leaded glass.  x runs from the west door (0) to the altar, y across;
the nave is 9.2 m wide between the piers' axes and 18 m high.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import textures
from .furnishings import SMOOTH, rectangle, upright
from .furniture import table
from .materials import Surface, coloured_glass, principled
from .primitives import Shape, arc, box, joined, lathe, mesh, place, polygons, prism, sheet, sweep
from .stage import Detail, camera, clear_sky, empty_scene, sun, world

BAY, BAYS = 5.2, 7
LENGTH = BAY * BAYS
AXIS = 4.6  # of the piers, from the middle of the nave
NAVE_WALL, OUTER_WALL = 0.9, 0.8
AISLE = 9.0  # inner face of the outer walls
ARCADE_SPRING, VAULT_SPRING = 6.0, 12.4
ARCADE_OPENING = 4.0
AISLE_RISE, NAVE_RISE = 3.1, 5.7
AISLE_ROOF, NAVE_ROOF = 9.8, 18.6
POINTED = 1.3  # radius of a pointed arch's arcs in half spans
SUN = np.array([0.34, 0.66, -0.62])  # where its light goes


def _pointed(t: np.ndarray) -> np.ndarray:
    """Height of a pointed arch over t from -1 to 1: 0 at the ends, 1 at the crown."""
    crown = np.sqrt(POINTED**2 - (POINTED - 1) ** 2)
    return np.sqrt(np.clip(POINTED**2 - (np.abs(t) + POINTED - 1) ** 2, 0, None)) / crown


def _arch(half: float, rise: float, segments: int) -> np.ndarray:
    """(2 segments + 1, 2) points of a pointed arch from (-half, 0) over (0, rise) to (half, 0)."""
    t = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * segments + 1))
    return np.column_stack([t * half, _pointed(t) * rise])


def _lancet(detail: Detail, width: float, height: float, x: float, sill: float) -> np.ndarray:
    """The outline, counter-clockwise, of a lancet window, its sill's middle at (x, sill)."""
    rise = 1.25 * width / 2
    head = _arch(width / 2, rise, detail.segments(8, 2))[::-1] + np.array([x, sill + height - rise])
    return np.concatenate([[[x - width / 2, sill], [x + width / 2, sill]], head])


def _circle(detail: Detail, radius: float, x: float, z: float) -> np.ndarray:
    return arc(radius, 0, 2 * np.pi, detail.segments(24, 8), (x, z))[:-1]


def _lights(detail: Detail, x: float, sill: float, scale: float) -> list[np.ndarray]:
    """A window's openings: two lancets and a roundel over them."""
    pair = [_lancet(detail, 0.78 * scale, 2.9 * scale, x + side * 0.52 * scale, sill) for side in (-1, 1)]
    return [*pair, _circle(detail, 0.42 * scale, x, sill + 3.22 * scale)]


def _materials() -> dict[str, Surface]:
    tones = [(0.50, 0.46, 0.40), (0.54, 0.49, 0.42), (0.47, 0.43, 0.38)]
    return {
        "ashlar": principled("Ashlar", textures.paving(201, tones, 3, 6, 0.004, 0.5), tile=3.0, roughness=0.8, specular=0.15),
        "stone": principled("Limestone", textures.stone(202, (0.58, 0.53, 0.45)), tile=2.0, roughness=0.7, specular=0.2),
        "web": principled("Vault", textures.plaster(203, (0.60, 0.56, 0.48)), tile=3.0, roughness=0.85, specular=0.1),
        "floor": principled("Polished floor", textures.paving(204, [(0.50, 0.45, 0.38), (0.14, 0.12, 0.115)], 4, 4, 0.002, chequered=True), tile=2.8, roughness=0.16, specular=0.5),
        "step": principled("Marble steps", textures.marble(205, (0.62, 0.60, 0.56), (0.30, 0.28, 0.27)), tile=2.0, roughness=0.25, specular=0.45),
        "oak": principled("Dark oak", textures.wood(206, (0.16, 0.085, 0.045)), tile=1.4, roughness=0.4, specular=0.35),
        "lead": principled("Roof", (0.2, 0.2, 0.21), roughness=0.7, specular=0.2),
        "cloth": principled("Altar cloth", textures.fabric(207, (0.74, 0.72, 0.67), (0.50, 0.06, 0.05)), tile=1.2, roughness=0.9, specular=0.0),
        "carpet": principled("Carpet", textures.fabric(208, (0.36, 0.03, 0.035)), tile=0.8, roughness=0.95, specular=0.0),
        "gold": principled("Gilt", (0.85, 0.60, 0.22), roughness=0.3, specular=0.5, metallic=1.0),
        "wax": principled("Wax", (0.78, 0.74, 0.62), roughness=0.5, specular=0.3),
        "glass": coloured_glass("Leaded glass", textures.stained_glass(209, 4, 12), tile=3.4),
        "pale glass": coloured_glass("Grisaille", textures.stained_glass(211, 4, 12, pale=True), tile=3.4),
        "rose": coloured_glass("Rose glass", textures.rose_glass(210)),
    }  # fmt: skip


def build(detail: Detail):
    """The cathedral has no parameters."""
    scene = empty_scene(exposure=2.2)
    look = _materials()
    _floor_and_roofs(detail, look)
    for side in (-1, 1):
        _nave_wall(detail, look, side)
        _outer_wall(detail, look, side)
        _piers(detail, look, side)
    for end in (0, 1):
        _end_wall(detail, look, end)
    _vaults(detail, look)
    _furnish(detail, look)
    sun(SUN, 40.0, (1.0, 0.95, 0.86))
    world(clear_sky(-SUN, (0.7, 1.1, 1.9)))
    camera((1.2, -0.9, 1.7), (LENGTH, 0.15, 8.6), lens=17.0)
    camera((6.5, 6.9, 1.7), (30.0, 1.0, 4.5), lens=20.0, name="Aisle camera", active=False)
    return scene


def _floor_and_roofs(detail: Detail, look: dict[str, Surface]) -> None:
    middle = (LENGTH / 2, 0.0)
    place("Floor", mesh("Floor", prism(rectangle(LENGTH / 2 + 0.7, AISLE + 0.7, middle), 0.4).moved(z=-0.4), look["floor"]))
    place("Nave roof", mesh("Nave roof", prism(rectangle(LENGTH / 2 + 1.1, AXIS + 0.8, middle), 0.4).moved(z=NAVE_ROOF), look["lead"]))
    for side in (-1, 1):
        across = (AISLE + 1.1 - AXIS) / 2
        roof = prism(rectangle(LENGTH / 2 + 1.05, across, (LENGTH / 2, side * (AXIS + across))), 0.35)
        place("Aisle roof", mesh("Aisle roof", roof.moved(z=AISLE_ROOF), look["lead"]))


def _panes(name: str, outlines: list[np.ndarray], surface: Surface, stretch: bool = False):
    """A mesh of panes in the plane y = 0, a little larger than their openings; `stretch` fits one texture to all of them."""
    count, vertices, faces = 0, [], []
    for outline in outlines:
        middle = outline.mean(axis=0)
        edge = middle + (outline - middle) * (1 + 0.04 / np.linalg.norm(outline - middle, axis=1, keepdims=True))
        vertices.append(np.column_stack([edge[:, 0], np.zeros(len(edge)), edge[:, 1]]))
        faces.append(range(count, count + len(edge)))
        count += len(edge)
    shape = polygons(np.concatenate(vertices), faces)
    if stretch:
        shape = replace(shape, uv=(shape.uv - shape.uv.min(axis=0)) / np.ptp(shape.uv, axis=0))
    return mesh(f"Open {name}", shape, surface)


def _nave_wall(detail: Detail, look: dict[str, Surface], side: int) -> None:
    """The wall over the arcade, with the clerestory."""
    lower = [(-0.35, 0.0)]
    for bay in range(BAYS):
        lower += (_arch(ARCADE_OPENING / 2, 1.265 * ARCADE_OPENING / 2, detail.segments(14, 3)) + np.array([(bay + 0.5) * BAY, 0])).tolist()
    outline = np.array(
        [*lower, (LENGTH + 0.35, 0.0), (LENGTH + 0.35, NAVE_ROOF + 0.1 - ARCADE_SPRING), (-0.35, NAVE_ROOF + 0.1 - ARCADE_SPRING)]
    )
    windows = [hole for bay in range(BAYS) for hole in _lights(detail, (bay + 0.5) * BAY, 12.5 - ARCADE_SPRING, 1.05)]
    y = side * AXIS
    wall = upright(prism(outline, NAVE_WALL, windows, detail.chamfer(0.05))).moved(y=y + NAVE_WALL / 2, z=ARCADE_SPRING - 0.004)
    place("Nave wall", mesh("Nave wall", wall, look["ashlar"], SMOOTH))
    place("Clerestory", _panes("clerestory", windows, look["pale glass"]), (0, y, ARCADE_SPRING))
    string = np.array([(-0.1, 0.0), (0.08, 0.0), (0.14, 0.09), (0.14, 0.14), (-0.1, 0.2)])
    for z in (9.6, 12.0):
        path = np.array([[-0.2, 0, 0], [LENGTH + 0.2, 0, 0]])
        moulding = sweep(string, path if side > 0 else path[::-1]).moved(y=side * (AXIS - NAVE_WALL / 2), z=z)
        place("String course", mesh("String course", moulding, look["stone"]))
    if detail.full:
        path = _arch(ARCADE_OPENING / 2 + 0.02, 1.265 * (ARCADE_OPENING / 2 + 0.02), 14)
        path = np.column_stack([path[:, 0], np.zeros(len(path)), path[:, 1]])
        roll = np.array([(0.0, -0.1), (0.26, -0.1), (0.26, 0.06), (0.2, 0.1), (0.14, 0.06), (0.08, 0.12), (0.0, 0.08)])
        arch = mesh("Arch moulding", sweep(roll, path, normal=(0, 1, 0)), look["stone"], SMOOTH)
        for bay in range(BAYS):
            for face in (-1, 1):
                turn = 0.0 if face > 0 else np.pi
                place("Arch moulding", arch, ((bay + 0.5) * BAY, y + face * NAVE_WALL / 2, ARCADE_SPRING), turn)


def _outer_wall(detail: Detail, look: dict[str, Surface], side: int) -> None:
    windows = [hole for bay in range(BAYS) for hole in _lights(detail, (bay + 0.5) * BAY, 2.6, 1.25)]
    outline = rectangle(LENGTH / 2 + 0.4, (AISLE_ROOF + 0.4) / 2, (LENGTH / 2, (AISLE_ROOF + 0.2) / 2 - 0.15))
    wall = upright(prism(outline, OUTER_WALL, windows)).moved(y=side * (AISLE + OUTER_WALL / 2) + OUTER_WALL / 2)
    place("Outer wall", mesh("Outer wall", wall, look["ashlar"]))
    place("Aisle windows", _panes("aisle windows", windows, look["glass"]), (0, side * (AISLE + OUTER_WALL / 2), 0))
    bench = joined(
        [
            box((LENGTH + 0.2, 0.5, 0.42), (LENGTH / 2, side * (AISLE - 0.2), 0.2), detail.chamfer(0.02)),
            box((LENGTH + 0.2, 0.3, 0.16), (LENGTH / 2, side * AISLE, 2.3), detail.chamfer(0.03)),
        ]
    )
    place("Wall bench", mesh("Wall bench", bench, look["stone"]))


def _shaft(radius: float, low: float, high: float, segments: int, detail: Detail) -> Shape:
    """A slender shaft with a base and a bell capital."""
    if detail.full:
        rings = [
            (1.5, 0),
            (1.55, 0.08),
            (1.35, 0.16),
            (1.45, 0.24),
            (1.05, 0.34),
            (1, 0.4),
            (1, -0.62),
            (1.2, -0.6),
            (1.2, -0.54),
            (1.02, -0.5),
            (1.1, -0.25),
            (1.6, -0.1),
            (1.6, 0.0),
        ]
    else:
        rings = [(1.5, 0), (1, 0.3), (1, -0.5), (1.6, -0.02)]
    scale = min(1.0, radius / 0.2)
    profile = [(radius * r, (low + z * scale) if index < len(rings) // 2 else (high + z * scale)) for index, (r, z) in enumerate(rings)]
    return lathe(np.array(profile), segments)


def _piers(detail: Detail, look: dict[str, Surface], side: int) -> None:
    """Compound piers; their front shafts rise to the vault.  Half piers stand on the outer walls."""
    around, thin = detail.segments(32, 6), detail.segments(16, 4)
    octagon = arc(1.0, np.pi / 8, 2 * np.pi + np.pi / 8, 8)[:-1]
    parts = [
        prism(octagon * 0.98, 0.3, chamfer=detail.chamfer(0.03)).moved(z=-0.01),
        prism(octagon * 0.86, 0.3, chamfer=detail.chamfer(0.04)).moved(z=0.25),
        _shaft(0.5, 0.5, ARCADE_SPRING - 0.19, around, detail),
        prism(octagon * 0.93, 0.22, chamfer=detail.chamfer(0.03)).moved(z=ARCADE_SPRING - 0.2),
    ]
    diagonals = np.arange(4) * np.pi / 2
    parts += [_shaft(0.15, 0.5, ARCADE_SPRING - 0.18, thin, detail).moved(0.52 * np.cos(a), 0.52 * np.sin(a)) for a in diagonals]
    pier = mesh("Pier", joined(parts), look["stone"], SMOOTH)
    front = NAVE_WALL / 2 + 0.05
    vault_shaft = mesh(
        "Vault shaft",
        joined(
            [
                _shaft(0.15, ARCADE_SPRING - 0.1, VAULT_SPRING, thin, detail),
                *[_shaft(0.1, ARCADE_SPRING - 0.1, VAULT_SPRING - 0.01, thin, detail).moved(s * 0.24, 0.08) for s in (-1, 1)],
            ]
        ),
        look["stone"],
        SMOOTH,
    )
    respond = mesh(
        "Respond",
        joined(
            [
                box((0.9, 0.5, 0.5), (0, 0, 0.245), detail.chamfer(0.03)),
                _shaft(0.26, 0.45, ARCADE_SPRING - 0.01, around, detail),
                box((0.7, 0.6, 0.18), (0, 0, ARCADE_SPRING - 0.1), detail.chamfer(0.03)),
            ]
        ),
        look["stone"],
        SMOOTH,
    )
    for index in range(BAYS + 1):
        x = index * BAY
        turn = np.pi if side > 0 else 0.0
        if 0 < index < BAYS:
            place("Pier", pier, (x, side * AXIS, 0))
        place("Vault shaft", vault_shaft, (x, side * (AXIS - front), 0), turn + np.pi)
        place("Respond", respond, (x, side * (AISLE + 0.0), 0))


def _vault(detail: Detail, half_width: float, rise: float, turns: int) -> Shape:
    """The web of a row of rib vaults from x = 0 to LENGTH, centred on y = 0, springing at z = 0; level above."""
    steps = detail.segments(10, 2)
    t = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * steps + 1))
    along = np.concatenate([(bay + 0.5) * BAY + t[(bay > 0) :] * BAY / 2 for bay in range(turns)])
    lunette = np.concatenate([_pointed(t)[(bay > 0) :] for bay in range(turns)])
    height = np.maximum(lunette[:, None], _pointed(t)[None, :]) * rise
    points = np.stack(np.broadcast_arrays(along[:, None], t[None, :] * half_width, height), axis=-1)
    upwards = np.stack([np.zeros_like(height), np.zeros_like(height), rise + 0.25 - height], axis=-1)
    return sheet(points, points[..., :2].copy(), thickness=upwards)


def _ribs(detail: Detail, half_width: float, rise: float, size: float) -> Shape:
    """The ribs of one bay: two diagonals and the arch across at its start; springing at z = 0, the bay's start at x = 0."""
    steps = detail.segments(14, 2)
    t = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * steps + 1))
    section = np.array([(-0.9, -0.28), (-0.9, 0.28), (-0.45, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.45, -0.5)])[::-1] * size
    parts = []
    lines = [
        ((0, -half_width), (BAY, half_width), 1.0),
        ((0, half_width), (BAY, -half_width), 1.0),
        ((0, -half_width), (0, half_width), 1.3),
    ]
    for start, end, scale in lines:
        start, end = np.array(start), np.array(end)
        flat = (start + end) / 2 + t[:, None] * (end - start) / 2
        path = np.column_stack([flat, _pointed(t) * rise + 0.02])
        direction = (end - start) / np.linalg.norm(end - start)
        parts.append(sweep(section * scale, path, normal=(-direction[1], direction[0], 0)))
    boss = lathe(np.array([(0.5, -0.9), (0.9, -0.8), (1.2, -0.5), (1.2, 0.3), (0.5, 0.4)]) * size, detail.segments(20, 6)).moved(
        BAY / 2, 0, rise
    )
    return joined([*parts, boss])


def _vaults(detail: Detail, look: dict[str, Surface]) -> None:
    nave_half = AXIS - NAVE_WALL / 2
    aisle_half = (AISLE - AXIS - NAVE_WALL / 2) / 2
    aisle_middle = (AISLE + AXIS + NAVE_WALL / 2) / 2
    web = mesh("Nave vault", _vault(detail, nave_half + 0.08, NAVE_RISE, BAYS), look["web"], SMOOTH)
    place("Nave vault", web, (0, 0, VAULT_SPRING))
    rib = mesh("Nave ribs", _ribs(detail, nave_half, NAVE_RISE, 0.24), look["stone"], SMOOTH)
    aisle_web = mesh("Aisle vault", _vault(detail, aisle_half + 0.08, AISLE_RISE, BAYS), look["web"], SMOOTH)
    aisle_rib = mesh("Aisle ribs", _ribs(detail, aisle_half, AISLE_RISE, 0.19), look["stone"], SMOOTH)
    for side in (-1, 1):
        place("Aisle vault", aisle_web, (0, side * aisle_middle, ARCADE_SPRING))
    for bay in range(BAYS):
        place("Nave ribs", rib, (bay * BAY, 0, VAULT_SPRING))
        for side in (-1, 1):
            place("Aisle ribs", aisle_rib, (bay * BAY, side * aisle_middle, ARCADE_SPRING))


def _end_wall(detail: Detail, look: dict[str, Surface], end: int) -> None:
    """West (0) or east (1) front: a rose over lancets, or over the door."""
    low, shoulder, top = -0.14, AISLE_ROOF + 0.12, NAVE_ROOF + 0.12
    wide, narrow = AISLE + 0.75, AXIS + 0.6
    outline = np.array(
        [
            (-wide, low),
            (wide, low),
            (wide, shoulder),
            (narrow, shoulder),
            (narrow, top),
            (-narrow, top),
            (-narrow, shoulder),
            (-wide, shoulder),
        ]
    )
    rose = arc(2.3, 0, 2 * np.pi, detail.segments(48, 16), (0, 13.6))[:-1]
    lancets = [_lancet(detail, 1.0, 5.4 - 0.7 * abs(i), 1.55 * i, 3.9) for i in (-1, 0, 1)] if end else []
    side_lights = [hole for s in (-1, 1) for hole in _lights(detail, s * 7.0, 3.0, 1.1)]
    wall = upright(prism(outline, 0.9, [rose, *lancets, *side_lights], detail.chamfer(0.04))).moved(y=0.45)
    x = LENGTH + 0.45 if end else -0.45
    turn = -np.pi / 2 if end else np.pi / 2  # the wall's front (-y) looks into the nave
    place("End wall", mesh("End wall", wall, look["ashlar"], SMOOTH), (x, 0, 0), turn)
    place("Rose", _panes("rose", [rose], look["rose"], stretch=True), (x, 0, 0), turn)
    place("End windows", _panes("end windows", [*lancets, *side_lights], look["glass"]), (x, 0, 0), turn)
    bars = [
        sweep(
            np.array([(-0.07, -0.12), (0.07, -0.12), (0.07, 0.12), (-0.07, 0.12)]),
            _ring_path(radius, detail),
            normal=(0, 1, 0),
            closed=True,
        )
        for radius in (0.5, 1.1, 2.26)
    ]
    spokes = [box((0.09, 0.2, 1.85), (0, 0, 1.37), 0).turned(i * np.pi / 6, "y") for i in range(12)]
    tracery = mesh("Rose tracery", joined([*bars, *spokes]), look["stone"], SMOOTH)
    place("Rose tracery", tracery, (x, 0, 13.6), turn)
    if not end:
        door = joined([box((1.15, 0.12, 3.4), (s * 0.59, 0, 1.71), detail.chamfer(0.02)) for s in (-1, 1)])
        place("West door", mesh("West door", door, look["oak"]), (0.04, 0, 0), turn)


def _ring_path(radius: float, detail: Detail) -> np.ndarray:
    """A circle about y, the way round in which `sweep`'s first axis points outwards."""
    ring = arc(radius, 2 * np.pi, 0, detail.segments(48, 16))[:-1]
    return np.column_stack([ring[:, 0], np.zeros(len(ring)), ring[:, 1]])


def _furnish(detail: Detail, look: dict[str, Surface]) -> None:
    pew = joined(
        [
            box((0.42, 2.6, 0.05), (0, 0, 0.45), detail.chamfer(0.01)),
            box((0.05, 2.6, 0.5), (-0.22, 0, 0.7), detail.chamfer(0.01)),
            box((0.16, 2.6, 0.04), (-0.3, 0, 0.93), detail.chamfer(0.01)),
            *[box((0.6, 0.07, 0.98), (-0.06, s * 1.31, 0.485), detail.chamfer(0.015)) for s in (-1, 1)],
        ]
    )
    pew = mesh("Pew", pew, look["oak"])
    for row in range(14):
        for side in (-1, 1):
            place("Pew", pew, (11.5 + 1.05 * row, side * 2.45, 0.004))
    place("Carpet", mesh("Carpet", box((1.9, 1.5, 0.01), (0, 0, 0.004)), look["carpet"]), (28.4, 0, 0))
    for level in range(3):
        length = LENGTH - 28.9 - 0.36 * level
        step = box((length + 0.2, 8.0 - 0.5 * level, 0.18), (LENGTH - length / 2 + 0.1, 0, 0.08 + 0.16 * level), detail.chamfer(0.015))
        place("Step", mesh("Step", step, look["step"]))
    altar = joined([box((0.9, 2.6, 0.95), (0, 0, 0.475), detail.chamfer(0.02)), box((1.1, 2.9, 0.1), (0, 0, 0.98), detail.chamfer(0.02))])
    place("Altar", mesh("Altar", altar, look["step"]), (33.4, 0, 0.485))
    place("Altar cloth", mesh("Altar cloth", box((1.12, 1.5, 0.02), (0, 0, 1.035)), look["cloth"]), (33.4, 0, 0.485))
    place("Altar front", mesh("Altar front", box((0.012, 1.5, 0.6), (-0.556, 0, 0.74)), look["cloth"]), (33.4, 0, 0.485))
    stick = lathe(
        np.array(
            [
                (0.11, 0.0),
                (0.1, 0.03),
                (0.03, 0.06),
                (0.025, 0.3),
                (0.04, 0.33),
                (0.02, 0.36),
                (0.02, 0.5),
                (0.07, 0.53),
                (0.07, 0.55),
                (0.02, 0.56),
            ]
        ),
        detail.segments(20, 6),
    )
    candle = lathe(np.array([(0.025, 0.555), (0.025, 0.9), (0.01, 0.91)]), detail.segments(12, 6)).slotted(1)
    candlestick = mesh("Candlestick", joined([stick, candle]), [look["gold"], look["wax"]], SMOOTH)
    for y in (-1.15, -0.9, 0.9, 1.15):
        place("Candlestick", candlestick, (33.5, y, 0.485 + 1.031))
    place("Credence", mesh("Credence", table(detail, 0.5, 1.2, 0.9), look["oak"]), (34.0, -3.0, 0.485))
