"""Materials that show a lightmap, and the way back to those before."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

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
    from .materials.compile import uses_nodes  # with Numba, which takes a second to import

    take_down([ob])
    if not ob.material_slots:
        ob.data.materials.append(None)
        ob.data[_ADDED_SLOT] = True
    for slot in ob.material_slots:
        original, link = slot.material, slot.link
        copy = original.copy() if original is not None else _plain_material(_GREY)
        if not uses_nodes(copy):
            bpy.data.materials.remove(copy)
            copy = _plain_material(original.diffuse_color)
        copy.name = f"{original.name if original else 'Material'} lightmap {ob.name}"
        if original is not None:
            copy[_ORIGINAL] = original
        copy[_LINK] = link
        _shine(copy.node_tree, image, layer, content, scale)
        slot.link = "OBJECT"
        slot.material = copy


def can_wear(ob: bpy.types.Object) -> bool:
    """Whether an object's slots can be changed here, to stay: not those of one that is linked without an override."""
    return ob.library is None and (bool(ob.material_slots) or ob.data.library is None)


def take_down(objects: Iterable[bpy.types.Object]) -> int:
    """Give the objects' slots their materials from before `set_up`; the number of objects that had been set up."""
    objects = [ob for ob in objects if ob.library is None]
    count = 0
    for ob in objects:
        copies = _copies(ob)
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
        count += bool(copies)
    for mesh in {ob.data for ob in objects if ob.type == "MESH" and ob.data.get(_ADDED_SLOT)}:
        if mesh.users == 1 or not any(_copies(ob) for ob in bpy.data.objects if ob.data == mesh):
            mesh.materials.clear()
            del mesh[_ADDED_SLOT]
    return count


def _copies(ob: bpy.types.Object) -> list[bpy.types.Material]:
    """The materials in an object's slots that `set_up` has made."""
    return [slot.material for slot in ob.material_slots if slot.material is not None and _LINK in slot.material]


@contextmanager
def without_lightmaps() -> Iterator[None]:
    """Within, every object wears its materials from before `set_up`: what lightmaps shine with is light that lamps gave to an earlier bake."""
    objects = [ob for ob in bpy.data.objects if ob.library is None and _copies(ob)]
    with kept_set_up(objects):
        take_down(objects)
        yield


@contextmanager
def kept_set_up(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Whatever is set up within, afterwards the objects show the lightmaps that they showed before, or none."""
    before = [(ob, [(slot.link, slot.material) for slot in ob.material_slots], bool(ob.data.get(_ADDED_SLOT))) for ob in objects]
    copies = {copy for _, slots, _ in before for _, copy in slots if copy is not None and _LINK in copy and not copy.use_fake_user}
    for copy in copies:
        copy.use_fake_user = True  # `take_down` removes what nothing uses
    try:
        yield
    finally:
        take_down(objects)
        for ob, slots, added in before:
            if added and not ob.data.get(_ADDED_SLOT):
                ob.data.materials.append(None)
                ob.data[_ADDED_SLOT] = True
            for slot, (link, material) in zip(ob.material_slots, slots):
                if material in copies:
                    slot.link, slot.material = link, material
        for copy in copies:
            copy.use_fake_user = False


def is_shown_by_others(image: bpy.types.Image, objects: Iterable[bpy.types.Object]) -> bool:
    """Whether an object that is none of these has been set up with the image."""
    slots = (slot for ob in set(bpy.data.objects).difference(objects) for slot in ob.material_slots)
    made = (slot.material for slot in slots if slot.material is not None and _LINK in slot.material)
    return any(node.type == "TEX_IMAGE" and node.image == image for material in made for node in material.node_tree.nodes)


def original_of(material: bpy.types.Material | None) -> bpy.types.Material | None:
    """The material that a slot had before `set_up`."""
    return material if material is None or _LINK not in material else material.get(_ORIGINAL)


def _plain_material(color: Iterable[float]) -> bpy.types.Material:
    material = bpy.data.materials.new("Material")
    if material.node_tree is None:
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*tuple(color)[:3], 1.0)
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
    """The light times the colour of the surface that the tree's output shows."""
    product = tree.nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    tree.links.new(light, product.inputs[0])
    output = tree.get_output_node("ALL")
    if output is None or not output.inputs["Surface"].is_linked:
        product.inputs[1].default_value = _GREY[:3]
    else:
        _set_color(tree, product.inputs[1], output.inputs["Surface"])
    return product.outputs[0]


def _set_color(tree: bpy.types.NodeTree, to: bpy.types.NodeSocket, shader: bpy.types.NodeSocket) -> None:
    """Let `to` have the colour of the shader that is linked to a socket: mixed and added as shaders are, black where it reflects nothing."""
    links = tree.links
    node = shader.links[0].from_node if shader.is_linked else None
    while node is not None and node.type == "REROUTE":
        node = node.inputs[0].links[0].from_node if node.inputs[0].is_linked else None
    if node is not None and node.type == "MIX_SHADER":
        mix = tree.nodes.new("ShaderNodeMix")
        mix.data_type = "RGBA"
        factor, a, b = (
            next(socket for socket in mix.inputs if socket.identifier == name) for name in ("Factor_Float", "A_Color", "B_Color")
        )
        if node.inputs[0].is_linked:
            links.new(node.inputs[0].links[0].from_socket, factor)
        else:
            factor.default_value = node.inputs[0].default_value
        _set_color(tree, a, node.inputs[1])
        _set_color(tree, b, node.inputs[2])
        links.new(next(socket for socket in mix.outputs if socket.identifier == "Result_Color"), to)
    elif node is not None and node.type == "ADD_SHADER":
        total = tree.nodes.new("ShaderNodeVectorMath")
        _set_color(tree, total.inputs[0], node.inputs[0])
        _set_color(tree, total.inputs[1], node.inputs[1])
        links.new(total.outputs[0], to)
    else:
        colors = []
        if node is not None and node.type not in ("EMISSION", "BSDF_TRANSPARENT", "HOLDOUT"):
            colors = [socket for socket in node.inputs if socket.name in ("Base Color", "Color")]
        if not colors:
            color = _GREY if node is not None and node.type == "GROUP" else (0, 0, 0, 1)
            to.default_value = color[: len(to.default_value)]
        elif colors[0].is_linked:
            links.new(colors[0].links[0].from_socket, to)
        else:
            to.default_value = tuple(colors[0].default_value)[: len(to.default_value)]
