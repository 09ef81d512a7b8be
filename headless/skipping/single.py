"""What can be left out one by one: the same picture with and without, and what it costs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ...core.layers import Layers
from ...core.pipeline import render
from ...core.reuse import Sequence
from ...core.scene import ALL_RAYS, Scene
from ...core.settings import RenderSettings, SequenceSettings
from ...core.topology import Topologies
from ..stress import arrays, rooms

REQUEST = RenderSettings(
    method="importance-sampling", vpls=512, samples=4, gather=4, pixel_samples=4, direct_samples=4, denoise=False, seed=1
)
BLACK = 1e-9  # an albedo that is not skipped, and gives no light that anybody sees
SPHERE = 7  # subdivisions of the hidden object: 327,680 triangles

# A picture, and the layer whose means are compared.
Work = Callable[[], Layers]
Case = tuple[str, str, Work, Work]


def cases(size: tuple[int, int], subdivisions: int = SPHERE) -> Iterator[Case]:
    """(name, layer to be compared, work with skipping, work without)."""
    room = rooms.room(size=size)
    few = replace(REQUEST, layers=("Depth", "Normal", "Albedo"))
    yield "layers not asked for", "Depth", lambda: _layers(room, few), lambda: _layers(room)
    black, nearly = (rooms.room(size=size, albedos=((albedo,) * 3,) * 4) for albedo in (0.0, BLACK))
    yield "light of black surfaces", "Indirect", lambda: _layers(black), lambda: _layers(nearly)
    hidden, shown = (_with_sphere(room, subdivisions, visibility) for visibility in (0, ALL_RAYS))
    yield "objects hidden from every ray", "Indirect", lambda: _layers(hidden), lambda: _layers(shown)
    yield "frames where nothing changed", "Indirect", *_frames(room)
    yield "topology known already", "Indirect", *_gates(room)


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


def _measured(work: Work, layer: str) -> tuple[float, float]:
    """CPU seconds of all threads, and the mean of a layer."""
    begin = time.process_time()
    layers = work()
    return time.process_time() - begin, float(layers[layer].mean(dtype=float))


def single_rows(size: tuple[int, int] = (160, 90), subdivisions: int = SPHERE) -> list[dict]:
    """Rows of `bench skipping`: CPU seconds and what the picture shows, with and without."""
    rows = []
    for name, layer, skipping, everything in cases(size, subdivisions):
        _measured(everything, layer)  # compiles
        (few, shown), (many, expected) = _measured(skipping, layer), _measured(everything, layer)
        for what, unit, value, peer in (("CPU seconds", "s", few, many), (f"mean {layer}", "", shown, expected)):
            row = {"suite": "skipping", "case": f"{name}: {what}, with and without skipping", "value": value, "unit": unit}
            rows.append(row | {"peer_value": peer} | ({"ratio": peer / value} if value else {}))
    return rows
