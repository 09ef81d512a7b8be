"""What can be left out one by one: the same picture with and without, and what it costs."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple
from unittest import mock

import numpy as np

from ...core.denoise import Denoiser
from ...core.lamps import world_tables
from ...core.layers import Layers
from ...core.methods.instant_radiosity import InstantRadiosity, clamp_of
from ...core.pipeline import render
from ...core.planning import planner
from ...core.reuse import Sequence
from ...core.scene import ALL_RAYS, CAMERA, EMISSIVE, POINT, Scene
from ...core.settings import RenderSettings, SequenceSettings
from ...core.stages import Run, prepared
from ...core.surfaces.layout import DIFFUSE, EMISSION
from ...core.topology import IN_MEMORY, Topologies, Topology
from ...core.view.primary import view
from ...core.vpl_pool import vpl_pool
from ..stress import arrays, rooms
from . import scenes, textures

REQUEST = RenderSettings(
    method="importance-sampling", vpls=512, samples=4, gather=4, pixel_samples=4, direct_samples=4, denoise=False, seed=1
)
BLACK = 1e-9  # an albedo that is not skipped, and gives no light that anybody sees
DARK_LAMPS = 2000
TARGET = 0.05  # relMSE
MANY = 64  # rays a pixel, of each kind
GATES = replace(REQUEST, method="visibility-gates", voxels=128)


class Extent(NamedTuple):
    """How large the cases are: pixels; subdivisions of the hidden sphere (7: 327,680 triangles); pixels of a texture; s of a budget."""

    size: tuple[int, int] = (160, 90)
    subdivisions: int = 7
    side: int = 1024
    budget: float = 4.0


WHOLE = Extent()

# A picture, and the layer whose means are compared.
Work = Callable[[], Layers]
Case = tuple[str, str, Work, Work]


def cases(extent: Extent) -> Iterator[Case]:
    """(name, layer to be compared, work with skipping, work without)."""
    size = extent.size
    room = rooms.room(size=size)
    few = replace(REQUEST, layers=("Depth", "Normal", "Albedo"))
    yield "layers not asked for", "Depth", lambda: _layers(room, few), lambda: _layers(room)
    black, nearly = (rooms.room(size=size, albedos=((albedo,) * 3,) * 4) for albedo in (0.0, BLACK))
    yield "light of black surfaces", "Indirect", lambda: _layers(black), lambda: _layers(nearly)
    shining, painted = (_with_panel(size, albedo) for albedo in (0.0, BLACK))
    yield "pixels of lamps", "Indirect", lambda: _layers(shining), lambda: _layers(painted)
    sky, backdrop = (_under_the_sky(size, shown) for shown in (False, True))
    yield "pixels of the sky", "Indirect", lambda: _layers(sky), lambda: _layers(backdrop)
    dark, dim = (_with_lamps(size, power) for power in (0.0, BLACK))
    yield "lamps that give no light", "Indirect", lambda: _layers(dark), lambda: _layers(dim)
    hidden, shown = (_with_sphere(room, extent.subdivisions, visibility) for visibility in (0, ALL_RAYS))
    yield "objects hidden from every ray", "Indirect", lambda: _layers(hidden), lambda: _layers(shown)
    yield "rooms with no way to the view", "Indirect", *_apart(scenes.house(*size))
    yield "frames where nothing changed", "Indirect", *_frames(room)
    yield "topology known already", "Indirect", *_gates(room)
    yield "passes after the error is met", "Indirect", *_target(room, extent.budget)
    yield "denoising of light without noise", "DiffuseIndirect", *_smooth(room)
    yield "denoising where the error is met", "DiffuseIndirect", *_met(size)
    yield "textures of materials on no triangle", "Indirect", *(lambda s=s: _layers(s()) for s in textures.spare(size, extent.side))
    yield "materials baked already", "Albedo", *(lambda s=s: _layers(s(), few) for s in textures.baked(size))


def _layers(scene: Scene, settings: RenderSettings = REQUEST, **more) -> Layers:
    return render(scene, settings, **more).layers


def _with_sphere(room: Scene, subdivisions: int, visibility: int) -> Scene:
    """The room with a sphere of many triangles far outside of it, seen by rays of the kinds `visibility`."""
    vertices, triangles = arrays.icosphere(subdivisions, inward=False)
    scene = rooms.room(size=(room.camera.width, room.camera.height), extra=((vertices + 5.0, triangles, 0),))
    geometry = scene.geometry
    geometry.object[-len(triangles) :] = 1
    geometry.object_names, geometry.object_visibility = ["room", "sphere"], np.array([ALL_RAYS, visibility], np.uint8)
    return scene


def _with_panel(size: tuple[int, int], albedo: float) -> Scene:
    """The room, whose block shines and has an albedo."""
    scene = rooms.room(size=size)
    tables = scene.materials.tables
    tables.constant[3, DIFFUSE : DIFFUSE + 3], tables.constant[3, EMISSION : EMISSION + 3] = albedo, 1.0
    tables.flags[3] |= EMISSIVE
    return scene


def _under_the_sky(size: tuple[int, int], backdrop: bool) -> Scene:
    """The landscape, whose sky is hidden from the camera by a black surface far behind the house, or not."""
    scene = scenes.landscape(*size)
    if not backdrop:
        return scene
    geometry = scene.geometry
    wall = arrays.quads([(-60, 40, 0), (60, 40, 0), (60, 40, 80), (-60, 40, 80)])
    vertices, triangles, material = arrays.join((geometry.vertices, geometry.triangles, geometry.material), (*wall, 2))
    paint = arrays.materials(*((scene.materials.tables.constant[k, DIFFUSE : DIFFUSE + 3], 0.0) for k in range(2)), (BLACK, 0.0))
    whole = arrays.geometry(vertices, triangles, material)
    whole.object[-2:] = 1
    whole.object_names, whole.object_visibility = ["land", "backdrop"], np.array([ALL_RAYS, CAMERA], np.uint8)
    return replace(scene, geometry=whole, materials=paint)


def _with_lamps(size: tuple[int, int], power: float) -> Scene:
    """The room with thousands of lamps of a power beside its own."""
    places = np.random.default_rng(3).uniform(-0.9, 0.9, (DARK_LAMPS, 3))
    return rooms.room(size=size, lamps=arrays.lamps(rooms.bulb(), *(arrays.lamp(POINT, power, place) for place in places)))


class _OneRoom(Topologies):
    """Topologies of which all rooms are one: nothing is out of reach."""

    def of(self, scene: Scene, resolution: int, threads: int = 0, **space: bool) -> Topology:
        """A topology from memory, as if all of its empty space were joined."""
        found = IN_MEMORY.of(scene, resolution, threads, **space)
        return replace(found, room=np.zeros_like(found.room))


def _apart(house: Scene) -> tuple[Work, Work]:
    """Visibility gates with what is known of rooms, and without; the topology is in memory."""
    return lambda: _layers(house, GATES), lambda: _layers(house, GATES, topologies=_OneRoom())


def _target(room: Scene, budget: float) -> tuple[Work, Work]:
    """A picture that ends at an error, and one that takes all of its time."""
    request = RenderSettings(method="importance-sampling", seed=1)
    return lambda: _layers(room, replace(request, target_error=TARGET)), lambda: _layers(room, replace(request, time_budget=budget))


def _smooth(room: Scene) -> tuple[Work, Work]:
    """A method without noise as it is, and its diffuse light denoised all the same."""
    settings = replace(REQUEST, method="fuzzy-clustering", denoise=True)

    def denoised() -> Layers:
        layers = _layers(room, settings)
        with closing(Denoiser()) as denoiser:
            guides = layers["Albedo"], layers["Normal"]
            layers["DiffuseIndirect"] = denoiser.denoise(layers["DiffuseIndirect"], *guides, clean_aux=True, preserve_mean=True)
        return layers

    return lambda: _layers(room, settings), denoised


def _met(size: tuple[int, int]) -> tuple[Work, Work]:
    """A picture without noise to speak of whose error was asked for, and the same denoised all the same: the inside of a sphere that shines."""
    paint = arrays.materials((0.5, 1.0))
    scene = arrays.scene(arrays.geometry(*arrays.icosphere(3)), paint, camera=arrays.camera(width=size[0], height=size[1]))
    many = RenderSettings(method="importance-sampling", samples=MANY, gather=MANY, target_error=TARGET, seed=1, layers=("DiffuseIndirect",))

    def always() -> Layers:
        with mock.patch.object(planner, "UNSEEN_NOISE", 0.0):
            return _layers(scene, many)

    return lambda: _layers(scene, many), always


def _frames(room: Scene) -> tuple[Work, Work]:
    """The second frame of a sequence in which nothing moves, and the same picture by itself."""
    sequence = Sequence(SequenceSettings(history=0), moving=[])
    _layers(sequence.begin(room, 0), sequence=sequence)
    return lambda: _layers(sequence.begin(room, 1), sequence=sequence), lambda: _layers(room)


def _gates(room: Scene) -> tuple[Work, Work]:
    """Visibility gates with a topology in memory, and without."""
    settings, known = replace(REQUEST, method="visibility-gates", voxels=64), Topologies()
    _layers(room, settings, topologies=known)
    return lambda: _layers(room, settings, topologies=known), lambda: _layers(room, settings, topologies=Topologies())


def _measured(work: Work, layer: str) -> tuple[float, float, float]:
    """CPU seconds of all threads, the mean of a layer, and MiB of arrays at the peak (of a second run: counting takes time)."""
    begin = time.process_time()
    layers = work()
    seconds = time.process_time() - begin
    tracemalloc.start()
    try:
        work()
        memory = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    return seconds, float(layers[layer].mean(dtype=float)), memory


def single_rows(extent: Extent = WHOLE) -> list[dict]:
    """Rows of `bench skipping`: CPU seconds, what the picture shows, and memory, with and without."""
    rows = []
    for name, layer, skipping, everything in cases(extent):
        skipping(), everything()  # compiles, and fills the caches
        few, many = _measured(skipping, layer), _measured(everything, layer)
        units = (("CPU seconds", "s"), (f"mean {layer}", ""), ("memory of arrays", "MiB"))
        rows += [_row(f"{name}: {what}", unit, value, peer) for (what, unit), value, peer in zip(units, few, many)]
    return [*rows, _unlit_row(extent.size), _particles_row(extent.size)]


def _unlit_row(size: tuple[int, int]) -> dict:
    """Shadow rays of instant radiosity, whose pairs that face away from each other get none, beside one for each pair."""
    with prepared(Run(None), room := rooms.room(size=size), REQUEST, 0) as tables:
        points = view(room, tables.rays, world_tables(room.world), 1, 1).points
        vpls, _ = vpl_pool(tables, points, REQUEST.vpls, REQUEST.bounces, clamp_of, 1)
        solver = InstantRadiosity(compensation=0)
        solver.prepare(tables, vpls, points)
        solver.irradiance(points)
    return _row("shading of unlit halves: shadow rays", "1", solver.rays, solver.pairs)


def _particles_row(size: tuple[int, int]) -> dict:
    """Rays of particles until there are enough VPLs in the rooms of the view."""
    house = scenes.house(*size)
    few, many = (render(house, GATES, topologies=known).stats["rays"]["light"] for known in (IN_MEMORY, _OneRoom()))
    return _row("rooms with no way to the view: rays of particles", "1", few, many)


def _row(case: str, unit: str, value: float, peer: float) -> dict:
    row = {"suite": "skipping", "case": f"{case}, with and without skipping", "value": value, "unit": unit, "peer_value": peer}
    return row | ({"ratio": peer / value} if value else {})
