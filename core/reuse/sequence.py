"""The state of a sequence of frames: what it keeps of the last frame, by comparing content, and the estimates of the last few."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np

from ..denoise import Denoiser
from ..lamps import Emitters, LightGroups, build_emitters
from ..methods.exchange import Probes
from ..particles import Vpls, trace_by_power
from ..picture import Picture
from ..rays import RayScene
from ..scene import TRANSPARENT, Scene
from ..settings import RenderSettings, SequenceSettings
from ..soundness import sound
from ..threads import Progress
from ..transport import Transport
from ..view.lamps import lamps_in_view, visible_lamps
from ..view.mirrors import has_mirrors
from ..view.points import ShadingPoints
from ..view.primary import View
from .history import Estimate, averaged, with_light
from .windows import ProbeWindow

PARTICLES_KEPT = 8  # batches
MOST_MOVING = 2000  # objects with a hierarchy of their own: Embree's memory goes with the square


@dataclass
class Changes:
    """What differs from the frame before."""

    geometry: bool = True
    light: bool = True
    camera: bool = True
    moved: tuple[int, ...] | None = None  # objects, where they alone have changed and kept their triangles


class Sequence:
    """What the frames of one sequence share; to be handed to `pipeline.render` frame by frame, in order.

    window: earlier frames whose light is averaged into a frame; `window` + 1 frames take consecutive parts of the same random
    sequence before it begins anew, so that a picture at rest stands still.
    moving: names of the objects that are expected to move: each has a hierarchy of its own for rays, so that it alone is built
    again.  Those that move unexpectedly join them.
    """

    def __init__(self, settings: SequenceSettings | None = None, *, moving: Collection[str] = ()):
        self.settings = settings or SequenceSettings()
        self.window = self.settings.history
        self.moving = set(moving)
        self.number = self.turn = 0
        self.changes = Changes()
        self.built: dict[str, int] = {"rays": 0, "objects": 0, "emitters": 0, "views": 0, "particles": 0}
        self._scene: Scene | None = None
        self._lit = self._seen = 0
        self._rays: RayScene | None = None
        self._emitters: Emitters | None = None
        self._view: tuple[tuple, View] | None = None
        self._particles: dict[tuple, tuple[Vpls, int]] = {}
        self._probes = ProbeWindow(self.window + 1)
        self._estimates: deque[Estimate] = deque(maxlen=self.window)
        self._exposed: list[Picture] = []
        self._denoiser: Denoiser | None = None

    def __enter__(self) -> Sequence:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Release what is kept."""
        if self._rays is not None:
            self._rays.close()
        if self._denoiser is not None:
            self._denoiser.close()
        self._rays = self._denoiser = self._view = self._scene = None
        self._particles.clear()
        self._probes.clear()
        self._estimates.clear()

    @property
    def denoiser(self) -> Denoiser:
        """One for all frames: its network is loaded once."""
        if self._denoiser is None:
            self._denoiser = Denoiser()
        return self._denoiser

    def begin(self, scene: Scene, number: int) -> Scene:
        """The frame that stands at `number` in the sequence: the same scene, on the arrays of the last one where they are alike."""
        scene = sound(scene)
        last, self.number, self.turn = self._scene, number, number % (self.window + 1)
        if last is None:
            self.changes = Changes()
        else:
            same = {
                name: alike(getattr(last, name), getattr(scene, name)) for name in ("geometry", "materials", "lamps", "world", "camera")
            }
            same["geometry"] &= bool(np.array_equal(last.origin, scene.origin))
            scene = replace(scene, **{name: getattr(last, name) for name, kept in same.items() if kept and name != "camera"})
            moved = None if same["geometry"] else moved_objects(last, scene)
            light = not (same["geometry"] and same["materials"] and same["lamps"] and same["world"])
            self.changes = Changes(not (same["geometry"] and same["materials"]), light, not same["camera"], moved)
        self._scene = scene
        if self.changes.light:
            self._lit += 1
            self._emitters = None
            self._particles.clear()
            self._probes.clear()
        if self.changes.light or self.changes.camera:
            self._seen += 1
        return scene

    def rays(self, scene: Scene) -> RayScene:
        """The scene's triangles, ready for tracing; not to be closed by the caller."""
        geometry = scene.geometry
        if self._rays is not None and not self.changes.geometry:
            return self._rays
        moved = self.changes.moved
        if self._rays is not None and moved is not None:
            names = {geometry.object_names[i] for i in moved}
            if names <= self.moving and self._rays.move(geometry.vertices, {i + 1 for i in moved}):
                self.built["objects"] += len(moved)
                return self._rays
            self.moving |= names
        if self._rays is not None:
            self._rays.close()
        self._rays = ray_scene(scene, self.moving)
        self.built["rays"] += 1
        return self._rays

    def emitters(self, scene: Scene, groups: LightGroups | None = None) -> Emitters:
        """The tables of the scene's lights; groups: the light groups to tell apart, None for none."""
        if self._emitters is None:
            self._emitters = build_emitters(scene, groups=groups)
            self.built["emitters"] += 1
        return self._emitters

    def view(self, scene: Scene, settings: RenderSettings, compute) -> View:
        """What the camera sees, by `compute()` only where anything of it has changed."""
        lamps = visible_lamps(scene) if has_mirrors(scene) else lamps_in_view(scene)
        shown = (scene.camera, scene.geometry, scene.materials, scene.world, lamps, settings.pixel_samples, settings.seed)
        if self._view is None or not alike(self._view[0], shown):
            self._view = shown, compute()
            self.built["views"] += 1
        return self._view[1]

    def particles(self, tables: Transport, count: int, bounces: int, seed: int, threads: int = 0) -> tuple[Vpls, int]:
        """`trace_by_power`, whose particles are those of the last frame as long as nothing but the camera has changed."""
        key = count, bounces, seed
        if key not in self._particles:
            while len(self._particles) >= PARTICLES_KEPT:
                del self._particles[next(iter(self._particles))]
            self._particles[key] = trace_by_power(tables, count, bounces, seed, threads)
            self.built["particles"] += 1
        vpls, rays = self._particles[key]
        return vpls._replace(flux=vpls.flux.copy()), rays  # whose light the caller shares out

    def probes(
        self, tables: Transport, points: ShadingPoints, paths: int, seed: int, threads: int = 0, progress: Progress | None = None
    ) -> tuple[Probes, int]:
        """`trace_probes`, of which each frame traces a part, and takes the others from the frames before as long as the light stands still."""
        return self._probes.trace(self.number, tables, points, paths, seed, threads, progress)

    @property
    def resting(self) -> bool:
        """Whether the camera stands where it stood: so it does in the first frame, as far as that can know."""
        return not self.changes.camera or self.number == 0

    @property
    def first_turns(self) -> list[int]:
        """Turns that the first frame computes beside its own, so that it has as many samples as all later ones, and nothing settles."""
        return list(range(1, self.window + 1)) if self.number == 0 else []

    def add(self, picture: Picture) -> Estimate:
        """Keep what a frame has found by itself."""
        estimate = Estimate.of(picture, self._scene, self._lit, self._seen)
        self._estimates.append(estimate)
        return estimate

    def averaged(self, picture: Picture, threads: int) -> Picture:
        """The picture with the light of the frames before it, which it joins."""
        if not self.window:
            return picture
        earlier = list(self._estimates)
        estimate = self.add(picture)
        return with_light(picture, averaged(estimate, earlier, threads))

    def expose(self, picture: Picture, threads: int) -> None:
        """Keep the picture of a sub-frame for the frame that it belongs to."""
        self._exposed.append(self.averaged(picture, threads))

    def developed(self, picture: Picture, threads: int) -> Picture:
        """The mean of a frame's sub-frames, of which `picture` is the last; positions are those of the middle one."""
        exposed, self._exposed = [*self._exposed, self.averaged(picture, threads)], []
        middle = len(exposed) // 2
        mean = exposed[middle]
        for other in exposed[:middle] + exposed[middle + 1 :]:
            mean = mean.blend(other)
        return mean


def ray_scene(scene: Scene, moving: Collection[str] = ()) -> RayScene:
    """The triangles of a scene, ready for tracing; the objects of these names can be moved (number + 1 in `RayScene.move`)."""
    geometry = scene.geometry
    transparent = (scene.materials.tables.flags[geometry.material] & TRANSPARENT) != 0
    visibility = geometry.object_visibility[geometry.object]
    alone = np.array([i + 1 if name in moving else 0 for i, name in enumerate(geometry.object_names)], np.int32)
    apart = 0 < np.count_nonzero(alone) <= MOST_MOVING
    return RayScene(geometry.vertices, geometry.triangles, visibility, transparent, moving=alone[geometry.object] if apart else None)


def alike(a, b) -> bool:
    """Whether two values, or all that two dataclasses or tuples hold, are equal."""
    if a is b:
        return True
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    if is_dataclass(a) and type(a) is type(b):
        return all(alike(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, (tuple, list)) and type(a) is type(b):
        return len(a) == len(b) and all(map(alike, a, b))
    return type(a) is type(b) and bool(a == b)


def moved_objects(before: Scene, now: Scene) -> tuple[int, ...] | None:
    """Objects whose vertices alone have changed; None where more than that has."""
    a, b = before.geometry, now.geometry
    if a.vertices.shape != b.vertices.shape or a.object_names != b.object_names or not np.array_equal(before.origin, now.origin):
        return None
    if not all(alike(getattr(a, name), getattr(b, name)) for name in ("triangles", "material", "object", "object_visibility")):
        return None
    if not alike(before.materials.tables.flags, now.materials.tables.flags):
        return None
    changed = (a.vertices != b.vertices).any(axis=1)
    return tuple(np.unique(b.object[changed[b.triangles].any(axis=1)]).tolist())
