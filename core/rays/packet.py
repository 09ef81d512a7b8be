"""A packet of 16 rays in structure-of-arrays form, as Embree's RTCRayHit16 lays it out.

Kernels make one packet per chunk with `new_packet`, fill its lanes with `set_ray`, trace it with
`trace.occluded_packet` or `trace.intersect_packet`, and read the lanes.  Every backend reads and writes the
same layout, so the kernels never know which one traces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel

WIDTH = 16

# Rows of a packet (RTCRay16 is rows 0-11, RTCHit16 rows 12-20); `VALID` is the argument beside it.
ORG_X, ORG_Y, ORG_Z, T_NEAR, DIR_X, DIR_Y, DIR_Z, TIME, T_FAR, MASK, RAY_ID, RAY_FLAGS = range(12)
NORMAL_X, NORMAL_Y, NORMAL_Z, HIT_U, HIT_V, PRIMITIVE, GEOMETRY, INSTANCE, INSTANCE_PRIMITIVE = range(12, 21)
VALID = 21
ROWS = 22
# Room behind the packet: single rays, the parts of a packet on machines narrower than 16, stacks of the BVH.
SCRATCH = ROWS * WIDTH
WORDS = 3 * ROWS * WIDTH

OCCLUDED = np.float32(-np.inf)


class Packet(NamedTuple):
    """One scratch block, 64-byte aligned, seen as floats and as integers.

    f: (WORDS,) float32;  i: (WORDS,) int32, the same memory;  address: where it begins.
    """

    f: np.ndarray
    i: np.ndarray
    address: int


@kernel
def new_packet():
    """A packet with every lane disabled. Allocate one per chunk, not per ray."""
    block = np.zeros(WORDS + 16, np.float32)
    skip = ((64 - block.ctypes.data % 64) % 64) // 4
    f = block[skip : skip + WORDS]
    packet = Packet(f, f.view(np.int32), np.uintp(f.ctypes.data))
    for lane in range(WIDTH):
        packet.f[T_FAR * WIDTH + lane] = np.float32(-1.0)
    for lane in range(WIDTH):
        packet.i[INSTANCE * WIDTH + lane] = -1
        packet.i[INSTANCE_PRIMITIVE * WIDTH + lane] = -1
        packet.i[PRIMITIVE * WIDTH + lane] = -1
    return packet


@inlined
def set_ray(packet, lane, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """Ray `lane` (0..15): origin, direction (any length; t is in units of it), range of t, bits of ray kinds."""
    f = packet.f
    f[ORG_X * WIDTH + lane] = ox
    f[ORG_Y * WIDTH + lane] = oy
    f[ORG_Z * WIDTH + lane] = oz
    f[T_NEAR * WIDTH + lane] = tnear
    f[DIR_X * WIDTH + lane] = dx
    f[DIR_Y * WIDTH + lane] = dy
    f[DIR_Z * WIDTH + lane] = dz
    f[T_FAR * WIDTH + lane] = tfar
    packet.i[MASK * WIDTH + lane] = mask


@inlined
def disable_ray(packet, lane):
    """Switch lane `lane` off: neither occluded nor a hit, at no cost."""
    packet.f[T_NEAR * WIDTH + lane] = np.float32(0.0)
    packet.f[T_FAR * WIDTH + lane] = np.float32(-1.0)


@inlined
def is_occluded(packet, lane):
    """Whether `occluded_packet` found anything in the ray's range."""
    return packet.f[T_FAR * WIDTH + lane] == OCCLUDED


@inlined
def hit_triangle(packet, lane):
    """Index of the nearest triangle after `intersect_packet`, -1 for none."""
    return packet.i[PRIMITIVE * WIDTH + lane]


@inlined
def hit_t(packet, lane):
    """Ray parameter of the hit (tfar where there is none)."""
    return packet.f[T_FAR * WIDTH + lane]


@inlined
def hit_u(packet, lane):
    """Weight of corner 1 at the hit."""
    return packet.f[HIT_U * WIDTH + lane]


@inlined
def hit_v(packet, lane):
    """Weight of corner 2 at the hit."""
    return packet.f[HIT_V * WIDTH + lane]
