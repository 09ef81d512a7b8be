"""What the material compiler and the scene extraction say to each other.

The extraction hands in each material with the objects that use it; the compiler hands back the tables
and, for every material, the attributes that its program reads.  The extraction fills slot k of
`Geometry.attributes` for the triangles of a material with that material's k-th request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ...core.scene import Materials

if TYPE_CHECKING:
    import bpy

# Kinds of `AttributeRequest`; the fourth component is 1 unless said otherwise.
UV = "uv"  # UV map `name`, '' is the one active for render; (u, v, 0)
COLOR = "color"  # colour attribute `name`, '' is the one active for render; linear RGB and alpha
ATTRIBUTE = "attribute"  # geometry attribute `name` of any type and domain (a float f is (f, f, f)); colours linear, with alpha
GENERATED = "generated"  # undeformed texture space, 0..1 across the bounding box, as Texture Coordinate's Generated
OBJECT = "object"  # position in the space of the object `name`, '' is the object itself
NORMAL = "normal"  # shading normal in the space of the object
WORLD_POSITION = "world_position"  # true world position (the scene's origin not taken off)
WORLD_NORMAL = "world_normal"  # shading normal in world space
FACE_NORMAL = "face_normal"  # geometric normal in world space
RAISED = "raised"  # in world space what a step of 1 along the shading normal is in that of the object
TANGENT = "tangent"  # MikkTSpace tangent of UV map `name` in world space, the sign of the bitangent in w
OBJECT_LOCATION = "object_location"  # world location of the object's origin
OBJECT_COLOR = "object_color"  # `Object.color`, RGB and alpha
OBJECT_INDEX = "object_index"  # (i, i, i) of `Object.pass_index`
OBJECT_RANDOM = "object_random"  # (r, r, r), `random_id` of the instance / 2**32
OBJECT_ATTRIBUTE = "object_attribute"  # custom property `name` of the object, else of its data, as Attribute node of type Object
INSTANCER_ATTRIBUTE = "instancer_attribute"  # `name` of the instance, its instancer or else the object, as Attribute node of type Instancer
INSTANCER_GENERATED = "instancer_generated"  # where an instance stands on its instancer, and its UV there; zeros for what is no instance
INSTANCER_UV = "instancer_uv"
INCOMING = "incoming"  # direction in which light leaves a lamp, in world space; known of lamps alone, and so is
LOCAL_INCOMING = "local_incoming"  # the same in the lamp's own space
PARAMETRIC = "parametric"  # Geometry's output of that name
BAKED = "baked"  # UV of the bake `name`: CompiledMaterials.baked_uvs[name][object name], (triangles of the mesh, 3, 2)

# Attributes that hair and points have besides Blender's, whose names no user gives: what Hair Info and Point Info read.
IS_STRAND = ".lumigate is strand"
INTERCEPT = ".lumigate intercept"
LENGTH = ".lumigate length"
THICKNESS = ".lumigate thickness"
RANDOM = ".lumigate random"

# What differs at the points that a bump's height is read at: as in Cycles all but normals, tangents and what objects have.
DISPLACED = frozenset({UV, COLOR, ATTRIBUTE, GENERATED, OBJECT, WORLD_POSITION, BAKED})


@dataclass(frozen=True)
class AttributeRequest:
    """One attribute a program reads at the corners of a triangle: what it is, and its name if it has one.

    Something absent on an object (no such UV map) is filled with zeros, as Cycles does.
    """

    kind: str
    name: str = ""


@dataclass(frozen=True)
class MaterialUse:
    """A material (None: an empty slot, Blender's default grey) and the evaluated objects that wear it."""

    material: bpy.types.Material | None
    objects: tuple[bpy.types.Object, ...] = ()


@dataclass(frozen=True)
class Shot:
    """What materials may ask of the render that they are in.

    frame: of the scene, which image sequences follow.  camera: the object's name, '' for none that stays where it is.
    window: left, right, bottom, top edge of its picture at distance 1 (m), or in metres if orthographic.
    owners: whose properties Attribute nodes of type View Layer read, in this order.
    """

    frame: int = 1
    camera: str = ""
    window: tuple[float, float, float, float] = (-0.5, 0.5, -0.5, 0.5)
    orthographic: bool = False
    owners: tuple[bpy.types.ViewLayer | bpy.types.ID, ...] = ()


@dataclass(frozen=True)
class LampUse:
    """A lamp whose nodes tell rays apart.

    light: evaluated.  name: of its object.  matrix: (4, 4) float64, to world space; axes: (3, 3), rows = its unit axes in world space.
    places: matrix_world of other objects by name, whose coordinates its nodes may ask for.
    """

    light: bpy.types.Light
    name: str
    matrix: np.ndarray
    axes: np.ndarray
    places: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class LampProgram:
    """What became of a `LampUse`: the number of its program among the materials, -1 for none, and its falloff as `core.scene.Lamps` has it."""

    number: int = -1
    falloff: tuple[float, float] = (0.0, 0.0)


@dataclass
class CompiledMaterials:
    """Tables of all materials, in the order of the uses.

    requests: for every material the attributes its program reads; its slot k is `requests[m][k]`.
    warnings: one line for each thing that is approximated, left out or baked.
    baked_uvs: see BAKED; per bake and object name, in the order of the evaluated mesh's `loop_triangles`.
    lamps: of each `LampUse`.
    unseen: numbers of the materials that do nothing to light.
    """

    materials: Materials
    requests: list[list[AttributeRequest]]
    warnings: list[str] = field(default_factory=list)
    baked_uvs: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    lamps: list[LampProgram] = field(default_factory=list)
    unseen: list[int] = field(default_factory=list)

    @property
    def slots(self) -> int:
        """K of `Geometry.attributes`: the most attributes that one material reads."""
        return max((len(r) for r in self.requests), default=0)
