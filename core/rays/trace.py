"""Tracing inside kernels: one name for every backend, chosen by the type of the tables at compile time.

`tables` is `RayScene.tables`, `which` one of OPAQUE, CUTOUT, ALL
(| COHERENT for packets).  Call these from jitted functions only.
"""

from __future__ import annotations

from numba import types
from numba.extending import overload

from ..references import ReferenceType

# Sets of triangles. COHERENT is or-ed to a set for packets whose rays stay together (camera rays of a tile, a
# light's shadow rays to neighbouring points): 1.3 times faster there, and up to twice slower elsewhere.
OPAQUE, CUTOUT, ALL, COHERENT = 1, 2, 3, 4


def occluded_packet(tables, which, packet, count):
    """Any-hit test of lanes 0..count-1; read the answers with `is_occluded`."""
    raise NotImplementedError("for jitted code")


def intersect_packet(tables, which, packet, count):
    """Nearest hits of lanes 0..count-1; read them with `hit_triangle`, `hit_t`, `hit_u`, `hit_v`."""
    raise NotImplementedError("for jitted code")


def occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """Any-hit test of one ray -> bool. `packet` only lends scratch space: its lanes stay as they are."""
    raise NotImplementedError("for jitted code")


def intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """Nearest hit of one ray -> (triangle or -1, t, u, v). `packet` only lends scratch space."""
    raise NotImplementedError("for jitted code")


def register_backend(tables_class, occluded_packet_of, intersect_packet_of, occluded1_of, intersect1_of):
    """Let the functions above call these jitted ones wherever `tables` is a `tables_class`."""
    packet_pairs = ((occluded_packet, occluded_packet_of), (intersect_packet, intersect_packet_of))
    single_pairs = ((occluded1, occluded1_of), (intersect1, intersect1_of))
    options = {"error_model": "numpy", "forceinline": True}

    def matches(tables):
        tables = tables.value if isinstance(tables, ReferenceType) else tables
        return isinstance(tables, types.BaseNamedTuple) and tables.instance_class is tables_class

    def dispatch_packet(stub, jitted):
        @overload(stub, jit_options=options)
        def choose(tables, which, packet, count):
            if matches(tables):
                return lambda tables, which, packet, count: jitted(tables, which, packet, count)

    def dispatch_single(stub, jitted):
        @overload(stub, jit_options=options)
        def choose(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
            if matches(tables):
                return lambda tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask: jitted(
                    tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask
                )

    for stub, jitted in packet_pairs:
        dispatch_packet(stub, jitted)
    for stub, jitted in single_pairs:
        dispatch_single(stub, jitted)
