"""The film: pixel filters and alpha, against Cycles on a shining square that stands askew before the sky."""

from dataclasses import replace

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest
from mathutils import Matrix

from lumigate.addon.extract.film import extract_film
from lumigate.core.film import Film
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings

SETTINGS = RenderSettings(method="importance-sampling", bounces=0, pixel_samples=256, denoise=False)


@pytest.fixture
def square(stage):
    """A square that shines, and a smaller one above it, turned against the pixels."""
    for name, size, height, color in (("Large", 0.6, 0.0, (1, 0.5, 0.2, 1)), ("Small", 0.2, 0.1, (0.1, 0.2, 0.9, 1))):
        corners = [(x * size, y * size, height) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        material = stage.mesh(name, corners, [(0, 1, 2, 3)], name).data.materials[0]
        tree = stage.nodes(material)
        tree.nodes.clear()
        emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
        emission.inputs["Color"].default_value = color
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        stage.scene.objects[name].matrix_world = Matrix.Rotation(0.4, 4, "Z")
    stage.world().node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.6, 0.9, 1)
    stage.camera.location = 0, 0, 1
    stage.camera.data.type, stage.camera.data.ortho_scale = "ORTHO", 1.6
    return stage


def by_cycles(scene, path):
    """Cycles' picture (16, 16, 4) with the scene's own film."""
    settings, cycles = scene.render, scene.cycles
    settings.engine, settings.filepath = "CYCLES", path
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", 1024, False, False
    if hasattr(settings.image_settings, "media_type"):
        settings.image_settings.media_type = "IMAGE"
    image = settings.image_settings
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGBA", "32"
    bpy.ops.render.render(write_still=True)
    return oiio.ImageBuf(path).get_pixels(oiio.FLOAT)


@pytest.mark.parametrize(
    ("name", "width", "transparent"),
    [("BOX", 1.5, False), ("GAUSSIAN", 1.5, False), ("BLACKMAN_HARRIS", 1.5, True), ("BLACKMAN_HARRIS", 3.0, True)],
)
def test_pixels_and_alpha_are_those_of_cycles(square, tmp_path, name, width, transparent):
    scene = square.scene
    scene.cycles.pixel_filter_type, scene.cycles.filter_width, scene.render.film_transparent = name, width, transparent
    expected = by_cycles(scene, str(tmp_path / "cycles.exr"))
    found = render(square.extract(), replace(SETTINGS, film=extract_film(scene))).layers["Combined"]
    assert found.shape[2] == (4 if transparent else 3)
    expected = expected[..., : found.shape[2]]
    assert np.abs(found - expected).max() < 0.06 and np.sqrt(((found - expected) ** 2).mean()) < 0.006
    assert found.mean() == pytest.approx(expected.mean(), rel=0.003)


def test_the_pixels_own_square_needs_no_table():
    assert len(Film("BOX", 1.0).offsets()) == 0
    with pytest.raises(ValueError, match="GAUSSIAN"):
        Film("TENT").offsets()


# Standard deviations for a width of one pixel; Cycles cuts the Gaussian at six of its own.
@pytest.mark.parametrize(("name", "spread"), [("BOX", 0.2887), ("GAUSSIAN", 0.25), ("BLACKMAN_HARRIS", 0.2770)])
def test_samples_spread_as_the_filter_does(name, spread):
    offsets = Film(name, 2.0).offsets().astype(float)
    assert np.allclose(offsets, -offsets[::-1], atol=1e-5) and (np.diff(offsets) > 0).all()
    middle = (offsets[1:] + offsets[:-1]) / 2
    assert np.sqrt((middle**2).mean()) == pytest.approx(2 * spread, rel=0.01)
