"""From a scene to the tables of its emitters."""

from __future__ import annotations

import numpy as np

from ..sampling.discrete import cumulative
from ..sampling.sequences import r2_points
from ..scene import (
    AREA,
    CAMERA,
    CONSTANT,
    DIFFUSE,
    ELLIPSE,
    EMISSIVE,
    GLOSSY,
    GLOSSY_LOBE,
    POINT,
    SPOT,
    SUN,
    TELLING,
    TRANSMISSION,
    TRANSPARENT,
    Scene,
    bounds,
)
from ..surfaces.batch import evaluate_batch
from ..surfaces.closures import REFLECTED
from ..surfaces.layout import EMISSION
from .closed import outward
from .emission import shares
from .groups import LightGroups
from .links import is_parted, object_links, receiver_sets, shadow_kinds
from .sharp import small_lamps
from .tables import (
    AGAINST,
    AREA_M2,
    AXIS,
    AXIS_X,
    BACK_OUT,
    CASTS_SHADOW,
    CORNERS,
    COS_E,
    COS_INNER,
    COS_O,
    COS_OUTER,
    ELLIPTIC,
    ENERGY,
    EXPONENT,
    FADING,
    FRONT_OUT,
    GLOSSY_ONLY,
    HALF_SPREAD,
    INWARDS,
    LAMP,
    LINKED,
    LOWER,
    MAP,
    NOMINAL,
    NORMAL,
    ONE_MINUS_COS,
    PLANE,
    POSITION,
    PROGRAM,
    RADIUS,
    SEEN_BY_CAMERA,
    SEEN_BY_GLOSSY,
    SEEN_THROUGH_GLASS,
    SHAPE,
    SHARP,
    SIZE,
    SMOOTHING,
    SOFT,
    TAN_HALF_SPREAD,
    TEXTURED,
    TRIANGLE,
    UPPER,
    WITHIN,
    WORLD,
    Emitters,
    LampTables,
)  # fmt: skip
from .textured import measured
from .tree_build import COLUMNS, TWO_SIDED, light_tree
from .within import share_within
from .world import no_world, projected_box_area, world_table

# Up to this many emitters near the scene are all sampled at every point; more of them go into the tree.
FEW = 8
# Share of a material's mean radiance that its darkest textured triangles are drawn by: a few samples can miss a spark.
_DEFENSIVE = 0.01
_TEXTURE_SAMPLES = 16
_TYPICAL = 0.25  # of the scene's diagonal: the distance at which the light of a lamp with a falloff of its own is compared with others'


def _box(scene: Scene) -> np.ndarray:
    """(2, 3) float32 bounds of the triangles, a little enlarged so that nothing lies on its faces."""
    vertices = scene.geometry.vertices
    used = np.isfinite(vertices).all(axis=1)
    used &= np.bincount(scene.geometry.triangles.ravel(), minlength=len(used)) > 0
    if not used.any():
        return np.array([[-1, -1, -1], [1, 1, 1]], np.float32)
    corners = vertices if used.all() else vertices[used]
    low, high = (edge.astype(np.float64) for edge in bounds(corners))
    margin = 1e-4 * np.linalg.norm(high - low) + 1e-5
    return np.stack([low - margin, high + margin]).astype(np.float32)


def _lamps(scene: Scene, ray_kind: int, box: np.ndarray, threads: int = 0, shining: int = 0):
    """Index in the scene, kind, flags, radiance, flux, bounds and table of the lamps that shine, and the maps of those that are textured."""
    lamps = scene.lamps
    f = np.float32
    kinds = ray_kind | shining
    emission = lamps.emission.astype(np.float64).reshape(-1, 3)
    finite = np.isfinite(emission).all(1)
    for i in np.flatnonzero(~finite):
        scene.warnings.append(f"Lamp '{lamps.names[i]}' has no finite emission and is left out: give it a size or spread above zero.")
    size_ok = (lamps.kind != AREA) | (lamps.size.reshape(-1, 2) > 0).all(1)
    keep = np.flatnonzero(finite & (emission > 0).any(1) & ((lamps.visibility & kinds) != 0) & size_ok).astype(np.int32)
    kind, emission = lamps.kind[keep], emission[keep]
    axes, radius = lamps.axes.reshape(-1, 3, 3)[keep].astype(f), lamps.radius[keep].astype(np.float64)
    angle, blend = lamps.angle[keep].astype(np.float64), lamps.blend[keep].astype(np.float64)
    size, position = lamps.size.reshape(-1, 2)[keep].astype(np.float64), lamps.position.reshape(-1, 3)[keep].astype(np.float64)
    sphere, sun, area = (kind == POINT) | (kind == SPOT), kind == SUN, kind == AREA
    ellipse = area & (lamps.shape[keep] == ELLIPSE)
    flags = CASTS_SHADOW * (lamps.cast_shadow[keep] > 0) + SOFT * (sphere & (lamps.soft_falloff[keep] > 0)) + ELLIPTIC * ellipse
    for flag, kind_of_ray in ((SEEN_BY_GLOSSY, GLOSSY), (SEEN_BY_CAMERA, CAMERA), (SEEN_THROUGH_GLASS, TRANSMISSION)):
        flags = flags + flag * ((lamps.visibility[keep] & kind_of_ray) > 0)
    flags = flags + GLOSSY_ONLY * ((lamps.visibility[keep] & ray_kind) == 0)
    exponent, smoothing = np.where(sun[:, None], 0, lamps.falloff[keep].astype(np.float64)).T
    flags = flags + FADING * ((exponent > 0) | (smoothing > 0))
    typical = _TYPICAL * np.linalg.norm(np.diff(box.astype(np.float64), axis=0))
    nominal = typical**exponent * typical**2 / (typical**2 + smoothing) if typical > 0 else np.ones(len(keep))
    half = 0.5 * angle

    # Cycles: smoothstep((cos - cos_outer) / ((1 - cos_outer) blend)).
    spot = kind == SPOT
    cos_outer = np.where(spot, np.cos(half).astype(f), -2.0).astype(np.float64)
    cos_inner = np.where(spot, cos_outer + (1 - cos_outer) * np.clip(blend, 0, 1), -2.0).astype(f).astype(np.float64)
    solid_cosine = np.where(spot, (1 - cos_inner) + 0.5 * (cos_inner - cos_outer), 2.0)
    half = np.where(area, np.clip(half, 1e-4, np.pi / 2), half)
    full = half >= np.pi / 2 - 1e-6
    tangent = np.where(full, np.inf, np.tan(np.where(full, 0.1, half)))

    scale = np.ones(len(keep))
    with np.errstate(divide="ignore"):
        scale = np.where(sphere & (radius > 0), 1 / (np.pi * radius**2), scale)
        scale = np.where(sun & (half > 0), 1 / (np.pi * np.sin(half) ** 2), scale)
    shape_area = np.prod(size, 1) * np.where(ellipse, np.pi / 4, 1.0)
    # Integral of cos (1 - tan / tan_half) over the cone of an area lamp's spread.
    spread_cosine = np.pi * (1 - np.where(area & ~full, half, 0.0) / np.where(area, tangent, 1.0))
    flux_factor = np.where(sphere, 2 * np.pi * solid_cosine, np.where(area, shape_area * spread_cosine, 0.0))
    flux_factor *= nominal
    if sun.any():
        flux_factor[sun] = projected_box_area(box, axes[sun, 2])

    bounds = np.zeros((len(keep), COLUMNS))
    reach = np.where(sphere[:, None], radius[:, None], 0.5 * (np.abs(axes[:, 0]) * size[:, :1] + np.abs(axes[:, 1]) * size[:, 1:]))
    bounds[:, LOWER : LOWER + 3], bounds[:, UPPER : UPPER + 3] = position - reach, position + reach
    bounds[:, AXIS : AXIS + 3] = -axes[:, 2]
    bounds[:, COS_O] = np.where(area | spot, 1.0, -1.0)
    bounds[:, COS_E] = np.where(area, np.where(full, 0.0, np.cos(half)), np.where(spot, cos_outer, 0.0))
    bounds[:, ENERGY] = emission.mean(1) * np.where(area, shape_area, 1.0) * nominal
    bounds[:, PLANE] = np.where(area, np.einsum("nc,nc->n", position, bounds[:, AXIS : AXIS + 3]), -np.inf)

    table = np.zeros((len(keep), LAMP), f)
    table[:, POSITION : POSITION + 3] = position
    table[:, AXIS_X : AXIS_X + 9] = axes.reshape(-1, 9)
    table[:, RADIUS], table[:, SIZE : SIZE + 2] = radius, size
    table[:, COS_OUTER], table[:, COS_INNER] = cos_outer, cos_inner
    table[:, ONE_MINUS_COS] = np.where(sun, 2 * np.sin(0.5 * half) ** 2, 0)
    table[:, EXPONENT], table[:, SMOOTHING], table[:, NOMINAL] = exponent, smoothing, nominal
    table[:, HALF_SPREAD], table[:, TAN_HALF_SPREAD] = half, np.where(area, tangent, np.inf)
    table[:, PROGRAM], table[:, MAP] = lamps.program[keep], -1
    flags = flags + TEXTURED * (lamps.program[keep] >= 0)
    mean, maps = measured(scene.materials.tables, kind, flags, table, threads)
    emission, bounds[:, ENERGY] = emission * mean[:, None], bounds[:, ENERGY] * mean
    columns = keep, kind, flags, emission * scale[:, None], emission * flux_factor[:, None], bounds, table
    if not mean.all():  # what no ray has met shining
        columns = tuple(column[mean > 0] for column in columns)
    return *columns, maps


def _textured_means(scene: Scene, triangle: np.ndarray, area: np.ndarray, threads: int) -> np.ndarray:
    """(M, 3) mean radiance of textured triangles by a few fixed samples, never far below their material's mean."""
    k = _TEXTURE_SAMPLES
    points = r2_points(0, k, 0)
    fold = points.sum(1) > 1
    points[fold] = 1 - points[fold]
    u, v = np.tile(points.T, (1, len(triangle)))
    view = 0.7 + REFLECTED  # not the camera's, which may see something else
    sides = np.tile(np.where(np.arange(k) % 2, view, -view), len(triangle))
    g = scene.geometry
    surface = evaluate_batch(scene.materials.tables, g.material, g.attributes, np.repeat(triangle, k), u, v, sides, threads)
    mean = surface[:, EMISSION : EMISSION + 3].reshape(-1, k, 3).astype(np.float64).mean(1)
    material = g.material[triangle]
    weight = np.bincount(material, area)
    for channel in range(3):
        overall = np.bincount(material, mean[:, channel] * area) / np.maximum(weight, 1e-30)
        mean[:, channel] = np.maximum(mean[:, channel], _DEFENSIVE * overall[material])
    return mean


def _mesh(scene: Scene, ray_kind: int, shining: int, threads: int):
    """Index, material, flags, radiance, flux, bounds and table of the triangles that shine."""
    g, tables = scene.geometry, scene.materials.tables
    f = np.float32
    emissive = np.flatnonzero(tables.flags & EMISSIVE)
    triangle = np.flatnonzero(np.isin(g.material, emissive) & ((g.object_visibility[g.object] & (ray_kind | shining)) != 0)).astype(
        np.int32
    )
    corners = g.vertices[g.triangles[triangle]].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    valid = np.isfinite(area) & (area > 0)
    triangle, corners, cross, area = triangle[valid], corners[valid], cross[valid], area[valid]
    material = g.material[triangle]
    textured = (tables.flags[material] & CONSTANT) == 0
    radiance = np.zeros((len(triangle), 3))
    radiance[~textured] = tables.constant[material[~textured], EMISSION : EMISSION + 3]
    if textured.any():
        radiance[textured] = _textured_means(scene, triangle[textured], area[textured], threads)
    shining = (radiance > 0).any(1)
    triangle, corners, cross, area, material = triangle[shining], corners[shining], cross[shining], area[shining], material[shining]
    radiance, textured = radiance[shining], textured[shining]
    normal = cross / (2 * area)[:, None]

    bounds = np.zeros((len(triangle), COLUMNS))
    bounds[:, LOWER : LOWER + 3], bounds[:, UPPER : UPPER + 3] = corners.min(1), corners.max(1)
    side = outward(scene, triangle)
    bounds[:, AXIS : AXIS + 3] = np.where(side, side, 1)[:, None] * normal
    bounds[:, PLANE] = np.where(side, np.einsum("nkc,nc->nk", corners, bounds[:, AXIS : AXIS + 3]).min(1), -np.inf)
    bounds[:, COS_O], bounds[:, TWO_SIDED], bounds[:, AGAINST] = 1.0, side == 0, np.where(side, INWARDS, 0)
    bounds[:, ENERGY] = radiance.mean(1) * area
    table = np.zeros((len(triangle), SHAPE), f)
    table[:, CORNERS : CORNERS + 9], table[:, NORMAL : NORMAL + 3], table[:, AREA_M2] = corners.reshape(-1, 9), normal, area
    flags = CASTS_SHADOW + TEXTURED * textured
    for flag, kind_of_ray in ((SEEN_BY_GLOSSY, GLOSSY), (SEEN_THROUGH_GLASS, TRANSMISSION)):
        flags = flags + flag * ((g.object_visibility[g.object[triangle]] & kind_of_ray) > 0)
    flags = flags + GLOSSY_ONLY * ((g.object_visibility[g.object[triangle]] & ray_kind) == 0)
    flags = flags + FRONT_OUT * (side > 0) + BACK_OUT * (side < 0)
    return triangle, material, flags, radiance, radiance * (2 * np.pi * area)[:, None], bounds, table


def lamp_tables(scene: Scene, ray_kind: int, light_group: np.ndarray) -> LampTables:
    """The analytic lamps that shine and are visible to rays of `ray_kind`; light_group: (L,) int32, of the scene's lamps."""
    source, kind, flags, radiance, _, _, lamps, _ = _lamps(scene, ray_kind, np.zeros((2, 3), np.float32))
    return LampTables(
        kind.astype(np.int32),
        flags.astype(np.int32),
        radiance.astype(np.float32),
        lamps,
        light_group[source],
        scene.lamps.receivers[source],
    )


def build_emitters(scene: Scene, ray_kind: int = DIFFUSE, threads: int = 0, groups: LightGroups | None = None) -> Emitters:
    """Tables of everything in the scene that emits light towards receivers hit by rays of `ray_kind`.

    groups: the light groups to tell apart, None for none.

    Lamps, world and objects that are not visible to such rays, and lamps without power, are left out, but for those that glossy surfaces
    reflect; a lamp whose emission is not finite is left out with a warning.
    """
    reflected = GLOSSY if (scene.materials.tables.flags & GLOSSY_LOBE).any() else 0
    f = np.float32
    groups = LightGroups.one(scene) if groups is None else groups
    box = _box(scene)
    source, kind, flags, radiance, flux, bounds, lamps, maps = _lamps(scene, ray_kind, box, threads, reflected)
    spheres = np.flatnonzero((kind == POINT) | (kind == SPOT))
    lamps[spheres, WITHIN] = share_within(scene.geometry, lamps[spheres, POSITION : POSITION + 3], lamps[spheres, RADIUS], threads)
    triangle, material, mesh_flags, mesh_radiance, mesh_flux, mesh_bounds, shapes = _mesh(scene, ray_kind, reflected, threads)
    world = no_world()
    object_receivers, object_blockers = object_links(scene)
    linked = scene.lamps.receivers[source], scene.lamps.blockers[source]
    parts = [(kind, flags, radiance, flux, bounds, groups.lamps[source], *linked)]
    if scene.world.visibility & (ray_kind | reflected) and (scene.world.radiance > 0).any():
        world, mean, world_flux = world_table(scene.world.radiance, box, scene.world.sought, scene.world.portals)
        world_flags = CASTS_SHADOW + SEEN_BY_GLOSSY * bool(scene.world.visibility & GLOSSY)
        world_flags += SEEN_THROUGH_GLASS * bool(scene.world.visibility & TRANSMISSION)
        world_flags += GLOSSY_ONLY * (not scene.world.visibility & ray_kind)
        parts.append(
            (np.array([WORLD]), np.array([world_flags]), mean[None], world_flux[None], np.zeros((1, COLUMNS)), [groups.world], [-1], [-1])
        )
    m, shining = len(triangle), scene.geometry.object[triangle]
    linked = object_receivers[shining], object_blockers[shining]
    parts.append((np.full(m, TRIANGLE), mesh_flags, mesh_radiance, mesh_flux, mesh_bounds, groups.objects[shining], *linked))
    kind, flags, radiance, flux, bounds, light_group, receivers, blockers = (np.concatenate(columns) for columns in zip(*parts))
    flags = flags | LINKED * (receivers >= 0)

    distant = np.flatnonzero((kind == SUN) | (kind == WORLD))
    analytic = np.flatnonzero((kind != SUN) & (kind < WORLD))
    triangles = np.flatnonzero(kind == TRIANGLE)
    if len(analytic) + m <= FEW:
        single, members = np.concatenate([analytic, triangles]), np.zeros(0, np.int64)
    elif len(analytic) <= FEW:
        single, members = analytic, triangles
    else:
        single, members = np.zeros(0, np.int64), np.concatenate([analytic, triangles])
    sampled = np.concatenate([single, distant, [-1] if len(members) else []])
    own = np.intersect1d(np.flatnonzero(small_lamps(kind[: len(lamps)], lamps, box)), sampled).astype(int)
    if len(own) <= FEW:
        flags[own] |= SHARP
    parted = is_parted(scene.geometry)
    return Emitters(
        kind=kind.astype(np.int32),
        flags=flags.astype(np.int32),
        source=source,
        radiance=radiance.astype(f),
        flux=flux,
        lamps=lamps,
        maps=maps,
        first_triangle=len(kind) - m,
        shapes=shapes,
        triangle=triangle,
        material=material,
        world=world,
        tree=light_tree(bounds, members),
        groups=sampled.astype(np.int32),
        emission_cdf=cumulative(shares(flux, flags), np.float64) if len(kind) else np.zeros(1),
        box=box,
        focus=np.zeros((0, 2, 3), np.float32),
        drawn=np.ones(1, np.float32),
        around=0,
        aims=np.zeros((0, 4), np.float32),
        cutouts=bool((scene.materials.tables.flags & TRANSPARENT).any()),
        told=parted or bool((scene.materials.tables.flags & TELLING).any()),
        parted=parted,
        light_group=light_group.astype(np.int32),
        object_light_group=groups.objects,
        light_groups=len(groups.names),
        receivers=receivers.astype(np.int32),
        receiver_sets=receiver_sets(scene.geometry),
        shadow_kinds=shadow_kinds(blockers, scene.geometry, (kind == WORLD) & (not world.varies)),
        vertices=scene.geometry.vertices,
        triangles=scene.geometry.triangles,
        attributes=scene.geometry.attributes,
        materials=scene.materials.tables,
    )
