"""Rays against triangles: Embree inside Numba kernels, a BVH in Numba where there is no Embree.

From NumPy: `RayScene`, then `intersect` and `occluded` on arrays of rays.  Inside kernels: pass
`RayScene.tables`, make a `new_packet()`, fill it with `set_ray`, and trace it with `occluded_packet` or
`intersect_packet` (rays in any order: `occluded1`, `intersect1`).
"""

from .offsets import hit_point, offset_origin, shadow_segment
from .order import morton_order
from .packet import WIDTH, Packet, disable_ray, hit_t, hit_triangle, hit_u, hit_v, is_occluded, new_packet, set_ray
from .scene import Hits, RayScene, intersect, occluded
from .trace import ALL, COHERENT, CUTOUT, OPAQUE, intersect1, intersect_packet, occluded1, occluded_packet

__all__ = [
    "ALL",
    "COHERENT",
    "CUTOUT",
    "OPAQUE",
    "WIDTH",
    "Hits",
    "Packet",
    "RayScene",
    "disable_ray",
    "hit_point",
    "hit_t",
    "hit_triangle",
    "hit_u",
    "hit_v",
    "intersect",
    "intersect1",
    "intersect_packet",
    "is_occluded",
    "morton_order",
    "new_packet",
    "occluded",
    "occluded1",
    "occluded_packet",
    "offset_origin",
    "set_ray",
    "shadow_segment",
]
