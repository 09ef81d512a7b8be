"""NaN and infinity in every table, and pictures, lights and clusters of every count: a whole picture of numbers comes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...core import scene as sc
from ...core.errors import SceneError
from ...core.surfaces.layout import DIFFUSE, EMISSION, ROUGHNESS
from . import arrays
from .outcome import Outcome
from .rooms import bulb, irradiance, light, room

BAD = {"NaN": np.nan, "infinity": np.inf, "-infinity": -np.inf}


def _vertex(scene: sc.Scene, bad: float) -> None:
    scene.geometry.vertices[-1, 0] = bad


def _corner_normal(scene: sc.Scene, bad: float) -> None:
    scene.geometry.corner_normals[::3, 0, 1] = bad


def _albedo(scene: sc.Scene, bad: float) -> None:
    scene.materials.tables.constant[3, DIFFUSE] = bad


def _emission(scene: sc.Scene, bad: float) -> None:
    scene.materials.tables.constant[3, EMISSION] = bad
    scene.materials.tables.flags[3] |= sc.EMISSIVE


def _roughness(scene: sc.Scene, bad: float) -> None:
    scene.materials = arrays.glossy_materials((0.5, 0.0), (0.5, 0.0), (0.5, 0.0), (0.5, 0.0), albedo=0.2, roughness=0.3)
    scene.materials.tables.constant[3, ROUGHNESS] = bad


def _texel(scene: sc.Scene, bad: float) -> None:
    texels = np.full((4, 4, 3), 0.5, np.float32)
    texels[0, 0, 1] = bad
    scene.materials = arrays.textured(scene.materials, 3, texels)


def _strength(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), bulb())
    scene.lamps.emission[1, 2] = bad


def _place(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), bulb())
    scene.lamps.position[1, 0] = bad


def _axes(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), arrays.lamp(sc.AREA, 1.0, (0, 0, 0.9), size=(0.2, 0.2)))
    scene.lamps.axes[1, 2] = bad


def _size(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), arrays.lamp(sc.AREA, 1.0, (0, 0, 0.9), size=(0.2, 0.2)))
    scene.lamps.size[1, 0] = bad


def _radius(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), bulb())
    scene.lamps.radius[1] = bad


def _cone(scene: sc.Scene, bad: float) -> None:
    scene.lamps = arrays.lamps(bulb(), arrays.lamp(sc.SPOT, 1.0, (0, 0, 0.9), angle=1.0))
    scene.lamps.angle[1] = bad


def _sky(scene: sc.Scene, bad: float) -> None:
    radiance = np.ones((8, 16, 3), np.float32)
    radiance[2, 3, 1] = bad
    scene.world = sc.World(radiance)
    scene.geometry = arrays.geometry(*arrays.quads([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]))


PLACES: dict[str, Callable[[sc.Scene, float], None]] = {
    "a vertex": _vertex,
    "corner normals": _corner_normal,
    "an albedo": _albedo,
    "a shining material": _emission,
    "a roughness": _roughness,
    "a pixel of a texture": _texel,
    "a lamp's strength": _strength,
    "a lamp's place": _place,
    "a lamp's axes": _axes,
    "a lamp's size": _size,
    "a lamp's radius": _radius,
    "a spot's cone": _cone,
    "a pixel of the sky": _sky,
}


def invalid_numbers(method: str) -> Iterator[Outcome]:
    """Each place with each value that is no finite number."""
    for place, spoil in PLACES.items():
        for name, bad in BAD.items():
            scene = room(size=(9, 7))
            spoil(scene, bad)
            yield made_of_numbers(f"{name} in {place}", scene, method)


def made_of_numbers(case: str, scene: sc.Scene, method: str, **settings) -> Outcome:
    """All layers finite, or the scene refused with a line."""
    try:
        value = irradiance(light(scene, method, **settings))
    except SceneError:
        return Outcome(f"{case}: refused with a line", method, "1 line", 1, True)
    except Exception as error:  # any fault is a finding, and named
        return Outcome(f"{case}: {type(error).__name__}: {error}", method, "finite, >= 0", float("nan"), False)
    return Outcome(f"{case}: irradiance", method, "finite, >= 0", value, value >= 0)


def counts(method: str) -> Iterator[Outcome]:
    """Sizes, lights and clusters that fit no packet, chunk or window."""
    for size in ((1, 1), (1, 17), (17, 1), (15, 3), (8192, 1), (1, 8192), (257, 129)):
        small = {"pixel_samples": 1, "direct_samples": 1} if size[0] * size[1] > 1000 else {}
        yield made_of_numbers(f"{size[0]}x{size[1]} pixels", room(size=size), method, **small)
    for vpls in (1, 2, 7, 15, 17, 33, 4097):
        yield made_of_numbers(f"{vpls} VPLs", room(size=(9, 7)), method, vpls=vpls)
    more = {
        "more clusters than points and lights": {"vpl_clusters": 5000, "point_clusters": 5000, "vals": 300, "fuzziness": 32},
        "one cluster": {"vpl_clusters": 1, "point_clusters": 1, "vals": 1, "fuzziness": 1},
        "one sample of everything": {"pixel_samples": 1, "direct_samples": 1, "samples": 1, "gather": 1, "reflections": 1},
        "no bounce": {"bounces": 0},
        "one bounce": {"bounces": 1},
        "64 bounces": {"bounces": 64},
        "8 voxels": {"voxels": 8},
        "the largest seed": {"seed": 2**31 - 1},
        "17 pixel samples": {"pixel_samples": 17},
    }
    for case, settings in more.items():
        yield made_of_numbers(case, room(size=(9, 7)), method, **settings)


def few(method: str) -> Iterator[Outcome]:
    """Next to nothing in the scene."""
    triangle = arrays.geometry([(-1, -1, -1), (1, -1, -1), (0, 1, -1)], [(0, 1, 2)])
    nothing = arrays.geometry(np.zeros((0, 3)), np.zeros((0, 3)))
    grey = arrays.materials((0.5, 0.0))
    yield made_of_numbers("one triangle", arrays.scene(triangle, grey, lamps=bulb(), camera=arrays.camera(width=9, height=7)), method)
    yield made_of_numbers("one triangle under the sky", arrays.scene(triangle, grey, world=(1, 1, 1)), method)
    yield made_of_numbers("a triangle that shines alone", arrays.scene(triangle, arrays.materials((0.5, 1.0))), method)
    yield made_of_numbers("no triangle", arrays.scene(nothing, grey, lamps=bulb()), method)
    yield made_of_numbers("no triangle under the sky", arrays.scene(nothing, grey, world=(1, 1, 1)), method)
    yield made_of_numbers("no lamp", arrays.scene(triangle, grey), method)


def threads(method: str) -> Iterator[Outcome]:
    """The same bits for any number of threads."""
    one = light(room(), method, threads=1)
    for count in (2, 3, 16, 64):
        many = light(room(), method, threads=count)
        differ = sum(int(np.count_nonzero(one[name] != many[name])) for name in one)
        yield Outcome(f"{count} threads beside one: values that differ", method, "0", differ, differ == 0)


def million(method: str) -> Iterator[Outcome]:
    """A million VPLs, whose light is that of a thousand."""
    from .scales import near

    few_lights = irradiance(light(room(size=(4, 3)), method, vpls=1024, bounces=1))
    many = irradiance(light(room(size=(4, 3)), method, vpls=1_000_000, bounces=1, threads=0, vpl_clusters=1000))
    yield near("a million VPLs: irradiance", method, many, few_lights, 0.1)
