"""Materials that show a lightmap, and the way back to those before."""

from __future__ import annotations

import math
from collections.abc import Iterable

import bpy

# Custom properties of a material made here: the one that it stands for, and how the slot was linked.
_ORIGINAL, _LINK = "lumigate_original", "lumigate_link"
_ADDED_SLOT = "lumigate_added_slot"  # of a mesh that had no slot
_GREY = (0.8, 0.8, 0.8, 1.0)


def set_up(ob: bpy.types.Object, image: bpy.types.Image, layer: str, content: str, scale: float = 1.0) -> None:
    """Let every material slot of an object show `image`, on the UV map `layer`.

    content: a key of `core.lightmaps.CONTENTS`.  `full` and `irradiance` shine by themselves and need no lamp, `indirect` is added to
    what the lamps give.  scale: what the image's values are to be multiplied by.  The materials themselves stay as they are: copies
    take their place in the object's slots, until `take_down`.
    """
    take_down([ob])
    if not ob.material_slots:
        ob.data.materials.append(None)
        ob.data[_ADDED_SLOT] = True
    for slot in ob.material_slots:
        original, link = slot.material, slot.link
        copy = original.copy() if original is not None else _plain_material()
        copy.name = f"{original.name if original else 'Material'} lightmap {ob.name}"
        if original is not None:
            copy[_ORIGINAL] = original
        copy[_LINK] = link
        _shine(copy.node_tree, image, layer, content, scale)
        slot.link = "OBJECT"
        slot.material = copy


def take_down(objects: Iterable[bpy.types.Object]) -> int:
    """Give the objects' slots their materials from before `set_up`; the number of objects that had been set up."""
    count = 0
    for ob in objects:
        copies = [slot.material for slot in ob.material_slots if slot.material is not None and _LINK in slot.material]
        for slot in ob.material_slots:
            copy = slot.material
            if copy is None or _LINK not in copy:
                continue
            original, link = original_of(copy), copy[_LINK]
            slot.material = None if link == "DATA" else original
            slot.link = link
        for copy in dict.fromkeys(copies):
            if copy.users == 0:
                bpy.data.materials.remove(copy)
        if ob.type == "MESH" and ob.data.get(_ADDED_SLOT):
            ob.data.materials.clear()
            del ob.data[_ADDED_SLOT]
        count += bool(copies)
    return count


def original_of(material: bpy.types.Material | None) -> bpy.types.Material | None:
    """The material that a slot had before `set_up`."""
    return material if material is None or _LINK not in material else material.get(_ORIGINAL)


def _plain_material() -> bpy.types.Material:
    material = bpy.data.materials.new("Material")
    if material.node_tree is None:
        material.use_nodes = True
    return material


def _shine(tree: bpy.types.NodeTree, image: bpy.types.Image, layer: str, content: str, scale: float) -> None:
    """Replace, or add to, what a tree's outputs show by the light of a lightmap."""
    nodes, links = tree.nodes, tree.links
    place = nodes.new("ShaderNodeUVMap")
    place.uv_map = layer
    texture = nodes.new("ShaderNodeTexImage")
    texture.image, texture.extension = image, "EXTEND"
    links.new(place.outputs["UV"], texture.inputs["Vector"])
    light = texture.outputs["Color"]
    if content != "full":
        scale /= math.pi  # irradiance times albedo / pi is radiance
        light = _times_color(tree, light)
    # A black Principled node with emission is what the glTF exporter knows.
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    shader.inputs["Emission Strength"].default_value = scale
    links.new(light, shader.inputs["Emission Color"])
    for output in [node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial"]:
        surface, shown = output.inputs["Surface"], shader.outputs[0]
        if content == "indirect" and surface.is_linked:
            both = nodes.new("ShaderNodeAddShader")
            links.new(surface.links[0].from_socket, both.inputs[0])
            links.new(shown, both.inputs[1])
            shown = both.outputs[0]
        links.new(shown, surface)


def _times_color(tree: bpy.types.NodeTree, light: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The light times the surface's colour, as the tree's first node with a base colour has it."""
    product = tree.nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    tree.links.new(light, product.inputs[0])
    colors = [
        socket for node in tree.nodes for socket in node.inputs if socket.name in ("Base Color", "Color") and node.type.startswith("BSDF")
    ]
    if not colors:
        product.inputs[1].default_value = _GREY[:3]
    elif colors[0].is_linked:
        tree.links.new(colors[0].links[0].from_socket, product.inputs[1])
    else:
        product.inputs[1].default_value = colors[0].default_value[:3]
    return product.outputs[0]
