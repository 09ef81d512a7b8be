"""Worlds that only Cycles can evaluate, rendered to a panorama.

Runs in the open file, where it leaves nothing behind, or in a process of its own when a render is
under way (Blender cannot render inside of a render): this file is then the script of that process
and imports nothing of the package.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

# Sky models that have a sun disc.
_DISC_MODELS = {"NISHITA", "SINGLE_SCATTERING", "MULTIPLE_SCATTERING"}
# What a light path is taken to be: the ray that left a diffuse surface, or that of the camera.
DIFFUSE_RAY = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Depth": 1.0, "Diffuse Depth": 1.0, "Ray Length": 1e10}
CAMERA_RAY = {"Is Camera Ray": 1.0, "Ray Length": 1e10}
_SUN_PIXELS, _SUN_SAMPLES = 32, 64


def render_panorama(
    world: bpy.types.World, frame: int, width: int, height: int, ray: dict[str, float] = DIFFUSE_RAY
) -> tuple[np.ndarray, np.ndarray]:
    """(height, width, 3) float32 radiance, row 0 at the top, and the suns that it leaves out, as rows (K, 7) float64:
    direction, irradiance (W/m^2) on a plane that faces it, and diameter (rad).

    Each pixel is the radiance of its middle.  `world` is no evaluated one.  ray: what Light Path nodes tell, by output; 0 for the others.
    """
    with tempfile.TemporaryDirectory() as folder, _stage(world, frame, ray) as (scene, copy):
        path = Path(folder) / "world.exr"
        discs = [node for node in all_nodes(copy.node_tree) if _has_disc(node)] if copy.node_tree else []
        for node in discs:
            node.sun_disc = False
        radiance = _shoot(scene, (width, height), 1, path)
        suns = [_measure_sun(scene, node, path) for node in discs]
    return radiance, np.array([sun for sun in suns if sun[3:6].any()]).reshape(-1, 7)


def render_panorama_apart(
    world: bpy.types.World, frame: int, width: int, height: int, ray: dict[str, float] = DIFFUSE_RAY
) -> tuple[np.ndarray, np.ndarray]:
    """`render_panorama` in a process of its own.

    Raises:
        RuntimeError: the process failed; the message is the last line it printed.
    """
    with tempfile.TemporaryDirectory() as folder:
        task = Path(folder) / "task.json"
        library = Path(folder) / "world.blend"
        bpy.data.libraries.write(str(library), {world}, path_remap="ABSOLUTE")
        task.write_text(json.dumps({"world": world.name, "frame": frame, "width": width, "height": height, "ray": ray}))
        blender = [bpy.app.binary_path, "--background", "--factory-startup", "--python-exit-code", "1", "--python", __file__, "--"]
        command = blender if bpy.app.binary_path else [sys.executable, __file__]
        run = subprocess.run([*command, folder], capture_output=True, text=True, check=False)
        if run.returncode != 0:
            raise RuntimeError((run.stderr.strip() or run.stdout.strip()).rsplit("\n", 1)[-1])
        with np.load(Path(folder) / "panorama.npz") as stored:
            return stored["radiance"], stored["suns"]


@contextmanager
def _stage(world: bpy.types.World, frame: int, ray: dict[str, float]):
    """A scene with nothing but a camera and a copy of the world and its node groups, gone afterwards."""
    had_result = "Render Result" in bpy.data.images
    scene = bpy.data.scenes.new("Lumigate world")
    data = bpy.data.cameras.new("Lumigate world")
    camera = bpy.data.objects.new("Lumigate world", data)
    copy = world.copy()
    groups = {}
    try:
        scene.collection.objects.link(camera)
        scene.camera = camera
        scene.world = copy
        scene.frame_set(frame)
        copy.cycles_visibility.camera = True
        copy.cycles.sampling_method = "NONE"  # nothing here is lit by it, and its map takes longer than the picture
        if copy.node_tree is not None:
            _own_groups(copy.node_tree, groups)
            for tree in (copy.node_tree, *groups.values()):
                _unlink_hidden(tree)
                _freeze_light_path(tree, ray)
        scene.render.engine = "CYCLES"
        scene.render.resolution_percentage = 100
        scene.render.use_compositing = scene.render.use_sequencer = False
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "IMAGE"
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.sample_clamp_direct = 0
        cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
        yield scene, copy
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(camera)
        bpy.data.cameras.remove(data)
        bpy.data.worlds.remove(copy)
        for group in groups.values():
            bpy.data.node_groups.remove(group)
        if not had_result and "Render Result" in bpy.data.images:
            bpy.data.images.remove(bpy.data.images["Render Result"])


def _unlink_hidden(tree: bpy.types.ShaderNodeTree) -> None:
    """Remove the links to sockets that are not there for what their node is set to: Cycles ignores them in the user's tree, but not in a copy of it."""
    for link in [link for link in tree.links if link.to_socket.is_unavailable]:
        tree.links.remove(link)


def _own_groups(tree: bpy.types.ShaderNodeTree, copies: dict[bpy.types.ShaderNodeTree, bpy.types.ShaderNodeTree]) -> None:
    """Put copies in the place of the groups in a tree, and of those in them; `copies` by what they are of."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            group = node.node_tree
            if group not in copies:
                copies[group] = group.copy()
                _own_groups(copies[group], copies)
            node.node_tree = copies[group]


def _freeze_light_path(tree: bpy.types.ShaderNodeTree, ray: dict[str, float]) -> None:
    """Replace what Light Path nodes say of the ray that is traced by what they say of another."""
    for node in [node for node in tree.nodes if node.type == "LIGHT_PATH"]:
        for output in node.outputs:
            for link in list(output.links):
                value = tree.nodes.new("ShaderNodeValue").outputs[0]
                value.default_value = ray.get(output.name, 0.0)
                tree.links.new(value, link.to_socket)


def all_nodes(tree: bpy.types.ShaderNodeTree) -> Iterator[bpy.types.Node]:
    """The nodes of a tree and of the groups in it, each once."""
    trees = [tree]
    for each in trees:
        for node in each.nodes:
            yield node
            if node.type == "GROUP" and node.node_tree is not None and node.node_tree not in trees:
                trees.append(node.node_tree)


def _has_disc(node: bpy.types.Node) -> bool:
    """Whether a node draws a sun disc in a direction that is known: these models have no input, and what is linked to a hidden one is ignored."""
    if node.type != "TEX_SKY" or node.sky_type not in _DISC_MODELS or not node.sun_disc:
        return False
    return not any(socket.is_linked and not socket.is_unavailable for socket in node.inputs)


def _shoot(
    scene: bpy.types.Scene, size: tuple[int, int], samples: int, path: Path, sun: tuple[np.ndarray, float] | None = None
) -> np.ndarray:
    """Render what the camera sees, all around or `sun` = (direction, field of view): (H, W, 3) float32."""
    import OpenImageIO as oiio  # part of Blender

    camera, data = scene.camera, scene.camera.data
    if sun is None:
        data.type = "PANO"
        (data if hasattr(data, "panorama_type") else data.cycles).panorama_type = "EQUIRECTANGULAR"
        camera.rotation_euler = math.pi / 2, 0, -math.pi / 2  # looks along +x, as an environment texture does
    else:
        from mathutils import Vector

        data.type, data.angle = "PERSP", sun[1]
        camera.rotation_euler = Vector(sun[0]).to_track_quat("-Z", "Y").to_euler()
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.cycles.samples = samples
    scene.cycles.filter_width = 0.01 if samples == 1 else 1.0  # a single sample belongs in the middle of its pixel
    scene.render.filepath = str(path)
    scene.render.use_file_extension = False
    bpy.ops.render.render(scene=scene.name, write_still=True)
    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)[..., :3]
    return np.ascontiguousarray(np.nan_to_num(pixels, nan=0, posinf=0, neginf=0))


def _measure_sun(scene: bpy.types.Scene, node: bpy.types.Node, path: Path) -> np.ndarray:
    """The row (7,) of a disc: the sky with it less the sky without, through a telescope."""
    elevation, rotation = node.sun_elevation, node.sun_rotation
    direction = np.array([math.sin(rotation) * math.cos(elevation), math.cos(rotation) * math.cos(elevation), math.sin(elevation)])
    view = direction, 1.3 * node.sun_size
    size = _SUN_PIXELS, _SUN_PIXELS
    without = _shoot(scene, size, _SUN_SAMPLES, path, view)
    node.sun_disc = True
    with_disc = _shoot(scene, size, _SUN_SAMPLES, path, view)
    node.sun_disc = False
    half = math.tan(0.5 * view[1])
    x = half * (2 * (np.arange(_SUN_PIXELS) + 0.5) / _SUN_PIXELS - 1)
    # A pixel at (x, y) in the plane at distance 1 has the solid angle dx dy / r^3, and the cosine 1 / r.
    weight = (2 * half / _SUN_PIXELS) ** 2 / (1 + x[:, None] ** 2 + x**2) ** 2
    irradiance = np.maximum(((with_disc - without) * weight[..., None]).sum((0, 1), dtype=np.float64), 0)
    return np.array([*direction, *irradiance, node.sun_size], np.float64)


def _main(folder: Path) -> None:
    """Do the task that `render_panorama_apart` left in a folder."""
    task = json.loads((folder / "task.json").read_text())
    with bpy.data.libraries.load(str(folder / "world.blend")) as (_, wanted):
        wanted.worlds = [task.pop("world")]
    radiance, suns = render_panorama(wanted.worlds[0], **task)
    np.savez(folder / "panorama.npz", radiance=radiance, suns=suns)


if __name__ == "__main__":
    _main(Path(sys.argv[-1]))
