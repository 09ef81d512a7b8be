"""Scale, place, power and reflectance: light follows its laws over many orders of magnitude."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ...core import scene as sc
from ...core.inspection import foresee
from ...core.lamps import build_emitters
from . import arrays
from .outcome import Outcome
from .rooms import bulb, irradiance, light, room

SCALES = tuple(10.0**k for k in (-4, -3, -2, -1, 1, 2, 3, 4, 5))
POWERS = tuple(10.0**k for k in (-12, -9, -6, -3, 3, 6, 9, 12))
ALBEDOS = (0.0, 1e-7, 0.5, 0.999999, 1.0)
SPIKE = 1e6
FURNACE_BOUNCES = 4


def near(case: str, method: str, value: float, true: float, share: float) -> Outcome:
    """A value that must be `true` up to a share of it."""
    passed = abs(value - true) <= share * abs(true)
    return Outcome(case, method, f"{true:.4g} +- {100 * share:g} %", value, passed)


def scales(method: str) -> Iterator[Outcome]:
    """The room from a tenth of a millimetre to a hundred kilometres, its lamp growing with it."""
    whole = irradiance(light(room(), method))
    for scale in SCALES:
        share = 0.01 if scale in (SCALES[0], SCALES[-1]) else 0.001
        yield near(f"room at {scale:g} times its size: irradiance", method, irradiance(light(room(scale), method)), whole, share)


def powers(method: str) -> Iterator[Outcome]:
    """Lamps from a picowatt to a terawatt."""
    whole = irradiance(light(room(), method))
    for power in POWERS:
        value = irradiance(light(room(power=power), method)) / power
        yield near(f"lamp of {power:g} times the power: irradiance / power", method, value, whole, 0.001)


def albedos(method: str) -> Iterator[Outcome]:
    """A closed sphere of radiance 1 whose light is a geometric series of its albedo; above 1 it is finite, and said."""
    sphere = arrays.geometry(*arrays.icosphere(3))
    for albedo in ALBEDOS:
        scene = arrays.scene(sphere, arrays.materials((albedo, 1.0)), camera=arrays.camera(width=12, height=8))
        value = irradiance(light(scene, method, bounces=FURNACE_BOUNCES, vpls=512))
        true = math.pi * sum(albedo**k for k in range(1, FURNACE_BOUNCES + 1)) * (albedo > 0)
        yield near(f"furnace of albedo {albedo:g}: irradiance", method, value, true, 0.02)
    scene = arrays.scene(sphere, arrays.materials((1.2, 1.0)), camera=arrays.camera(width=12, height=8))
    value = irradiance(light(scene, method, bounces=FURNACE_BOUNCES, vpls=512))
    true = math.pi * sum(1.2**k for k in range(1, FURNACE_BOUNCES + 1))
    yield near("furnace of albedo 1.2 (unphysical): irradiance", method, value, true, 0.02)
    told = any("albedo" in line for line in foresee(scene, build_emitters(scene))[1])
    yield Outcome("furnace of albedo 1.2: a warning names it", method, "1 line", int(told), told)


def spikes(method: str) -> Iterator[Outcome]:
    """One pixel of the sky, or one small triangle, a million times as bright: all light a million times, too."""
    sky = np.zeros((16, 32, 3), np.float32)
    sky[3, 20] = 1.0
    floor = arrays.quads([(-3, -3, -1), (3, -3, -1), (3, 3, -1), (-3, 3, -1)], [(-3, 3, -1), (3, 3, -1), (3, 3, 2), (-3, 3, 2)])
    patch = np.array([(0.2, 0.2, 0.5), (0.3, 0.2, 0.5), (0.2, 0.3, 0.5)])

    def lit(strength: float, sky_strength: float) -> float:
        vertices, triangles, material = arrays.join((*floor, 0), (patch, [(0, 2, 1)], 1))
        scene = arrays.scene(
            arrays.geometry(vertices, triangles, material),
            arrays.materials((0.6, 0.0), (0.0, strength)),
            world=sky * sky_strength,
            camera=arrays.camera((0, 0, 1.5), 24, 16),
        )
        return irradiance(light(scene, method))

    for case, which in (("triangle of 1 dm", (1.0, 0.0)), ("pixel of the sky", (0.0, 1.0))):
        once = lit(*which)
        value = lit(*(SPIKE * strength for strength in which)) / SPIKE
        yield near(f"{case} of radiance {SPIKE:g}: irradiance / {SPIKE:g}", method, value, once, 0.001)


def colours(method: str) -> Iterator[Outcome]:
    """Light of one channel stays in it, and two lamps give the sum of their light."""
    red = light(room(lamps=arrays.lamp(sc.POINT, (1.0, 0.0, 0.0), (0.4, 0.2, 0.6))), method)["Irradiance"]
    yield Outcome("red lamp: green and blue light", method, "0", float(red[..., 1:].max()), not red[..., 1:].any())
    one = irradiance(light(room(), method))
    two = irradiance(light(room(lamps=arrays.lamps(bulb(), bulb())), method))
    yield near("two lamps in one place: irradiance", method, two, 2 * one, 0.03)
