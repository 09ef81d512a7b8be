"""A grid of small planes, one material each: one render by Cycles gives the truth for all of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

import lumigate
from lumigate import sample_scenes
from lumigate.addon.engine import LumigateEngine
from lumigate.addon.materials import MaterialUse, Shot, compile_materials
from lumigate.addon.materials import requests as rq
from lumigate.core.layers import read_exr
from lumigate.core.surfaces import layout
from lumigate.core.surfaces.batch import evaluate_batch

PIXELS = 8  # per side of a plane
CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)])
UV_LOW, UV_SPAN = -0.73, 2.41  # beyond 0..1 on both sides, texels not aligned with pixels
TINT = np.array([(1, 0.2, 0.1, 1), (0.3, 0.9, 0.2, 0.5), (0.1, 0.4, 1, 0.25), (0.8, 0.8, 0.1, 0)])
WEIGHT = np.array([0.1, 0.4, 0.9, 0.6])
_PASSES = {
    "DiffCol": ("DiffCol", "Diffuse Color"),
    "Emit": ("Emit", "Emission"),
    "GlossCol": ("GlossCol", "Glossy Color"),
    "Normal": ("Normal", "Normal"),
    "Position": ("Position", "Position"),
    "TransCol": ("TransCol", "Transmission Color"),
}


@dataclass
class Compared:
    """One plane: Cycles' passes and the evaluator's surfaces at the same points, both (PIXELS**2, ...)."""

    passes: dict[str, np.ndarray]
    surfaces: np.ndarray
    cosine: float

    @property
    def diffuse(self) -> np.ndarray:
        """Reflected and transmitted, as Cycles' pass holds both."""
        return np.array([layout.diffuse_color(s, np.float32(self.cosine)) for s in self.surfaces]) + self.translucency

    @property
    def translucency(self) -> np.ndarray:
        return np.array([layout.translucency(s, np.float32(self.cosine)) for s in self.surfaces])

    @property
    def emission(self) -> np.ndarray:
        return self.surfaces[:, layout.EMISSION : layout.EMISSION + 3]

    @property
    def transparency(self) -> np.ndarray:
        return self.surfaces[:, layout.TRANSPARENCY : layout.TRANSPARENCY + 3]

    @property
    def refraction(self) -> np.ndarray:
        return self.surfaces[:, layout.REFRACTION : layout.REFRACTION + 3]

    @property
    def normal(self) -> np.ndarray:
        return self.surfaces[:, layout.NORMAL : layout.NORMAL + 3]


@dataclass
class Grid:
    """Materials by name; `compare` renders and evaluates them all."""

    materials: dict[str, tuple[bpy.types.Material, float, tuple[float, float]]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    flags: np.ndarray | None = None

    def add(self, name: str, build: Callable[[bpy.types.NodeTree, bpy.types.Node], None], angle: float = 0.0, scale=(1, 1)) -> None:
        """A plane turned by `angle` from the camera, whose tree `build(tree, output)` fills.

        scale: of the object, whose mesh is as much smaller.
        """
        material = bpy.data.materials.new(name)
        assert material.name == name, "Blender cuts names after 63 bytes"
        if material.node_tree is None:
            material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        build(tree, tree.nodes.new("ShaderNodeOutputMaterial"))
        self.materials[name] = material, angle, scale

    def emit(self, name: str, node_type: str, output: str | int = 0, **settings) -> None:
        """A plane that emits one output of one node; settings are properties, and inputs by name or index in `inputs`."""

        def build(tree, end):
            node = new_node(tree, node_type, **settings)
            outputs = node.outputs
            chosen = outputs[output] if isinstance(output, int) else next(s for s in outputs if output in (s.identifier, s.name))
            tree.links.new(chosen, tree.nodes.new("ShaderNodeEmission").inputs["Color"])
            tree.links.new(tree.nodes["Emission"].outputs[0], end.inputs["Surface"])

        self.add(name, build)

    def mean_surface(self, name: str) -> np.ndarray:
        """The surface of a material as light that is reflected on meets it."""
        tables = compile_materials([MaterialUse(self.materials[name][0])]).materials.tables
        zeros = np.zeros(1, np.int32)
        return evaluate_batch(tables, zeros, np.zeros((1, 1, 3, 4), np.float32), zeros, zeros, zeros)[0]

    def compare(self) -> dict[str, Compared]:
        columns = math.ceil(math.sqrt(len(self.materials)))
        for i, (name, (material, angle, scale)) in enumerate(self.materials.items()):
            obj = _plane(name, material, scale)
            # The hinge is the plane's middle line, so that its middle rows of pixels stay on it.
            half = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
            obj.rotation_euler = angle, 0, 0
            obj.location = i % columns, i // columns + 0.5 - half[0], -half[1]
        passes = _render(columns)
        uses = [MaterialUse(m, (bpy.data.objects[n],)) for n, (m, _, _) in self.materials.items()]
        found = compile_materials(uses, shot=Shot(bpy.context.scene.frame_current))
        self.warnings, self.flags = found.warnings, found.materials.tables.flags
        result = {}
        for i, (name, (_, angle, scale)) in enumerate(self.materials.items()):
            x, y = i % columns * PIXELS, i // columns * PIXELS
            mine = {p: a[y : y + PIXELS, x : x + PIXELS].reshape(PIXELS * PIXELS, -1) for p, a in passes.items()}
            cosine = math.cos(angle)
            # Cycles' sample lies near the pixel's centre, the Position pass says where.
            place = (mine["Position"] - np.array(bpy.data.objects[name].location))[:, :2] / (1, cosine)
            result[name] = Compared(mine, _evaluate(found, i, columns, angle, scale, place), cosine)
        return result


def new_node(tree, node_type, inputs=None, **settings):
    """A node with properties and input values set; an input given as a function is linked to `value(tree)`."""
    node = tree.nodes.new(node_type)
    for key, value in settings.items():
        setattr(node, key, value)
    for key, value in (inputs or {}).items():
        socket = node.inputs[key] if isinstance(key, int) else next(s for s in node.inputs if key in (s.identifier, s.name))
        if callable(value):
            tree.links.new(value(tree), socket)
        else:
            socket.default_value = value
    return node


def _plane(name, material, scale):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(*c, 0) for c in CORNERS / scale], [], [list(t) for t in TRIANGLES])
    mesh.materials.append(material)
    corner_of_loop = TRIANGLES.reshape(-1)
    for uv_name, flip in (("UVMap", False), ("Second", True)):
        uv = UV_LOW + UV_SPAN * CORNERS[corner_of_loop]
        mesh.uv_layers.new(name=uv_name).data.foreach_set("uv", (uv[:, ::-1] if flip else uv).astype(np.float32).ravel())
    tint = mesh.color_attributes.new("Tint", "FLOAT_COLOR", "CORNER")
    tint.data.foreach_set("color", TINT[corner_of_loop].astype(np.float32).ravel())
    mesh.attributes.new("Weight", "FLOAT", "POINT").data.foreach_set("value", WEIGHT.astype(np.float32))
    obj = bpy.data.objects.new(name, mesh)
    obj.scale = *scale, 1
    obj.color = (0.2, 0.4, 0.6, 0.8)
    obj.pass_index = 3
    obj["level"] = 0.7
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _attribute(request, index, columns, angle, scale):
    """(4 corners, 4) values of a request on a plane; its direction matters to the world's position and normal alone."""
    place = np.array([index % columns, index // columns])
    c, s = math.cos(angle), math.sin(angle)
    values = np.ones((4, 4))
    if request.kind == rq.UV or (request.kind == rq.ATTRIBUTE and request.name in ("UVMap", "Second")):
        uv = UV_LOW + UV_SPAN * CORNERS
        values[:, :2] = uv[:, ::-1] if request.name == "Second" else uv
        values[:, 2] = 0
    elif request.kind == rq.COLOR or request.name == "Tint":
        values[:] = TINT
    elif request.name == "Weight":
        values[:, :3] = WEIGHT[:, None]
    elif request.kind == rq.OBJECT:
        values[:, :2], values[:, 2] = CORNERS / scale, 0
    elif request.kind == rq.WORLD_POSITION:
        y = CORNERS[:, 1] - 0.5
        values[:, :3] = np.stack([place[0] + CORNERS[:, 0], place[1] + 0.5 + y * c, y * s], 1)
    elif request.kind == rq.GENERATED:
        values[:, :2], values[:, 2] = CORNERS, 0.5
    elif request.kind in (rq.WORLD_NORMAL, rq.FACE_NORMAL, rq.RAISED):  # no plane is scaled across
        values[:, :3] = 0, -s, c
    elif request.kind == rq.NORMAL:
        values[:, :3] = 0, 0, 1
    elif request.kind == rq.TANGENT:
        values[:, :3] = (0, 1, 0) if request.name == "Second" else (1, 0, 0)
        values[:, 3] = -1 if request.name == "Second" else 1
    elif request.kind == rq.OBJECT_LOCATION:
        values[:, :2], values[:, 2] = place, 0
    elif request.kind == rq.OBJECT_COLOR:
        values[:] = 0.2, 0.4, 0.6, 0.8
    elif request.kind == rq.OBJECT_INDEX:
        values[:, :3] = 3
    elif request.kind == rq.OBJECT_ATTRIBUTE:
        values[:, :3] = 0.7
    else:
        raise KeyError(request)
    return values


def _evaluate(found, index, columns, angle, scale, place):
    attributes = np.zeros((max(1, found.slots), 2, 3, 4), np.float32)
    for k, request in enumerate(found.requests[index]):
        attributes[k] = _attribute(request, index, columns, angle, scale)[TRIANGLES]
    found.materials.tables.constants[0] = 0, 0, 0, -1 / PIXELS  # the size of a pixel: see `surfaces.footprint`
    x, y = place.T
    # (0,0) (1,0) (1,1) below the diagonal, (0,0) (1,1) (0,1) above it
    below = x >= y
    u, v = np.where(below, x - y, x), np.where(below, y, y - x)
    materials = np.full(2, index, np.int32)
    return evaluate_batch(found.materials.tables, materials, attributes, np.where(below, 0, 1), u, v, math.cos(angle), threads=1)


def _render(columns):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = columns * PIXELS
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    layer = scene.view_layers[0]
    layer.use_pass_diffuse_color = layer.use_pass_emit = True
    layer.use_pass_glossy_color = layer.use_pass_transmission_color = layer.use_pass_normal = layer.use_pass_position = True
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", columns
    camera.location = columns / 2, columns / 2, 5
    scene.collection.objects.link(camera)
    scene.camera = camera
    bpy.ops.render.render()
    return _passes()


def _passes():
    settings = bpy.context.scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    path = f"{bpy.app.tempdir}grid.exr"
    bpy.data.images["Render Result"].save_render(path)
    found = {}
    file = oiio.ImageInput.open(path)
    part = 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, oiio.FLOAT)[::-1]
        for name, spellings in _PASSES.items():
            chosen = [i for i, c in enumerate(spec.channelnames) if c.split(".")[-2] in spellings]
            order = {"R": 0, "X": 0, "G": 1, "Y": 1, "B": 2, "Z": 2, "A": 3}
            if chosen:
                found[name] = pixels[..., sorted(chosen, key=lambda i: order[spec.channelnames[i][-1]])]
        part += 1
    file.close()
    return found


@pytest.fixture
def grid():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return Grid()


@pytest.fixture
def node():
    """`new_node`, for tests that build their own trees."""
    return new_node


@pytest.fixture
def cornell():
    """A Cornell box of 48x32 pixels and few samples that Lumigate renders, into a multilayer file; the add-on is registered meanwhile."""
    lumigate.register()
    scene = sample_scenes.build("cornell", detail="low")
    settings = scene.render
    settings.engine = LumigateEngine.bl_idname
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = 48, 32, 100
    image = settings.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    numbers = scene.lumigate
    numbers.vpls, numbers.pixel_samples, numbers.samples, numbers.gather = 256, 2, 2, 2
    yield scene
    lumigate.unregister()


@pytest.fixture
def rendered(tmp_path):
    """Renders by Blender's own button: (view layer) to its passes."""

    def passes(view_layer: str | None = None):
        assert bpy.ops.render.render() == {"FINISHED"}
        path = tmp_path / "passes.exr"
        bpy.data.images["Render Result"].save_render(str(path))
        return read_exr(path, view_layer)

    return passes
