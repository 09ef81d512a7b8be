"""A corridor whose own lamps are off: all its light comes from three of the six rooms, through doors ajar.

What a point of the corridor sees of the light is a sliver between door leaf and jamb: hard for every method that
guesses visibility.  x runs along the corridor, which is 18 m long and 2 m wide; rooms lie on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import textures
from .furnishings import SMOOTH, frame, palm, panel_door, pot, rectangle, upright
from .furniture import bed, bookcase, chair, floor_lamp, lampshade, picture, table, vase
from .materials import Surface, principled
from .primitives import box, joined, mesh, place, prism, sphere
from .stage import Detail, area, camera, empty_scene, point, world

LENGTH, HALF_WIDTH, HEIGHT = 18.0, 1.0, 2.75
WALL, OUTER, DEPTH = 0.16, 0.3, 4.0  # thickness of inner and outer walls, depth of the rooms
DOOR_WIDTH, DOOR_HEIGHT = 0.92, 2.1
WARM, NEUTRAL, COOL = (1.0, 0.72, 0.45), (1.0, 0.9, 0.78), (0.82, 0.91, 1.0)


@dataclass(frozen=True)
class Room:
    """side: +1 (left of the camera) or -1.  door: x of the opening's middle.  ajar: opening angle (rad).
    hinge: -1 hinges the leaf on the jamb nearer to the camera, +1 on the farther one."""

    side: int
    start: float
    end: float
    door: float
    ajar: float
    hinge: int
    purpose: str


ROOMS = (
    Room(1, 0.0, 6.0, 3.1, np.radians(84), 1, "study"),
    Room(1, 6.0, 12.0, 8.2, np.radians(28), -1, "dark bedroom"),
    Room(1, 12.0, 18.0, 13.6, np.radians(80), 1, "salon"),
    Room(-1, 0.0, 6.0, 4.6, np.radians(35), -1, "dark bedroom"),
    Room(-1, 6.0, 12.0, 9.8, np.radians(78), 1, "office"),
    Room(-1, 12.0, 18.0, 15.9, np.radians(40), -1, "dark study"),
)


def _materials() -> dict[str, Surface]:
    return {
        "wall": principled("Plaster", textures.plaster(101, (0.76, 0.72, 0.64)), tile=3.0, roughness=0.85, specular=0.1),
        "ceiling": principled("Ceiling", (0.78, 0.77, 0.74), roughness=0.9, specular=0.05),
        "blue": principled("Blue wall", textures.plaster(102, (0.20, 0.32, 0.42)), tile=3.0, roughness=0.85, specular=0.1),
        "parquet": principled("Parquet", textures.wood(103, (0.33, 0.19, 0.10), 8), tile=1.2, roughness=0.4, specular=0.35),
        "white": principled("White lacquer", (0.74, 0.73, 0.70), roughness=0.35, specular=0.4),
        "oak": principled("Oak", textures.wood(104, (0.30, 0.18, 0.095)), tile=1.4, roughness=0.5, specular=0.3),
        "walnut": principled("Walnut", textures.wood(105, (0.13, 0.07, 0.04)), tile=1.4, roughness=0.45, specular=0.35),
        "runner": principled("Runner", textures.fabric(106, (0.34, 0.05, 0.045), (0.55, 0.40, 0.16)), tile=1.1, roughness=0.95, specular=0.0),
        "brass": principled("Brass", (0.72, 0.50, 0.22), roughness=0.3, specular=0.5, metallic=1.0),
        "shade": principled("Linen shade", textures.fabric(107, (0.72, 0.64, 0.50)), tile=0.5, roughness=0.9, specular=0.0),
        "blanket": principled("Blanket", textures.fabric(108, (0.15, 0.24, 0.33)), tile=0.6, roughness=0.95, specular=0.0),
        "linen": principled("Linen", textures.fabric(109, (0.75, 0.73, 0.68)), tile=0.4, roughness=0.9, specular=0.0),
        "leather": principled("Leather", (0.22, 0.07, 0.04), roughness=0.5, specular=0.35),
        "celadon": principled("Celadon", (0.35, 0.50, 0.42), roughness=0.2, specular=0.5),
        "terracotta": principled("Terracotta", (0.48, 0.21, 0.12), roughness=0.8, specular=0.1),
        "earth": principled("Earth", (0.06, 0.04, 0.03), roughness=0.9, specular=0.0),
        "frond": principled("Palm frond", textures.frond(110, (0.10, 0.26, 0.05)), roughness=0.5, specular=0.2),
        "red book": principled("Red books", (0.36, 0.05, 0.04), roughness=0.6, specular=0.2),
        "green book": principled("Green books", (0.07, 0.20, 0.10), roughness=0.6, specular=0.2),
        "tan book": principled("Tan books", (0.50, 0.36, 0.20), roughness=0.6, specular=0.2),
        "blue book": principled("Blue books", (0.06, 0.12, 0.28), roughness=0.6, specular=0.2),
    }  # fmt: skip


def build(detail: Detail):
    """The corridor has no parameters."""
    scene = empty_scene(exposure=2.5)
    look = _materials()
    _structure(detail, look)
    for room in ROOMS:
        _doorway(detail, look, room)
        _furnish(detail, look, room)
    _corridor(detail, look)
    world((0.0, 0.0, 0.0))
    camera((0.35, -0.35, 1.6), (18.0, 0.1, 1.35), lens=23.0)
    return scene


def _structure(detail: Detail, look: dict[str, Surface]) -> None:
    """Slabs and walls.  All walls end inside the slabs, each at its own height, so that no two faces coincide."""
    reach = HALF_WIDTH + WALL + DEPTH
    middle = (LENGTH / 2, 0.0)
    slab = rectangle(LENGTH / 2 + OUTER - 0.02, reach + OUTER - 0.02, middle)
    place("Floor", mesh("Floor", prism(slab, 0.25).moved(z=-0.25), look["parquet"]))
    place("Ceiling", mesh("Ceiling", prism(slab, 0.25).moved(z=HEIGHT), look["ceiling"]))
    shell = prism(rectangle(LENGTH / 2 + OUTER, reach + OUTER, middle), HEIGHT + 0.3, [rectangle(LENGTH / 2, reach, middle)])
    place("Outer wall", mesh("Outer wall", shell.moved(z=-0.15), look["wall"]))
    for side in (-1, 1):
        rooms = [room for room in ROOMS if room.side == side]
        outline = [(-0.1, -0.1)]
        for room in rooms:
            low, high = room.door - DOOR_WIDTH / 2, room.door + DOOR_WIDTH / 2
            outline += [(low, -0.1), (low, DOOR_HEIGHT), (high, DOOR_HEIGHT), (high, -0.1)]
        outline += [(LENGTH + 0.1, -0.1), (LENGTH + 0.1, HEIGHT + 0.1), (-0.1, HEIGHT + 0.1)]
        wall = upright(prism(np.array(outline), WALL)).moved(y=side * (HALF_WIDTH + WALL / 2) + WALL / 2)
        place("Corridor wall", mesh("Corridor wall", wall, look["wall"]))
        for x in (6.0, 12.0):
            partition = box((WALL, DEPTH + 0.15, HEIGHT + 0.16), (x, side * (reach - DEPTH / 2), HEIGHT / 2))
            place("Partition", mesh("Partition", partition, look["blue"]))
        _skirting(detail, look, side, rooms)


def _skirting(detail: Detail, look: dict[str, Surface], side: int, rooms: list[Room]) -> None:
    """Boards along the corridor's walls, between the doors; a picture rail above them."""
    ends = [0.0] + [room.door + s * (DOOR_WIDTH / 2 + 0.09) for room in rooms for s in (-1, 1)] + [LENGTH]
    y = side * (HALF_WIDTH - 0.004)
    boards = [
        box((high - low + 0.02, 0.025, 0.17), ((low + high) / 2, y, 0.08), detail.chamfer(0.005))
        for low, high in zip(ends[::2], ends[1::2])
    ]
    boards.append(box((LENGTH + 0.02, 0.03, 0.05), (LENGTH / 2, y, 2.36), detail.chamfer(0.008)))
    place("Skirting", mesh("Skirting", joined(boards), look["white"]))


def _doorway(detail: Detail, look: dict[str, Surface], room: Room) -> None:
    """Lining, architraves and the leaf, which opens into the room."""
    y = room.side * (HALF_WIDTH + WALL / 2)
    lining = frame(DOOR_WIDTH - 0.05, DOOR_HEIGHT - 0.025, 0.035, WALL + 0.02)  # its sill lies in the floor
    low = room.door - DOOR_WIDTH / 2
    place("Door lining", mesh("Door lining", lining.moved(low + 0.025, 0, -0.01), look["white"]), (0, y, 0))
    for face in (-1, 1):
        edge = detail.chamfer(0.006)
        bars = [box((0.09, 0.03, DOOR_HEIGHT + 0.1), (s * (DOOR_WIDTH / 2 + 0.04), 0, DOOR_HEIGHT / 2 + 0.03), edge) for s in (-1, 1)]
        bars.append(box((DOOR_WIDTH + 0.22, 0.034, 0.1), (0, 0, DOOR_HEIGHT + 0.06), edge))
        place("Architrave", mesh("Architrave", joined(bars), look["white"]), (room.door, y + face * (WALL / 2 + 0.005), 0))
    width = DOOR_WIDTH - 0.066
    leaf = joined(
        [
            panel_door(detail, width, DOOR_HEIGHT - 0.06).moved(x=width / 2),
            *[
                sphere(0.03, detail.segments(20, 6), detail.segments(10, 4)).moved(width - 0.07, s * 0.075, 1.02).slotted(1)
                for s in (-1, 1)
            ],
            *[box((0.03, 0.05, 0.03), (width - 0.07, s * 0.05, 1.02), 0).slotted(1) for s in (-1, 1)],
        ]
    )
    hinge = room.door + room.hinge * (DOOR_WIDTH / 2 - 0.033)
    closed = 0.0 if room.hinge < 0 else np.pi
    turn = closed + room.ajar * room.side * -room.hinge
    place("Door", mesh("Door", leaf, [look["white"], look["brass"]], SMOOTH), (hinge, y + room.side * (WALL / 2 + 0.04), 0.012), turn)


def _corridor(detail: Detail, look: dict[str, Surface]) -> None:
    """What stands and hangs in the corridor itself."""
    runner = box((LENGTH - 1.2, 1.1, 0.012), (LENGTH / 2, 0, 0.005))
    place("Runner", mesh("Runner", replace(runner, uv=runner.uv[:, ::-1] + np.array([0.55, 0.0])), look["runner"]))
    place("Console", mesh("Console", table(detail, 1.1, 0.34, 0.82), look["walnut"]), (6.1, 0.8, 0))
    place("Vase", mesh("Vase", vase(detail, 0.34, 0.11), look["celadon"], SMOOTH), (5.9, 0.8, 0.82))
    for index, (x, side, width, height) in enumerate(
        ((6.1, 1, 0.8, 0.6), (2.2, -1, 0.6, 0.75), (7.2, -1, 1.1, 0.75), (11.0, 1, 0.7, 0.9), (12.6, -1, 0.9, 0.65), (16.2, 1, 0.6, 0.8))
    ):
        canvas = principled(f"Painting {index + 1}", textures.painting(120 + 10 * index), roughness=0.5, specular=0.2)
        shape = picture(detail, width, height, 0.05)
        place(
            "Picture", mesh("Picture", shape, [look["walnut"], canvas]), (x, side * (HALF_WIDTH - 0.018), 1.62), 0.0 if side > 0 else np.pi
        )
    end = principled("End painting", textures.painting(190), roughness=0.5, specular=0.2)
    place("Picture", mesh("End picture", picture(detail, 1.0, 1.2, 0.07), [look["brass"], end]), (LENGTH - 0.018, 0, 1.6), -np.pi / 2)
    vessel = mesh("Pot", pot(detail, 0.42, 0.24), [look["terracotta"], look["earth"]], SMOOTH)
    place("Pot", vessel, (17.5, -0.6, 0.001))
    place("Palm", mesh("Open palm", palm(detail, 111, 0.95, 14), look["frond"], SMOOTH), (17.5, -0.6, 0.38))
    pendant = mesh(
        "Pendant",
        joined([lampshade(detail, 0.16, 0.1, 0.16), floor_lamp(detail, 0.45).scaled(0.5, 0.5, 1.0).turned(np.pi, "x").moved(z=0.57)]),
        look["brass"],
        SMOOTH,
    )
    for x in (4.0, 10.0, 16.0):  # its lamps, switched off
        place("Pendant", pendant, (x, 0, HEIGHT - 0.572))


def _furnish(detail: Detail, look: dict[str, Surface], room: Room) -> None:
    """Furniture by the room's purpose, and a lamp unless it is dark.  Positions: metres from the room's near corner."""
    wall = room.side * (HALF_WIDTH + WALL)
    outwards = 0.0 if room.side > 0 else np.pi

    def at(x: float, depth: float, z: float = 0.0) -> tuple[float, float, float]:
        return room.start + x, wall + room.side * depth, z

    books = [look[key] for key in ("oak", "red book", "green book", "tan book", "blue book")]
    if room.purpose.endswith("study"):
        for index, x in enumerate((1.3, 2.75, 4.2)):
            shelf = mesh("Bookcase", bookcase(detail, 140 + index, 1.4, 2.1, 6, 4), books)
            place("Bookcase", shelf, at(x, DEPTH - 0.19, 0.001), outwards)
        place("Desk", mesh("Desk", table(detail, 1.5, 0.75, 0.75), look["walnut"]), at(3.0, 2.2, 0.0))
        place("Chair", mesh("Chair", chair(detail), [look["walnut"], look["leather"]]), at(3.0, 2.85), outwards)
    elif room.purpose.endswith("bedroom"):
        place("Bed", mesh("Bed", bed(detail), [look["oak"], look["blanket"], look["linen"]]), at(3.6, DEPTH - 1.1, 0.001), outwards)
        place("Night table", mesh("Night table", table(detail, 0.45, 0.4, 0.5), look["oak"]), at(2.8, DEPTH - 0.25), outwards)
    else:
        place("Table", mesh("Table", table(detail, 1.8, 0.9, 0.74), look["oak"]), at(3.0, 2.1, 0.0))
        seat = mesh("Chair", chair(detail), [look["oak"], look["blanket"]])
        for x in (2.45, 3.5):
            place("Chair", seat, at(x, 2.8), outwards)
            place("Chair", seat, at(x, 1.35), outwards + np.pi)
        place("Vase", mesh("Vase", vase(detail, 0.28, 0.1), look["celadon"], SMOOTH), at(3.1, 2.1, 0.74))
    if room.purpose == "study":
        _standard_lamp(detail, look, at(1.9, 2.2))
        place("Desk lamp", mesh("Desk lamp", floor_lamp(detail, 0.36).scaled(0.6, 0.6, 1), look["brass"], SMOOTH), at(3.5, 2.3, 0.75))
        place("Desk shade", mesh("Desk shade", lampshade(detail, 0.14, 0.09, 0.14), look["shade"], SMOOTH), at(3.5, 2.3, 1.06))
        point("Desk lamp", at(3.5, 2.3, 1.13), 40.0, WARM, 0.03)
    elif room.purpose == "office":
        panel = at(3.0, 2.0, HEIGHT - 0.06)
        rim = frame(1.2, 0.6, 0.04, 0.06).turned(np.pi / 2, "x").moved(-0.6, 0.3, 0)
        place("Panel rim", mesh("Panel rim", rim, look["white"]), (panel[0], panel[1], HEIGHT - 0.025))
        area("Office panel", panel, (0, 0, -1), (1.19, 0.59), 150.0, COOL)
    elif room.purpose == "salon":
        cord = floor_lamp(detail, 0.8).scaled(0.4, 0.4, 1.0).turned(np.pi, "x")
        place("Salon pendant", mesh("Salon pendant", cord, look["brass"], SMOOTH), at(3.0, 2.1, HEIGHT + 0.001))
        point("Salon pendant", at(3.0, 2.1, HEIGHT - 0.95), 160.0, NEUTRAL, 0.09)


def _standard_lamp(detail: Detail, look: dict[str, Surface], foot: tuple[float, float, float]) -> None:
    """A standard lamp, whose bulb hangs a little out of its shade and so shines through the door."""
    x, y, _ = foot
    place("Standard lamp", mesh("Standard lamp", floor_lamp(detail, 1.5), look["brass"], SMOOTH), (x, y, 0.001))
    place("Shade", mesh("Shade", lampshade(detail, 0.24, 0.15, 0.28), look["shade"], SMOOTH), (x, y, 1.45))
    point("Standard lamp", (x + 0.05, y, 1.4), 90.0, WARM, 0.04)
