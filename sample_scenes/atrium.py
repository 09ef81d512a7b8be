"""A two-storey colonnade round a court under the open sky.

The sun stands high and reaches the court, one arcade and its curtains; all the rest has its light from there.
Everything is laid out from the centre of the court: x along it, y across it.
"""

from __future__ import annotations

import numpy as np

from . import textures
from .furnishings import SMOOTH, arcade_outline, baluster, column, curtain, palm, panel_door, pot, rectangle, shrub, upright
from .materials import Surface, principled
from .primitives import Shape, arc, box, joined, lathe, mesh, place, prism, sheet, sweep
from .stage import Detail, camera, clear_sky, empty_scene, sun, world

BAY = 2.8
BAYS_X, BAYS_Y = 7, 4
X, Y = BAYS_X * BAY / 2, BAYS_Y * BAY / 2  # the arcades' centre lines
AISLE = 3.2  # from there to the outer walls
FLOOR = 0.15  # the aisle lies a step above the court
SPRING = FLOOR + 2.75
GALLERY = 4.85  # floor of the upper storey
RAIL = GALLERY + 1.0
UPPER_SPRING = RAIL + 1.7
EAVES = 9.1
WALL = 0.5
SUN = np.array([0.38, 0.42, -0.95])  # where its light goes


def _sides() -> list[tuple[float, float, float, int, float]]:
    """The four arcades: (x, y) where each starts, its direction (rad), its bays, its length.  The court is to the left."""
    return [
        (-X, -Y, 0.0, BAYS_X, 2 * X),
        (X, -Y, np.pi / 2, BAYS_Y, 2 * Y),
        (X, Y, np.pi, BAYS_X, 2 * X),
        (-X, Y, -np.pi / 2, BAYS_Y, 2 * Y),
    ]


def _along(side: tuple[float, float, float, int, float], distance: float, inward: float = 0.0) -> tuple[float, float]:
    """A point of an arcade: `distance` m from its start, `inward` m from its centre line towards the court."""
    x, y, turn, _, _ = side
    return x + distance * np.cos(turn) - inward * np.sin(turn), y + distance * np.sin(turn) + inward * np.cos(turn)


def _materials() -> dict[str, Surface]:
    sandstone, pale = (0.56, 0.46, 0.34), (0.66, 0.58, 0.47)
    return {
        "stone": principled("Limestone", textures.stone(11, pale), tile=2.0, roughness=0.75, specular=0.15),
        "sand": principled("Sandstone", textures.stone(12, sandstone, 0.08), tile=2.0, roughness=0.8, specular=0.1),
        "ashlar": principled("Ashlar", textures.paving(13, [sandstone, (0.6, 0.5, 0.38), (0.52, 0.42, 0.31)], 3, 6, 0.005, 0.5), tile=2.4, roughness=0.8, specular=0.1),
        "ochre": principled("Ochre plaster", textures.plaster(14, (0.68, 0.50, 0.29)), tile=3.0, roughness=0.85, specular=0.05),
        "dado": principled("Red plaster", textures.plaster(15, (0.40, 0.10, 0.055), 0.07), tile=2.0, roughness=0.8, specular=0.1),
        "paving": principled("Court paving", textures.paving(16, [(0.52, 0.44, 0.34), (0.46, 0.38, 0.29), (0.57, 0.49, 0.39)], 4, 4, 0.004, 0.5), tile=2.8, roughness=0.6, specular=0.2),
        "tile": principled("Court slab", textures.stone(16, (0.52, 0.44, 0.34), 0.07), tile=2.8, roughness=0.6, specular=0.2),
        "mortar": principled("Mortar", (0.26, 0.23, 0.2), roughness=0.9, specular=0.0),
        "chequer": principled("Aisle tiles", textures.paving(17, [(0.60, 0.54, 0.45), (0.28, 0.10, 0.065)], 4, 4, 0.003, chequered=True), tile=1.6, roughness=0.45, specular=0.25),
        "wood": principled("Oak", textures.wood(18, (0.24, 0.135, 0.07)), tile=1.5, roughness=0.6, specular=0.2),
        "boards": principled("Oak boards", textures.wood(19, (0.30, 0.18, 0.10), 6), tile=1.2, roughness=0.65, specular=0.2),
        "terracotta": principled("Terracotta", textures.plaster(20, (0.50, 0.21, 0.11), 0.08), tile=1.0, roughness=0.8, specular=0.15),
        "earth": principled("Earth", (0.06, 0.04, 0.028), roughness=0.9, specular=0.0),
        "red": principled("Red cloth", textures.fabric(21, (0.50, 0.035, 0.03), (0.62, 0.42, 0.12)), tile=1.3, roughness=0.8, specular=0.05),
        "green": principled("Green cloth", textures.fabric(22, (0.06, 0.27, 0.10), (0.62, 0.42, 0.12)), tile=1.3, roughness=0.8, specular=0.05),
        "blue": principled("Blue cloth", textures.fabric(23, (0.05, 0.12, 0.42), (0.62, 0.42, 0.12)), tile=1.3, roughness=0.8, specular=0.05),
        "palm": principled("Palm frond", textures.frond(24, (0.10, 0.26, 0.05)), roughness=0.5, specular=0.2),
        "leaf": principled("Laurel leaf", textures.leaf(25, (0.09, 0.23, 0.05)), roughness=0.4, specular=0.3),
        "bronze": principled("Bronze", (0.30, 0.19, 0.09), roughness=0.4, specular=0.5, metallic=1.0),
    }  # fmt: skip


def build(detail: Detail):
    """The atrium has no parameters."""
    scene = empty_scene(exposure=-0.35)
    look = _materials()
    _ground(detail, look)
    _shell(detail, look)
    _lower_storey(detail, look)
    _upper_storey(detail, look)
    _roof(detail, look)
    _curtains(detail, look)
    _garden(detail, look)
    sun(SUN, 11.0, (1.0, 0.93, 0.82))
    world(clear_sky(-SUN, (0.30, 0.55, 1.15)))
    camera((-9.1, -1.9, 1.7), (9.8, 1.6, 4.1), lens=19.0)
    camera((-6.0, 7.3, 1.75), (9.0, 3.6, 2.4), lens=22.0, name="Aisle camera", active=False)
    camera((-4.9, -6.35, GALLERY + 1.65), (2.5, 5.0, 4.4), lens=20.0, name="Gallery camera", active=False)
    return scene


def _ring(inner: float, outer: float, low: float, high: float, chamfer: float = 0.0) -> Shape:
    """A slab round the court, from `inner` to `outer` metres outside the arcades' centre lines."""
    return prism(rectangle(X + outer, Y + outer), high - low, [rectangle(X + inner, Y + inner)], chamfer).moved(z=low)


def _moulding(profile: list[tuple[float, float]], inward: float, z: float) -> Shape:
    """A profile (out of the wall towards the court, up) swept round the court, its wall `inward` m from the centre lines."""
    corners = np.column_stack([rectangle(X - inward, Y - inward), np.full(4, z)])
    return sweep(np.array(profile)[::-1] * [-1, 1], corners, closed=True)


def _ground(detail: Detail, look: dict[str, Surface]) -> None:
    edge = 0.55  # the step is this far inside the centre lines
    place("Ground", mesh("Ground", prism(rectangle(X + 6, Y + 6), 0.3).moved(z=-0.3 if not detail.full else -0.312), look["mortar"]))
    if detail.full:
        rng = np.random.default_rng(1)
        pitch = 0.7
        columns, rows = int(np.ceil(2 * (X - edge) / pitch)) + 1, int(np.ceil(2 * (Y - edge) / pitch))
        slabs = []
        for row in range(rows):
            for index in range(columns):
                x, y = -X + edge - pitch / 2 + (index + 0.5 * (row % 2)) * pitch, -Y + edge + (row + 0.5) * pitch
                slab = box((pitch - 0.007, pitch - 0.007, 0.06), (x, y, -0.03 + rng.uniform(-0.003, 0)), 0.004)
                shift, tone = rng.uniform(0, 4, 2), rng.integers(3)
                slabs.append(Shape(slab.vertices, slab.corners, slab.sizes, slab.uv + shift, np.full(len(slab.sizes), tone)))
        tones = [(0.52, 0.44, 0.34), (0.46, 0.38, 0.29), (0.57, 0.49, 0.39)]
        surfaces = [
            principled(f"Court slab {i + 1}", textures.stone(30 + i, tone, 0.07), tile=2.8, roughness=0.6, specular=0.2)
            for i, tone in enumerate(tones)
        ]
        place("Court paving", mesh("Court paving", joined(slabs), surfaces))
    else:
        place("Court paving", mesh("Court paving", prism(rectangle(X, Y), 0.02).moved(z=-0.012), look["paving"]))
    step = _ring(-edge, AISLE + 0.1, -0.2, FLOOR - 0.02, detail.chamfer(0.01))
    place("Step", mesh("Step", step, look["stone"]))
    place("Aisle floor", mesh("Aisle floor", _ring(-edge + 0.28, AISLE + 0.2, -0.1, FLOOR), look["chequer"]))


def _shell(detail: Detail, look: dict[str, Surface]) -> None:
    """The outer walls, their dado, pilasters and doors, and the floor between the storeys."""
    place("Outer wall", mesh("Outer wall", _ring(AISLE, AISLE + WALL, -0.25, 10.06), look["ochre"]))
    place("Dado", mesh("Dado", _ring(AISLE - 0.02, AISLE + 0.1, FLOOR - 0.05, FLOOR + 1.15, detail.chamfer(0.008)), look["dado"]))
    place("Skirting", mesh("Skirting", _ring(AISLE - 0.05, AISLE + 0.05, FLOOR - 0.06, FLOOR + 0.16, detail.chamfer(0.012)), look["stone"]))
    place(
        "Dado rail", mesh("Dado rail", _ring(AISLE - 0.05, AISLE + 0.05, FLOOR + 1.14, FLOOR + 1.2, detail.chamfer(0.012)), look["stone"])
    )
    place(
        "Gallery dado",
        mesh("Gallery dado", _ring(AISLE - 0.02, AISLE + 0.1, GALLERY - 0.05, GALLERY + 1.1, detail.chamfer(0.008)), look["dado"]),
    )
    place("Gallery floor", mesh("Gallery floor", _ring(-0.32, AISLE + 0.2, GALLERY - 0.22, GALLERY), look["stone"]))
    place("Aisle ceiling", mesh("Aisle ceiling", _ring(0.0, AISLE + 0.15, GALLERY - 0.25, GALLERY - 0.21), look["boards"]))
    pilaster = mesh("Pilaster", box((0.5, 0.16, 4.3), (0, 0, 2.15), detail.chamfer(0.012)), look["sand"])
    beam = mesh("Beam", box((0.2, AISLE + 0.3, 0.26), (0, -AISLE / 2, 0), detail.chamfer(0.01)), look["wood"])
    door = mesh("Door", panel_door(detail, 1.3, 2.5), look["wood"])
    surround = mesh(
        "Door surround",
        joined(
            [box((0.24, 0.3, 2.75), (s * 0.77, 0, 1.375), detail.chamfer(0.015)) for s in (-1, 1)]
            + [box((1.98, 0.36, 0.3), (0, 0, 2.82), detail.chamfer(0.015))]
        ),
        look["stone"],
    )
    for side in _sides():
        _, _, turn, bays, _ = side
        for bay in range(bays + 1):
            place("Pilaster", pilaster, (*_along(side, bay * BAY, -AISLE), FLOOR), turn)
            place("Beam", beam, (*_along(side, bay * BAY), GALLERY - 0.36), turn)
            if bay < bays:
                place("Beam", beam, (*_along(side, (bay + 0.5) * BAY), GALLERY - 0.36), turn)
        for bay in range(1, bays, 2):
            for floor in (FLOOR, GALLERY):
                spot = _along(side, (bay + 0.5) * BAY, -AISLE + 0.01)
                place("Door", door, (*spot, floor + 0.01), turn + np.pi)
                place("Door surround", surround, (*spot, floor - 0.02), turn)


def _arcade(detail: Detail, name: str, surface: Surface, opening: float, per_bay: int, spring: float, top: float, depth: float) -> None:
    """The four walls over one storey's arches; the shorter two end inside the longer ones."""
    for index, side in enumerate(_sides()):
        _, _, turn, bays, length = side
        short = index % 2
        wall = prism(
            arcade_outline(length, bays * per_bay, opening, top - spring - 0.002 * short, detail.segments(28, 6)),
            depth - 0.004 * short,
            chamfer=detail.chamfer(0.02),
        )
        wall = upright(wall).moved(y=depth / 2 - 0.002 * short)
        place(name, mesh(f"{name} {'short' if short else 'long'}", wall, surface, SMOOTH), (*_along(side, 0), spring + 0.001 * short), turn)


def _archivolts(detail: Detail, name: str, surface: Surface, opening: float, per_bay: int, spring: float, depth: float) -> None:
    """A moulded ring round each arch on the court's face, with a keystone."""
    radius = opening / 2
    path = arc(radius + 0.02, np.pi, 0, 24)
    path = np.column_stack([path[:, 0], np.zeros(len(path)), path[:, 1]])
    profile = np.array(
        [(0.0, -0.05), (0.17, -0.05), (0.17, 0.035), (0.13, 0.05), (0.12, 0.03), (0.05, 0.03), (0.04, 0.05), (0.0, 0.04)]
    ) * (0.6 + 0.3 * opening / 2)
    ring = sweep(profile, path, normal=(0, 1, 0))
    top = np.array([[-0.07, -0.03], [0.07, -0.03], [0.11, 0.3], [-0.11, 0.3]]) * (0.55 + 0.2 * opening)
    keystone = upright(prism(top, 0.2, chamfer=detail.chamfer(0.01))).moved(y=0.1 - 0.03, z=radius)
    data = mesh(name, joined([ring, keystone]), surface, SMOOTH)
    for side in _sides():
        _, _, turn, bays, _ = side
        for bay in range(bays * per_bay):
            place(name, data, (*_along(side, (bay + 0.5) * BAY / per_bay, depth / 2), spring), turn)


def _lower_storey(detail: Detail, look: dict[str, Surface]) -> None:
    shaft = mesh("Column", column(detail, SPRING - FLOOR, 0.235), look["stone"], SMOOTH)
    corner = mesh(
        "Corner pier",
        joined(
            [
                box((0.78, 0.78, SPRING - FLOOR + 0.02), (0, 0, (SPRING - FLOOR) / 2), detail.chamfer(0.03)),
                box((0.9, 0.9, 0.2), (0, 0, 0.1), detail.chamfer(0.02)),
                box((0.88, 0.88, 0.16), (0, 0, SPRING - FLOOR - 0.14), detail.chamfer(0.02)),
            ]
        ),
        look["ashlar"],
    )
    for side in _sides():
        place("Corner pier", corner, (*_along(side, 0), FLOOR - 0.01), side[2])
        for bay in range(1, side[3]):
            place("Column", shaft, (*_along(side, bay * BAY), FLOOR), side[2])
    _arcade(detail, "Arcade", look["ashlar"], 2.14, 1, SPRING - 0.003, GALLERY - 0.16, WALL)
    if detail.full:
        _archivolts(detail, "Archivolt", look["stone"], 2.14, 1, SPRING, WALL)
    course = [(-0.2, 0.0), (0.04, 0.0), (0.06, 0.05), (0.10, 0.07), (0.16, 0.16), (0.18, 0.16), (0.18, 0.24), (-0.2, 0.24)]
    place("String course", mesh("String course", _moulding(course, 0.25, GALLERY - 0.23), look["stone"]))


def _upper_storey(detail: Detail, look: dict[str, Surface]) -> None:
    pedestal = mesh(
        "Pedestal",
        joined(
            [
                box((0.36, 0.36, 1.02), (0, 0, 0.5), detail.chamfer(0.015)),
                box((0.42, 0.42, 0.14), (0, 0, 0.07), detail.chamfer(0.015)),
                box((0.42, 0.42, 0.11), (0, 0, 0.955), detail.chamfer(0.015)),
            ]
        ),
        look["sand"],
    )
    shaft = mesh("Gallery column", column(detail, UPPER_SPRING - RAIL - 0.008, 0.125, 6), look["stone"], SMOOTH)
    corner = mesh(
        "Gallery corner",
        joined(
            [
                box((0.56, 0.56, UPPER_SPRING - GALLERY + 0.03), (0, 0, (UPPER_SPRING - GALLERY) / 2), detail.chamfer(0.025)),
                box((0.64, 0.64, 0.14), (0, 0, UPPER_SPRING - GALLERY - 0.1), detail.chamfer(0.02)),
            ]
        ),
        look["ashlar"],
    )
    filling = baluster(0.74, 0.075) if detail.full else box((1.2, 0.08, 0.74), (0, 0, 0.37))
    turned = mesh("Baluster", filling, look["stone"], SMOOTH)
    half = BAY / 2
    for side in _sides():
        _, _, turn, bays, _ = side
        place("Gallery corner", corner, (*_along(side, 0), GALLERY - 0.01), turn)
        for index in range(2 * bays):
            if index:
                place("Pedestal", pedestal, (*_along(side, index * half), GALLERY), turn)
                place("Gallery column", shaft, (*_along(side, index * half), RAIL + 0.009), turn)
            for step in np.linspace(0.3, half - 0.3, 5) if detail.full else [half / 2]:
                place("Baluster", turned, (*_along(side, index * half + step), GALLERY + 0.13), turn)
    corners = np.column_stack([rectangle(X, Y), np.full(4, GALLERY)])
    for name, low, high, width in (("Plinth", -0.01, 0.135, 0.24), ("Handrail", 0.865, 0.995, 0.27)):
        section = rectangle(width / 2, (high - low) / 2, (0, (high + low) / 2))
        section = np.array([(x * (0.85 if abs(z - low) < 1e-9 and name == "Handrail" else 1), z) for x, z in section])
        place(name, mesh(name, sweep(section, corners, closed=True), look["stone"]))
    _arcade(detail, "Gallery arcade", look["ashlar"], 1.08, 2, UPPER_SPRING - 0.002, EAVES + 0.07, 0.36)
    if detail.full:
        _archivolts(detail, "Gallery archivolt", look["stone"], 1.08, 2, UPPER_SPRING, 0.36)


def _roof(detail: Detail, look: dict[str, Surface]) -> None:
    """The cornice, the rafters, and a lean-to roof that slopes towards the court."""
    cornice = [
        (-0.12, 0.0),
        (0.03, 0.0),
        (0.05, 0.06),
        (0.09, 0.06),
        (0.12, 0.16),
        (0.22, 0.2),
        (0.24, 0.27),
        (0.30, 0.3),
        (0.30, 0.36),
        (-0.12, 0.36),
    ]
    place("Cornice", mesh("Cornice", _moulding(cornice, 0.18, EAVES - 0.42), look["stone"]))
    slope, overhang, reach = 0.27, 0.75, AISLE + 0.9
    low, high = EAVES - 0.2 * slope, EAVES + reach * slope
    corners = np.column_stack([rectangle(X, Y), np.zeros(4)])
    section = np.array(
        [
            (-overhang, low - (overhang - 0.2) * slope),
            (reach, high),
            (reach, high + 0.16),
            (-overhang, low - (overhang - 0.2) * slope + 0.16),
        ]
    )
    place("Roof", mesh("Roof", sweep(section, corners, closed=True), look["boards"]))
    length = 1.03 * (reach + overhang)
    rafter = box((0.11, length - 0.35, 0.15), (0, 0, 0), detail.chamfer(0.008)).turned(-np.arctan(slope), "x")
    rafter = mesh("Rafter", rafter, look["wood"])
    middle = (reach - overhang) / 2 - 0.1
    for side in _sides():
        per_bay = detail.segments(4, 2)
        for i in range(per_bay * side[3]):
            distance = (i + 0.5) * BAY / per_bay
            place("Rafter", rafter, (*_along(side, distance, -middle), EAVES + middle * slope - 0.06), side[2])
    if detail.full:
        dentil = mesh("Dentil", box((0.1, 0.09, 0.1), chamfer=0.006), look["stone"])
        cover = mesh("Eaves tile", _barrel_tile().turned(-np.arctan(slope), "x"), look["terracotta"], SMOOTH)
        for side in _sides():
            _, _, turn, _, length = side
            for i in range(int(length / 0.2)):
                place("Dentil", dentil, (*_along(side, (i + 0.5) * 0.2, 0.255), EAVES - 0.33), turn)
            count = int((length - 2 * overhang) / 0.24)
            for i in range(count):
                distance = overhang + (i + 0.5) * (length - 2 * overhang) / count
                place("Eaves tile", cover, (*_along(side, distance, overhang - 0.32), low - (overhang - 0.52) * slope + 0.17), turn)


def _barrel_tile() -> Shape:
    """A barrel tile, 0.9 m of a course, along y."""
    angle = np.linspace(0, np.pi, 9)
    ring = np.stack([0.1 * np.cos(angle), np.zeros(9), 0.1 * np.sin(angle)], axis=-1)
    points = np.stack([ring + np.array([0, y, 0]) for y in (-0.45, 0.45)])
    centre = points * [0, 1, 0]
    return sheet(points[:, ::-1], thickness=(0.15 * (centre - points))[:, ::-1])


def _curtains(detail: Detail, look: dict[str, Surface]) -> None:
    """Pairs of curtains, drawn aside, on rods in the arches of the long sides; banners over the balustrades."""
    half = 1.17
    height = SPRING - FLOOR - 0.12
    ring = np.array([(0.02 * np.cos(a), 0.02 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, detail.segments(12, 6), endpoint=False)])
    rod = mesh("Curtain rod", sweep(ring, np.array([[-1.2, 0, 0], [1.2, 0, 0]])), look["bronze"], SMOOTH)
    drapes = {}
    for index, colour in enumerate(("red", "green", "blue")):
        shape = curtain(detail, 40 + index, half, height, 2.4, gathered=0.26)
        mirrored = Shape(shape.vertices * [-1, 1, 1], shape.corners, shape.sizes, shape.uv, shape.slots).flipped()
        drapes[colour] = (
            mesh(f"Curtain {colour} left", shape, look[colour], SMOOTH),
            mesh(f"Curtain {colour} right", mirrored, look[colour], SMOOTH),
        )
    order = {0: ("red", None, "blue", None, "green", None, "red"), 2: ("green", None, "red", "blue", None, "red", None)}
    for index, colours in order.items():
        side = _sides()[index]
        for bay, colour in enumerate(colours):
            if colour is None:
                continue
            x, y = _along(side, (bay + 0.5) * BAY, -0.02)
            place("Curtain rod", rod, (x, y, FLOOR + height + 0.03), side[2])
            for data, shift in zip(drapes[colour], (-half + 0.02, half - 0.02)):
                place(data.name, data, (x + shift * np.cos(side[2]), y + shift * np.sin(side[2]), FLOOR + 0.02), side[2])
    for index, bay, colour in ((0, 3.0, "blue"), (2, 2.0, "blue"), (2, 5.0, "red"), (1, 2.0, "red"), (3, 2.0, "green")):
        side = _sides()[index]
        banner = mesh(f"Banner {colour}", _banner(detail), look[colour], SMOOTH)
        place("Banner", banner, (*_along(side, (bay + 0.25) * BAY, 0.0), RAIL), side[2])


def _banner(detail: Detail) -> Shape:
    """A cloth laid over the handrail, that hangs down on the court's side (towards +y)."""
    width, drop = 0.95, 2.1
    line = np.array([(-0.15, -0.55), (-0.155, 0.0), (-0.15, 0.012), (0.15, 0.012), (0.16, 0.0), (0.2, -0.5), (0.47, -1.15), (0.45, -drop)])
    lengths = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    t = np.sort(np.concatenate([lengths, np.linspace(0, lengths[-1], detail.segments(30, 3))[1:-1]]))
    y, z = np.interp(t, lengths, line[:, 0]), np.interp(t, lengths, line[:, 1])
    s = np.linspace(-0.5, 0.5, detail.segments(33, 4))
    wave = np.clip(-z - 0.3, 0, None)[:, None] * 0.03 * np.sin(s * 19 + 0.8)[None]
    points = np.stack([np.broadcast_to(s * width, wave.shape), y[:, None] + wave, np.broadcast_to(z[:, None], wave.shape)], axis=-1)
    uv = np.stack(np.broadcast_arrays((s[None] + 0.5) * 1.3, t[:, None]), axis=-1)
    return sheet(points, uv, thickness=np.array([0, -0.006, -0.006]))


def _garden(detail: Detail, look: dict[str, Surface]) -> None:
    """A stone basin planted with laurel in the middle of the court, and palms in pots along the arcades."""
    octagon = arc(1.0, 0, 2 * np.pi, 8)[:-1]
    rim = joined(
        [
            prism(octagon * 1.5, 0.12, chamfer=detail.chamfer(0.02)),
            prism(octagon * 1.34, 0.44, [octagon * 1.16], detail.chamfer(0.015)).moved(z=0.1),
            prism(octagon * 1.42, 0.09, [octagon * 1.1], detail.chamfer(0.02)).moved(z=0.53),
        ]
    )
    place("Basin", mesh("Basin", rim, look["stone"]))
    place("Basin earth", mesh("Basin earth", lathe(np.array([(1.2, 0.3), (1.2, 0.5), (0.5, 0.56)]), 8), look["earth"]))
    urn = np.array(
        [
            (0.3, 0.5),
            (0.3, 0.62),
            (0.2, 0.66),
            (0.15, 0.8),
            (0.17, 0.95),
            (0.32, 1.02),
            (0.5, 1.15),
            (0.62, 1.36),
            (0.66, 1.4),
            (0.66, 1.44),
            (0.58, 1.44),
            (0.5, 1.3),
            (0.2, 1.24),
        ]
    )
    place("Urn", mesh("Urn", lathe(urn, detail.segments(48, 10)), look["stone"], SMOOTH))
    place("Urn earth", mesh("Urn earth", lathe(np.array([(0.4, 1.2), (0.54, 1.37), (0.1, 1.4)]), 10), look["earth"]))
    laurel = mesh("Open laurel", shrub(detail, 50, 0.36, 0.15), look["leaf"], SMOOTH)
    rng = np.random.default_rng(51)
    for angle in np.arange(8) * np.pi / 4 + 0.39:
        place("Laurel", laurel, (0.78 * np.cos(angle), 0.78 * np.sin(angle), 0.74), rng.uniform(0, 6.28), rng.uniform(0.85, 1.05))
    place("Urn laurel", laurel, (0, 0, 1.72), 1.0, 1.25)
    vessel = mesh("Pot", pot(detail, 0.55, 0.33), [look["terracotta"], look["earth"]], SMOOTH)
    fronds = [mesh(f"Open palm {i + 1}", palm(detail, 60 + i, 1.5), look["palm"], SMOOTH) for i in range(2)]
    spots = [(x, Y - 1.0) for x in (-7.0, -4.2, 1.4, 7.0)] + [(x, 1.0 - Y) for x in (-1.4, 1.4, 7.0)] + [(X - 1.0, y) for y in (-2.8, 2.8)]
    for index, (x, y) in enumerate(spots):
        place("Pot", vessel, (x, y, 0.001), rng.uniform(0, 6.28))
        place("Palm", fronds[index % 2], (x, y, 0.5), rng.uniform(0, 6.28), rng.uniform(0.9, 1.15))
