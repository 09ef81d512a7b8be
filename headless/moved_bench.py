"""One object of a thousand moves: what a frame of a sequence builds again, beside a frame by itself.

Rows: suite `frames`, cases `object, ...`: seconds of the hierarchies, and CPU seconds of the frame, by itself as the value and in the
sequence as the peer's.  The thousand share no mesh, as few objects of a real scene do.
"""

from __future__ import annotations

import statistics
from time import process_time

import bpy
import numpy as np

from ..core.settings import RenderSettings, SequenceSettings
from .console import Terminal
from .frames import View
from .sequences import Shot, ShotRenderer

OBJECTS = 1000
SIDE = 23  # vertices of each object's grid: 968 triangles
FRAMES = 5


def moved_rows(size: tuple[int, int], objects: int = OBJECTS) -> list[dict]:
    """The rows, of frames after the first."""
    scene = _field(objects)
    alone, ours = (_measured(scene, size, SequenceSettings(history=history)) for history in (0, SequenceSettings().history))
    rows = []
    for name, value, mine in zip(("hierarchies", "CPU time a frame"), alone, ours):
        case = f"object, one of {objects} moved: {name}"
        rows.append({"suite": "frames", "case": case, "value": value, "unit": "s", "peer_value": mine, "ratio": mine / value})
    return rows


def _measured(scene: bpy.types.Scene, size: tuple[int, int], shared: SequenceSettings) -> tuple[float, float]:
    """Median seconds of a frame's hierarchies, and of the CPU."""
    shot = Shot(range(1, FRAMES + 1), View(size=size), RenderSettings(), shared)
    hierarchies, cpu = [], []
    with ShotRenderer(scene, shot, Terminal.silent()) as renderer:
        for number in shot.frames:
            if not shared.history:
                renderer.close()  # nothing is kept
            begin = process_time()
            hierarchies.append(renderer.frame(number).stats["seconds"]["rays"])
            cpu.append(process_time() - begin)
    return statistics.median(hierarchies[1:]), statistics.median(cpu[1:])


def _field(objects: int) -> bpy.types.Scene:
    """Wavy cloths in rows under the sun, the first of which falls."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.4, 0.4, SIDE)] * 2))
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).reshape(-1, 1)
    faces = corner + np.array([0, 1, SIDE + 1, SIDE])
    row = int(np.ceil(np.sqrt(objects)))
    for k in range(objects):
        mesh = bpy.data.meshes.new(f"Cloth {k}")
        wave = 0.1 * np.sin(9 * x + k) * np.cos(7 * y - k)
        mesh.from_pydata(np.column_stack([x, y, wave]).tolist(), [], faces.tolist())
        ob = bpy.data.objects.new(f"Cloth {k}", mesh)
        ob.location = (k % row - row / 2, k // row - row / 2, 0)
        scene.collection.objects.link(ob)
        if k == 0:
            ob.keyframe_insert("location", frame=1)
            ob.location.z -= 1
            ob.keyframe_insert("location", frame=FRAMES)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = (0.5, 0.3, 0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0, -row, 0.6 * row), (1.0, 0, 0)
    for ob in (sun, camera):
        scene.collection.objects.link(ob)
    scene.camera = camera
    return scene
