"""How much memory a render will take, said before it is taken; what cannot fit is refused at once instead of half an hour later."""

from __future__ import annotations

import os

from .errors import SceneError
from .scene import Scene
from .settings import RenderSettings
from .vpl_pool import BATCH, MOST_BATCHES, MOST_FLOWN

# Bytes, from peaks of the process at several sizes (docs/stress.md): of a triangle with its place in Embree's tree; of a pixel in all
# layers, denoised; of a shading point with its light and its share of the cache of light; of a VPL; of a
# particle, of which the pool has up to so many at once (`vpl_pool`).
TRIANGLE, PIXEL, POINT, VPL, PARTICLE = 300, 662, 430, 1000, 70
POINTS_A_PIXEL = 1.6  # distinct surfaces in a pixel, in scenes of fine detail; never more than there are samples
BASE = 600 << 20  # code, tables, Blender
SHARE = 0.9  # of the free memory that may be used


def estimate(scene: Scene, settings: RenderSettings) -> int:
    """Bytes that a render of `scene` takes at its peak, roughly: within a factor of two."""
    camera, geometry, tables = scene.camera, scene.geometry, scene.materials.tables
    pixels = (camera.border[2] - camera.border[0]) * (camera.border[3] - camera.border[1]) if camera else 0
    points = pixels * min(POINTS_A_PIXEL, settings.pixel_samples)
    held = geometry.attributes.nbytes + tables.texels_u8.nbytes + tables.texels_f32.nbytes + scene.world.radiance.nbytes
    held += 0 if scene.world.seen is None else scene.world.seen.nbytes
    particles = min(MOST_BATCHES * BATCH * settings.vpls, MOST_FLOWN)
    parts = TRIANGLE * len(geometry.triangles) + PIXEL * pixels + POINT * points + VPL * settings.vpls + PARTICLE * particles
    return int(BASE + held + parts)


def available() -> int | None:
    """Bytes that may still be taken: what is free or can be freed, and what the process's own limits leave; None where unknown."""
    found = [value for value in (_free(), _left_of_limit()) if value is not None]
    return min(found, default=None)


def _free() -> int | None:
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            return next(int(line.split()[1]) << 10 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        return None


def _left_of_limit() -> int | None:
    """Bytes up to the limit of address space that a shell or a batch system has set (`ulimit -v`)."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return None
        with open("/proc/self/statm", encoding="ascii") as line:
            return max(0, limit - int(line.read().split()[0]) * os.sysconf("SC_PAGE_SIZE"))
    except (ImportError, OSError):
        return None


def check_memory(scene: Scene, settings: RenderSettings) -> None:
    """Raises SceneError where a render would take more memory than there is."""
    needed, free = estimate(scene, settings), available()
    if free is not None and needed > SHARE * free:
        raise SceneError(
            f"this render needs about {needed / 2**30:.1f} GiB of memory and {free / 2**30:.1f} GiB are free: "
            "give it a smaller size or fewer VPLs, render a region at a time, or simplify the scene"
        )
