"""A museum of three halls in a row, lit by 200 small lamps: many lights, each of which matters in one place only.

x runs through the halls, y across them.  108 spots light 36 pictures, 48 light 12 sculptures; 24 globes hang over the
benches and 20 lamps shine along the cornice.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from . import textures
from .furnishings import SMOOTH, palm, pot, rectangle, upright
from .furniture import picture, vase
from .materials import Surface, principled
from .primitives import Shape, arc, box, joined, lathe, mesh, place, prism, sheet, sphere, sweep
from .stage import Detail, camera, empty_scene, point, spot, world

HALL, HALLS = 9.0, 3
LENGTH, HALF_WIDTH, HEIGHT = HALL * HALLS, 5.0, 5.2
OUTER, PARTITION = 0.4, 0.5
OPENING, OPENING_HEIGHT = 3.0, 3.7
TRACK = 1.5  # distance of the lamps' rails from the walls
RAIL_Z = 4.55
EYE = 1.68  # middle of the pictures
WARM, WHITE = (1.0, 0.80, 0.58), (1.0, 0.92, 0.82)


def _materials() -> dict[str, Surface]:
    return {
        "red": principled("Pompeian red", textures.plaster(301, (0.42, 0.085, 0.06), 0.04), tile=3.0, roughness=0.8, specular=0.1),
        "green": principled("Sage green", textures.plaster(302, (0.22, 0.34, 0.24), 0.04), tile=3.0, roughness=0.8, specular=0.1),
        "blue": principled("Slate blue", textures.plaster(303, (0.16, 0.23, 0.36), 0.04), tile=3.0, roughness=0.8, specular=0.1),
        "white": principled("Stucco", (0.76, 0.74, 0.69), roughness=0.7, specular=0.15),
        "ceiling": principled("Ceiling", textures.plaster(304, (0.74, 0.72, 0.67), 0.02), tile=3.0, roughness=0.9, specular=0.05),
        "parquet": principled("Oak parquet", textures.wood(305, (0.36, 0.21, 0.11), 8), tile=1.2, roughness=0.28, specular=0.45),
        "panel": principled("Walnut panelling", textures.wood(306, (0.15, 0.08, 0.045)), tile=1.5, roughness=0.45, specular=0.3),
        "marble": principled("Marble", textures.marble(307, (0.70, 0.68, 0.64), (0.35, 0.32, 0.30)), tile=1.5, roughness=0.25, specular=0.4),
        "plinth": principled("Plinth", (0.66, 0.64, 0.60), roughness=0.6, specular=0.2),
        "gilt": principled("Gilt", (0.78, 0.54, 0.20), roughness=0.35, specular=0.5, metallic=1.0),
        "black": principled("Blackened steel", (0.03, 0.03, 0.032), roughness=0.5, specular=0.3),
        "bronze": principled("Bronze", (0.32, 0.19, 0.09), roughness=0.35, specular=0.5, metallic=1.0),
        "terracotta": principled("Terracotta", (0.50, 0.22, 0.13), roughness=0.7, specular=0.2),
        "glaze": principled("Blue glaze", (0.05, 0.13, 0.33), roughness=0.15, specular=0.5),
        "leather": principled("Leather", (0.20, 0.08, 0.04), roughness=0.45, specular=0.35),
        "earth": principled("Earth", (0.06, 0.04, 0.03), roughness=0.9, specular=0.0),
        "frond": principled("Palm frond", textures.frond(308, (0.10, 0.26, 0.05)), roughness=0.5, specular=0.2),
    }  # fmt: skip


def build(detail: Detail):
    """The gallery has no parameters."""
    scene = empty_scene(exposure=1.5)
    look = _materials()
    _structure(detail, look)
    _ceiling(detail, look)
    hung = _pictures(detail, look)
    stood = _sculptures(detail, look)
    _lamps(detail, look, hung, stood)
    world((0.0, 0.0, 0.0))
    camera((0.5, -0.1, 1.65), (LENGTH, 1.0, 2.9), lens=20.0)
    camera((11.0, 3.9, 1.65), (17.0, -2.0, 1.9), lens=20.0, name="Green hall camera", active=False)
    return scene


def _structure(detail: Detail, look: dict[str, Surface]) -> None:
    middle = (LENGTH / 2, 0.0)
    slab = rectangle(LENGTH / 2 + OUTER - 0.02, HALF_WIDTH + OUTER - 0.02, middle)
    place("Floor", mesh("Floor", prism(slab, 0.3).moved(z=-0.3), look["parquet"]))
    place("Ceiling", mesh("Ceiling", prism(slab, 0.3).moved(z=HEIGHT), look["ceiling"]))
    shell = prism(rectangle(LENGTH / 2 + OUTER, HALF_WIDTH + OUTER, middle), HEIGHT + 0.4, [rectangle(LENGTH / 2, HALF_WIDTH, middle)])
    place("Outer wall", mesh("Outer wall", shell.moved(z=-0.2), look["white"]))
    outline = [
        (-HALF_WIDTH - 0.2, -0.15),
        (-OPENING / 2, -0.15),
        (-OPENING / 2, OPENING_HEIGHT),
        (OPENING / 2, OPENING_HEIGHT),
        (OPENING / 2, -0.15),
    ]
    outline += [(HALF_WIDTH + 0.2, -0.15), (HALF_WIDTH + 0.2, HEIGHT + 0.15), (-HALF_WIDTH - 0.2, HEIGHT + 0.15)]
    wall = mesh("Partition", upright(prism(np.array(outline), PARTITION)).moved(y=PARTITION / 2), look["white"])
    surround = mesh("Opening surround", _portal(detail), look["marble"])
    for hall in range(1, HALLS):
        place("Partition", wall, (hall * HALL, 0, 0), np.pi / 2)
        place("Opening surround", surround, (hall * HALL, 0, 0), np.pi / 2)
    for hall, colour in enumerate(("red", "green", "blue")):
        _lining(detail, look, hall, look[colour])


def _portal(detail: Detail) -> Shape:
    """Marble jambs and lintel that line an opening and stand proud of the wall on both sides."""
    edge, depth = detail.chamfer(0.02), PARTITION + 0.14
    jambs = [box((0.3, depth, OPENING_HEIGHT + 0.1), (s * (OPENING / 2 + 0.08), 0, OPENING_HEIGHT / 2 - 0.02), edge) for s in (-1, 1)]
    lintel = box((OPENING + 0.7, depth + 0.06, 0.34), (0, 0, OPENING_HEIGHT + 0.1), edge)
    cap = box((OPENING + 0.86, depth + 0.2, 0.08), (0, 0, OPENING_HEIGHT + 0.3), detail.chamfer(0.03))
    return joined([*jambs, lintel, cap])


def _walls(hall: int) -> list[tuple[tuple[float, float], float, float, bool]]:
    """The walls of a hall: the middle of each (x, y), its turn (its front then looks along -y turned), its length, and
    whether it has an opening."""
    low = hall * HALL + (PARTITION / 2 if hall else 0.0)
    high = (hall + 1) * HALL - (PARTITION / 2 if hall < HALLS - 1 else 0.0)
    middle = (low + high) / 2
    return [
        ((middle, HALF_WIDTH), 0.0, high - low, False),
        ((middle, -HALF_WIDTH), np.pi, high - low, False),
        ((low, 0.0), np.pi / 2, 2 * HALF_WIDTH, hall > 0),
        ((high, 0.0), -np.pi / 2, 2 * HALF_WIDTH, hall < HALLS - 1),
    ]


def _lining(detail: Detail, look: dict[str, Surface], hall: int, paint: Surface) -> None:
    """Each wall's painted field, skirting, panelling and cornice, built along x with the room towards -y."""
    for (x, y), turn, length, opening in _walls(hall):
        half = length / 2
        spans = [(-half, -OPENING / 2 - 0.15), (OPENING / 2 + 0.15, half)] if opening else [(-half, half)]
        field, trim = [], []
        for low, high in spans:
            centre, width = (low + high) / 2, high - low + 0.006
            field.append(box((width, 0.06, HEIGHT + 0.1), (centre, 0.02, HEIGHT / 2)))
            trim.append(box((width, 0.12, 0.86), (centre, 0.025, 0.41), detail.chamfer(0.004)))
            trim.append(box((width, 0.18, 0.07), (centre, 0.03, 0.86), detail.chamfer(0.015)))
            trim.append(box((width, 0.17, 0.2), (centre, 0.03, 0.09), detail.chamfer(0.015)))
        if opening:
            field.append(box((OPENING + 0.3, 0.061, HEIGHT - OPENING_HEIGHT), (0, 0.02, (HEIGHT + OPENING_HEIGHT) / 2 + 0.2)))
        place("Wall field", mesh("Wall field", joined(field), paint), (x, y, 0), turn)
        place("Panelling", mesh("Panelling", joined(trim), look["panel"]), (x, y, 0), turn)
        section = np.array([(0.06, 0.0), (-0.06, 0.0), (-0.1, 0.05), (-0.1, 0.12), (-0.2, 0.2), (-0.26, 0.2), (-0.26, 0.26), (0.06, 0.26)])[
            ::-1
        ]
        path = np.array([[half + 0.003, 0, 0], [-half - 0.003, 0, 0]])
        cornice = sweep(section, path).moved(z=HEIGHT - 0.55)
        place("Cornice", mesh("Cornice", cornice, look["white"]), (x, y, 0), turn)


def _ceiling(detail: Detail, look: dict[str, Surface]) -> None:
    """Coffers between beams."""
    beams = []
    for hall in range(HALLS):
        for i in range(1, 4):
            beams.append(box((0.26, 2 * HALF_WIDTH + 0.1, 0.26), (hall * HALL + i * HALL / 4, 0, HEIGHT - 0.12), detail.chamfer(0.02)))
    for y in (-2.4, 0.0, 2.4):
        beams.append(box((LENGTH + 0.1, 0.26, 0.24), (LENGTH / 2, y, HEIGHT - 0.11), detail.chamfer(0.02)))
    place("Beams", mesh("Beams", joined(beams), look["white"]))


def _spots_of(wall: tuple[tuple[float, float], float, float, bool], offset: float, out: float, height: float) -> tuple[float, float, float]:
    """A point by a wall: `offset` m along it from its middle, `out` m into the room."""
    (x, y), turn, _, _ = wall
    return x + offset * np.cos(turn) + out * np.sin(turn), y + offset * np.sin(turn) - out * np.cos(turn), height


def _pictures(detail: Detail, look: dict[str, Surface]) -> list[tuple[tuple, float, float]]:
    """Hang 36 pictures; returns (wall, offset along it, width) of each."""
    rng = np.random.default_rng(310)
    hung = []
    canvases = [principled(f"Painting {i + 1}", textures.painting(320 + 10 * i), roughness=0.45, specular=0.25) for i in range(12)]
    for hall in range(HALLS):
        for wall in _walls(hall):
            _, turn, length, opening = wall
            if opening:
                offsets, widest = (-3.35, 3.35), 1.7
            elif length > 2 * HALF_WIDTH - 0.01:
                offsets, widest = (-2.3, 2.3), 2.4
            else:
                offsets, widest = np.array([-1.5, -0.5, 0.5, 1.5]) * length / 4.1, 1.5
            for offset in offsets:
                width = widest * rng.uniform(0.62, 1.0)
                height = np.clip(width * rng.uniform(0.68, 1.3), 0.8, 1.9)
                shape = picture(detail, width, height, 0.11)
                canvas = canvases[len(hung) % len(canvases)]
                data = mesh("Picture", shape, [look["gilt" if rng.uniform() < 0.7 else "panel"], canvas])
                place("Picture", data, _spots_of(wall, offset, 0.028, EYE + 0.25), turn)
                hung.append((wall, float(offset), float(width)))
    return hung


def _works(detail: Detail) -> Iterator[tuple[str, Shape, str]]:
    """Six sculptures, about a metre high, each standing on z = 0: name, shape, material."""
    yield "Amphora", vase(detail, 0.85, 0.27), "terracotta"
    steps, sides = detail.segments(48, 10), detail.segments(6, 1)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float) * 0.16
    ring = np.concatenate([np.linspace(corners[i], corners[(i + 1) % 4], sides, endpoint=False) for i in range(4)])
    height = np.linspace(0, 1.0, steps)
    turn = height * 2.2
    rows = [
        np.column_stack([*(ring @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])).T * (1 - 0.35 * z), np.full(len(ring), z)])
        for a, z in zip(turn, height)
    ]
    yield "Twist", loft(np.array(rows)), "bronze"
    circle = arc(0.36, 0, 2 * np.pi, detail.segments(48, 12))[:-1]
    path = np.column_stack([circle[:, 0], np.zeros(len(circle)), circle[:, 1] + 0.5])
    tube = arc(0.085, 0, 2 * np.pi, detail.segments(20, 6))[:-1]
    foot = box((0.3, 0.3, 0.09), (0, 0, 0.045), detail.chamfer(0.01))
    yield "Ring", joined([sweep(tube, path[::-1], normal=(0, 1, 0), closed=True), foot]), "bronze"
    balls = [sphere(r, detail.segments(36, 10), detail.segments(18, 6)).moved(z=z) for r, z in ((0.26, 0.25), (0.2, 0.66), (0.14, 0.97))]
    yield "Cairn", joined(balls), "marble"
    yield "Jar", vase(detail, 0.6, 0.24), "glaze"
    head = sphere(1.0, detail.segments(36, 10), detail.segments(20, 6)).scaled(0.15, 0.19, 0.23).moved(0, -0.02, 0.72)
    bust = lathe(
        np.array(
            [
                (0.15, 0.0),
                (0.16, 0.05),
                (0.1, 0.1),
                (0.12, 0.16),
                (0.26, 0.3),
                (0.27, 0.38),
                (0.2, 0.46),
                (0.08, 0.5),
                (0.075, 0.62),
                (0.03, 0.64),
            ]
        ),
        detail.segments(32, 8),
    ).scaled(1.1, 0.75, 1)
    yield "Head", joined([bust, head]), "marble"


def loft(rings: np.ndarray) -> Shape:
    """Consecutive closed rings (R, N, 3), counter-clockwise seen from above and rising, joined by quads and capped."""
    closed = np.concatenate([rings, rings[:, :1]], axis=1)
    skin = sheet(closed)
    count = rings.shape[1]
    remap = (np.arange(closed.shape[0])[:, None] * count + np.arange(count + 1)[None] % count).ravel()
    caps = [np.arange(count)[::-1], (len(rings) - 1) * count + np.arange(count)]
    vertices = rings.reshape(-1, 3)
    return Shape(
        vertices,
        np.concatenate([remap[skin.corners], *caps]),
        np.concatenate([skin.sizes, [count, count]]),
        np.concatenate([skin.uv, vertices[np.concatenate(caps), :2]]),
        np.zeros(len(skin.sizes) + 2, int),
    )


def _sculptures(detail: Detail, look: dict[str, Surface]) -> list[tuple[float, float]]:
    """Twelve sculptures on plinths, benches and palms; returns where the plinths stand."""
    works = [(mesh(name, shape, look[key], SMOOTH)) for name, shape, key in _works(detail)]
    plinth = mesh(
        "Plinth",
        joined([box((0.62, 0.62, 0.94), (0, 0, 0.47), detail.chamfer(0.008)), box((0.7, 0.7, 0.08), (0, 0, 0.04), detail.chamfer(0.01))]),
        look["plinth"],
    )
    legs = [box((0.07, 0.4, 0.36), (s * 0.75, 0, 0.18), detail.chamfer(0.005)) for s in (-1, 1)]
    bench = mesh(
        "Bench", joined([*legs, box((1.9, 0.55, 0.12), (0, 0, 0.41), detail.chamfer(0.03)).slotted(1)]), [look["black"], look["leather"]]
    )
    stood = []
    for hall in range(HALLS):
        for index, (dx, y) in enumerate(((2.2, -1.9), (2.2, 1.9), (6.8, 1.9), (6.8, -1.9))):
            x = hall * HALL + dx
            place("Plinth", plinth, (x, y, 0))
            work = works[(4 * hall + index) % len(works)]
            place(work.name, work, (x, y, 0.941), 0.6 * index + 0.3)
            stood.append((x, y))
        place("Bench", bench, ((hall + 0.5) * HALL, 0, 0), np.pi / 2 if hall == 1 else 0.0)
    vessel = mesh("Pot", pot(detail, 0.5, 0.3), [look["terracotta"], look["earth"]], SMOOTH)
    fronds = mesh("Open palm", palm(detail, 311, 1.3), look["frond"], SMOOTH)
    for x, y in ((LENGTH - 0.7, 4.3), (LENGTH - 0.7, -4.3), (HALL - 0.9, 4.3), (HALL + 0.9, -4.3)):
        place("Pot", vessel, (x, y, 0.001))
        place("Palm", fronds, (x, y, 0.46), x)
    return stood


def _lamps(detail: Detail, look: dict[str, Surface], hung: list[tuple[tuple, float, float]], stood: list[tuple[float, float]]) -> None:
    """The 200 lamps with what carries them."""
    housing = np.array([(0.03, 0.0), (0.045, 0.01), (0.045, 0.15), (0.02, 0.16)])
    housing = mesh("Spot housing", lathe(housing, detail.segments(16, 5)), look["black"], SMOOTH)
    for wall, offset, width in hung:
        target = np.array(_spots_of(wall, offset, 0.0, EYE + 0.2))
        for share, aside in ((0.0, 0.0), (0.28, 0.35), (-0.28, -0.35)):
            source = np.array(_spots_of(wall, offset + aside, TRACK, RAIL_Z))
            aim = np.array(_spots_of(wall, offset + share * width, 0.0, target[2]))
            _spot(housing, "Picture spot", source, aim, 70.0, np.radians(34), WHITE)
    for x, y in stood:
        for dx, dy in ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)):
            _spot(housing, "Sculpture spot", np.array([x + dx, y + dy, RAIL_Z]), np.array([x, y, 1.35]), 32.0, np.radians(26), WARM)
    rails = []
    for hall in range(HALLS):
        for wall in _walls(hall):
            span = wall[2] - 2 * TRACK + 0.5
            (x, y, _), horizontal = _spots_of(wall, 0, TRACK, 0), abs(np.cos(wall[1])) > 0.5
            rails.append(box((span, 0.05, 0.05) if horizontal else (0.05, span, 0.05), (x, y, RAIL_Z + 0.2 + (0 if horizontal else 0.003))))
            for end in (-0.45, 0.45):
                rails.append(
                    box(
                        (0.02, 0.02, HEIGHT - RAIL_Z - 0.15),
                        (x + end * span * horizontal, y + end * span * (not horizontal), (HEIGHT + RAIL_Z) / 2 + 0.1),
                    )
                )
    place("Rails", mesh("Rails", joined(rails), look["black"]))
    cord = np.array([(0.06, 0.0), (0.06, 0.02), (0.008, 0.04), (0.008, HEIGHT - 3.3 - 0.3), (0.05, HEIGHT - 3.3 - 0.28)])
    cord = mesh("Cord", lathe(cord, detail.segments(12, 5)), look["gilt"], SMOOTH)
    for hall in range(HALLS):
        for i in range(4):
            for y in (-0.55, 0.55):
                x = hall * HALL + HALL * (0.5 + 0.14 * (i - 1.5))
                place("Cord", cord, (x, y, 3.3 + 0.06))
                point("Globe", (x, y, 3.27), 9.0, WARM, 0.06)
    for x in np.linspace(0.9, LENGTH - 0.9, 10):
        for y in (-1, 1):
            point("Cornice lamp", (x, y * (HALF_WIDTH - 0.2), HEIGHT - 0.22), 7.0, WARM, 0.03)


def _spot(housing, name: str, source: np.ndarray, aim: np.ndarray, watts: float, cone: float, colour: tuple[float, float, float]) -> None:
    """A spot lamp just in front of its housing, both pointed at `aim`."""
    from mathutils import Vector

    direction = (aim - source) / np.linalg.norm(aim - source)
    carrier = place("Spot housing", housing, source - 0.02 * direction)
    carrier.rotation_euler = Vector(-direction).to_track_quat("Z", "Y").to_euler()
    spot(name, source, direction, watts, cone, colour, blend=0.6, radius=0.02)
