"""Small scenes built by hand, and what Cycles makes of them."""

import math
from collections.abc import Callable

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest
from mathutils import Matrix

from lumigate.addon.extract import extract_scene


class Stage:
    """An empty Blender scene with a camera, and short ways to fill it."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.camera = self.link("Camera", bpy.data.cameras.new("Camera"))
        self.scene.camera = self.camera
        self.scene.render.resolution_x = self.scene.render.resolution_y = 16
        self.scene.render.resolution_percentage = 100

    def link(self, name: str, data: bpy.types.ID | None, matrix: Matrix | None = None) -> bpy.types.Object:
        obj = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(obj)
        if matrix is not None:
            obj.matrix_world = matrix
        return obj

    def mesh(self, name: str, vertices, faces, *materials: str | None, smooth: bool = False) -> bpy.types.Object:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([tuple(v) for v in vertices], [], [tuple(f) for f in faces])
        mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
        for material in materials:
            mesh.materials.append(material and self.material(material))
        return self.link(name, mesh)

    def material(self, name: str) -> bpy.types.Material:
        return bpy.data.materials.get(name) or bpy.data.materials.new(name)

    def cube(self, name: str = "Cube", *materials: str | None) -> bpy.types.Object:
        """A cube from -1 to 1 of six quads, normals outwards."""
        corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return self.mesh(name, corners, faces, *materials)

    def lamp(self, kind: str, matrix: Matrix | None = None, **settings) -> bpy.types.Object:
        light = bpy.data.lights.new(kind.title(), kind)
        for name, value in settings.items():
            setattr(light, name, value)
        return self.link(kind.title(), light, matrix)

    def nodes(self, data: bpy.types.Light | bpy.types.World | bpy.types.Material) -> bpy.types.ShaderNodeTree:
        if bpy.app.version < (5, 0):
            data.use_nodes = True
        return data.node_tree

    def world(self) -> bpy.types.World:
        self.scene.world = bpy.data.worlds.new("World")
        self.nodes(self.scene.world)
        return self.scene.world

    def receiver(self) -> None:
        """A white diffuse square metre around the origin, facing up, that fills the picture."""
        floor = self.mesh("Floor", [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2, 3)], "White")
        material = floor.data.materials[0]
        tree = self.nodes(material)
        tree.nodes.clear()
        diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
        diffuse.inputs["Color"].default_value = 1, 1, 1, 1
        tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
        self.camera.location = 0, 0, 0.1
        self.camera.data.type, self.camera.data.ortho_scale, self.camera.data.clip_start = "ORTHO", 1, 0.01

    @property
    def pixel_points(self) -> np.ndarray:
        """(N * N, 3) centres of the receiver's pixels, rows from the top."""
        n = self.scene.render.resolution_x
        x = (np.arange(n) + 0.5) / n - 0.5
        return np.stack([np.tile(x, n), np.repeat(-x, n), np.zeros(n * n)], axis=1)

    def extract(self, **options):
        return extract_scene(self.scene, **options)

    def irradiance(self, path: str, samples: int = 64) -> np.ndarray:
        """(N * N, 3) direct irradiance of the receiver by Cycles."""
        return math.pi * self.radiance(path, samples).reshape(-1, 3)

    def radiance(self, path: str, samples: int = 64) -> np.ndarray:
        """(H, W, 3) combined radiance without bounces by Cycles."""
        render, cycles = self.scene.render, self.scene.cycles
        render.engine = "CYCLES"
        cycles.device = "CPU"
        cycles.samples = samples
        cycles.max_bounces = 0
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
        cycles.light_sampling_threshold = 0
        cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
        render.threads_mode, render.threads = "FIXED", 2
        settings = render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "IMAGE"
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
        render.filepath = path
        bpy.ops.render.render(write_still=True)
        return oiio.ImageBuf(path).get_pixels(oiio.FLOAT)[..., :3]


@pytest.fixture
def stage() -> Stage:
    return Stage()


@pytest.fixture
def cycles_irradiance(stage: Stage, tmp_path) -> Callable[[], np.ndarray]:
    """Cycles' irradiance of the stage's receiver."""
    return lambda samples=64: stage.irradiance(str(tmp_path / "cycles.exr"), samples)
