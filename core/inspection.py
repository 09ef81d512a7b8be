"""What a scene holds, what will be skipped and what will be wrong, before any ray is traced."""

from __future__ import annotations

import numpy as np

from .lamps import Emitters
from .lamps.tables import TRIANGLE
from .scene import ALL_RAYS, AREA, CONSTANT, EMISSIVE, POINT, SPOT, SUN, TRANSPARENT, Scene, Skipped
from .surfaces.layout import DIFFUSE as DIFFUSE_ALBEDO
from .surfaces.layout import TRANSLUCENCY

LAMP_KINDS = {POINT: "point", SPOT: "spot", SUN: "sun", AREA: "area"}
NO_LIGHT = "nothing in the scene gives light: add a lamp, an emissive material or a world colour"
MOST_ALBEDO = 1.001  # that no rounding of a colour explains
NO_GEOMETRY = "no triangle is left to be hit: only the world will be seen; check what is hidden from the render"


def _worn_by_objects(scene: Scene) -> np.ndarray:
    """(M,) bool: which of the compiled materials are not the programs of lamps."""
    own = np.ones(len(scene.materials.tables.flags), bool)
    own[scene.lamps.program[scene.lamps.program >= 0]] = False
    return own


def contents(scene: Scene, emitters: Emitters) -> dict:
    """Counts and sizes of what `scene` holds, as values of JSON."""
    geometry, tables, lamps, camera = scene.geometry, scene.materials.tables, scene.lamps, scene.camera
    arrays = (geometry.vertices, geometry.triangles, geometry.corner_normals, geometry.attributes, geometry.material, geometry.object)
    height, width = scene.world.radiance.shape[:2]
    low, high = emitters.box
    flags = tables.flags[_worn_by_objects(scene)]
    return {
        "frame": scene.frame,
        "view_layer": scene.view_layer,
        "triangles": len(geometry.triangles),
        "instances": len(geometry.object_names),
        "objects": len(set(geometry.object_names)),
        "geometry_mib": sum(array.nbytes for array in arrays) / 2**20,
        "extent_m": [float(side) for side in high - low],
        "materials": {
            "count": len(flags),
            "textured": int(((flags & CONSTANT) == 0).sum()),
            "emissive": int(((flags & EMISSIVE) != 0).sum()),
            "transparent": int(((flags & TRANSPARENT) != 0).sum()),
        },
        "textures": {"count": len(tables.texture_header), "mib": (tables.texels_u8.nbytes + tables.texels_f32.nbytes) / 2**20},
        "lamps": {kind: int((lamps.kind == code).sum()) for code, kind in LAMP_KINDS.items()},
        "emissive_triangles": int((emitters.kind == TRIANGLE).sum()),
        "world": {"image": [width, height], "mean_radiance": [float(v) for v in scene.world.radiance.mean(axis=(0, 1))]},
        "flux_w": [float(v) for v in emitters.flux.sum(axis=0)],
        "camera": {
            "name": camera.name,
            "kind": "orthographic" if camera.orthographic else "panoramic" if camera.panorama else "perspective",
            "size": [camera.width, camera.height],
            "border": list(camera.border),
        },
    }


def savings(scene: Scene, emitters: Emitters, samples: int) -> list[dict]:
    """Work that a render leaves out, as far as no ray is needed to know: `stage`, `what`, and its `share` of the stage (0 to 1).

    samples: shadow rays of a shading point to the emitters.
    """
    geometry, lamps, count = scene.geometry, len(scene.lamps), len(emitters.kind)
    dark = lamps - len(set(emitters.source.tolist()))
    hidden = np.count_nonzero(geometry.object_visibility[geometry.object] == 0)
    found = []
    if count > samples:
        found.append(("direct", f"{count:,} emitters share {samples} shadow rays a point by their light tree", 1 - samples / count))
    if dark:
        found.append(("lamps", f"{dark:,} of {lamps:,} lamps give no light", dark / lamps))
    if hidden:
        found.append(("rays", f"{hidden:,} triangles are hidden from every ray", hidden / len(geometry.triangles)))
    return [{"stage": stage, "what": what, "share": float(share)} for stage, what, share in found]


def foresee(scene: Scene, emitters: Emitters) -> tuple[list[Skipped], list[str]]:
    """What a render of `scene` will leave out, and what will be wrong with it, as far as no ray is needed to know."""
    geometry, tables = scene.geometry, scene.materials.tables
    shining = set(emitters.source.tolist())
    skipped = [Skipped("lamps", f"lamp '{name}' gives no light") for i, name in enumerate(scene.lamps.names) if i not in shining]
    worn = np.bincount(geometry.material, minlength=len(tables.flags)) > 0
    unused = np.flatnonzero(~worn & _worn_by_objects(scene))
    skipped += [Skipped("materials", f"material '{scene.materials.names[i]}' is on no triangle") for i in unused]
    unseen = np.flatnonzero(geometry.object_visibility & ALL_RAYS == 0)
    skipped += [Skipped("objects", f"object '{geometry.object_names[i]}' is hidden from every ray") for i in unseen]
    warnings = []
    if not len(geometry.triangles):
        warnings.append(NO_GEOMETRY)
    if not len(emitters.kind):
        warnings.append(NO_LIGHT)
    sent = sum(tables.constant[:, at : at + 3] for at in (DIFFUSE_ALBEDO, TRANSLUCENCY))
    black = ((tables.flags & CONSTANT) != 0) & (sent <= 0).all(axis=1)
    bright = np.where((tables.flags & CONSTANT) != 0, sent.max(axis=1), 0.0)
    warnings += [
        f"material '{scene.materials.names[i]}' has an albedo of {bright[i]:.3g}: it reflects more light than it receives, "
        "which grows with every bounce; keep its colour within 1"
        for i in np.flatnonzero(worn & (bright > MOST_ALBEDO))
    ]
    if worn.any() and black[worn].all():
        skipped.append(Skipped("vpls", "every albedo is black: there is no indirect light"))
    return skipped, warnings
