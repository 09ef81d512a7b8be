"""Textures that nobody needs, through Blender: of materials on no triangle, and those that are in the cache of bakes already."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy

from ...core.scene import Scene
from ..sources import extract
from ..stress.offsets import offset_room

TEXTURES = 8  # of materials that are not needed
Extraction = Callable[[], Scene]


def spare(size: tuple[int, int], side: int) -> tuple[Extraction, Extraction]:
    """The stress room with a sheet outside of it that wears one of nine materials, and the same with all of them on triangles.

    Eight of the materials have a texture of `side` pixels.
    """

    def extraction(worn: bool) -> Scene:
        offset_room(0.0)
        count = TEXTURES + 1
        sheet = bpy.data.meshes.new("Sheet")
        sheet.from_pydata([(5 + 0.1 * k + x, y, 5) for k in range(count) for x, y in ((0, 0), (0.1, 0), (0, 0.1))], [], [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(count)])  # fmt: skip
        for k in range(count):
            sheet.materials.append(_textured(k, side) if k else bpy.data.materials.new("Plain"))
        sheet.polygons.foreach_set("material_index", list(range(count)) if worn else [0] * count)
        bpy.context.scene.collection.objects.link(bpy.data.objects.new("Sheet", sheet))
        return extract(bpy.context.scene, camera=None, size=size, frame=None)

    return lambda: extraction(False), lambda: extraction(True)


def _textured(k: int, side: int) -> bpy.types.Material:
    """A diffuse material of a texture of its own."""
    material, tree, output = _empty_material(f"Textured {k}")
    diffuse, texture = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "TexImage"))
    texture.image = bpy.data.images.new(f"Texture {k}", side, side)
    tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material


def _empty_material(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree, bpy.types.Node]:
    """A material, its node tree and the output in it."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender before 5
        material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree, material.node_tree.nodes.new("ShaderNodeOutputMaterial")


def baked(size: tuple[int, int]) -> tuple[Extraction, Extraction]:
    """The stress room in a pattern that only Cycles can compute: with the user's cache of bakes, and with an empty one."""

    def extraction() -> Scene:
        offset_room(0.0)
        material, tree, output = _empty_material("Gabor")
        diffuse, pattern = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "TexGabor"))
        tree.links.new(pattern.outputs["Value"], diffuse.inputs["Color"])
        tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
        bpy.data.objects["Room"].data.materials[2] = material
        return extract(bpy.context.scene, camera=None, size=size, frame=None)

    def anew() -> Scene:
        with _empty_cache():
            return extraction()

    return extraction, anew


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Bakes go into a folder that is there for so long."""
    before = os.environ.get("XDG_CACHE_HOME")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        try:
            yield
        finally:
            os.environ.pop("XDG_CACHE_HOME") if before is None else os.environ.update(XDG_CACHE_HOME=before)
