"""Cycles references: closed forms, the contract's sums, borders, the user's settings, the cache and the comparison."""

import io
import json

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest
from rich.console import Console

from lumigate import sample_scenes
from lumigate.core import metrics
from lumigate.core.errors import SceneError
from lumigate.core.layers import CONTRACT, Layers, read_exr, write_exr
from lumigate.headless import cache, reference
from lumigate.headless.compare import compare_files


def render(scene, *, threads=0, **settings):
    """(layers, stats) of a tiny reference."""
    tiny = {"spp": 16, "size": (16, 12), **settings}
    return reference.render_layers(scene, reference.ReferenceSettings(**tiny), threads=threads)


def node_scene(build_surface):
    """A closed cube around the camera with one material; `build_surface(tree)` returns the surface's socket."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=2)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.rotation_euler = (1.2, 0.1, 0.3)
    scene.collection.objects.link(camera)
    scene.camera = camera
    material = bpy.data.materials.new("Surface")
    if material.node_tree is None:  # Blender 4.5; a new material has a tree from 5.0 on
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.name = "Material Output"
    tree.links.new(build_surface(tree), output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    return scene


def sky(scene, colour, strength):
    """A world of one radiance, W/m2/sr."""
    scene.world = bpy.data.worlds.new("Sky")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*colour, 1)
    background.inputs["Strength"].default_value = strength


def furnace(glossy=False):
    """Emission 1 W/m2/sr and diffuse albedo .5; or half of that and a mirror of reflectance .5."""

    def surface(tree):
        emission, diffuse, total = (tree.nodes.new(f"Shader{kind}") for kind in ("NodeEmission", "NodeBsdfDiffuse", "NodeAddShader"))
        diffuse.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1)
        scattering = diffuse.outputs[0]
        if glossy:
            mirror, mix = tree.nodes.new("ShaderNodeBsdfGlossy"), tree.nodes.new("ShaderNodeMixShader")
            mirror.inputs["Color"].default_value = (1, 1, 1, 1)
            mirror.inputs["Roughness"].default_value = 0
            tree.links.new(diffuse.outputs[0], mix.inputs[1])
            tree.links.new(mirror.outputs[0], mix.inputs[2])
            scattering = mix.outputs[0]
        tree.links.new(scattering, total.inputs[0])
        tree.links.new(emission.outputs[0], total.inputs[1])
        return total.outputs[0]

    return node_scene(surface)


@pytest.fixture
def cornell():
    return sample_scenes.build("cornell", detail="low")


@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_furnace_is_its_closed_form(bounces):
    layers, _ = render(furnace(), spp=64, bounces=bounces)
    indirect = sum(0.5 ** (k + 1) for k in range(1, bounces + 1))
    means = {name: float(layers[name].mean()) for name in layers}
    # Over 12 seeds the means are right to .06 %, their standard deviation is .35 % or less.
    assert means["Emission"] == pytest.approx(1, rel=1e-5)
    assert means["Direct"] == pytest.approx(0.5, rel=0.01)
    assert means["DiffuseIndirect"] == pytest.approx(indirect, rel=0.015)
    assert means["Irradiance"] == pytest.approx(np.pi * indirect / 0.5, rel=0.015)
    assert means["GlossyIndirect"] == 0
    assert means["Albedo"] == pytest.approx(0.5, rel=1e-5)


def test_mirrors_do_not_count_as_diffuse_bounces():
    """With d diffuse and g mirrored, light with at most n diffuse bounces left is F(n) = (1 + d F(n-1)) / (1 - g), F(0) = 1."""
    layers, _ = render(furnace(glossy=True), spp=256, bounces=2)
    light = 1.0
    for _ in range(2):
        light = (1 + 0.25 * light) / (1 - 0.5)
    # Over 12 seeds the standard deviation of the mean is .6 %; a limit of 4 mirrors loses 5 %.
    assert layers["DiffuseIndirect"].mean() == pytest.approx(0.25 * (light - 1), rel=0.025)
    assert layers["GlossyIndirect"].mean() > 1


def test_layers_are_the_contract(cornell):
    layers, stats = render(cornell, bounces=2)
    assert tuple(layers) == CONTRACT
    assert layers.size == (16, 12)
    scale = float(layers["Combined"].mean())
    np.testing.assert_allclose(layers["Direct"] + layers["Indirect"] + layers["Emission"], layers["Combined"], atol=1e-4 * scale)
    np.testing.assert_array_equal(layers["DiffuseIndirect"] + layers["GlossyIndirect"], layers["Indirect"])
    lit = layers["Albedo"] > 0
    np.testing.assert_allclose((layers["Irradiance"] * layers["Albedo"])[lit], np.pi * layers["DiffuseIndirect"][lit], rtol=1e-5)
    assert not layers["Irradiance"][~lit].any()
    assert layers["DiffuseIndirect"].mean() > 0.01 * scale
    assert stats["seconds"]["render"] > 0 and stats["seconds_total"] == stats["seconds"]["render"]
    assert (stats["spp"], stats["bounces"], stats["size"]) == (16, 2, [16, 12])


def test_light_through_glass_and_fog_is_in_the_sum():
    """Nothing of Combined is lost, and what glass and fog scatter is no diffuse light."""

    def surface(tree):
        emission, glass, total = (tree.nodes.new(f"Shader{kind}") for kind in ("NodeEmission", "NodeBsdfGlass", "NodeAddShader"))
        fog = tree.nodes.new("ShaderNodeVolumeScatter")
        tree.links.new(fog.outputs[0], tree.nodes["Material Output"].inputs["Volume"])
        tree.links.new(emission.outputs[0], total.inputs[0])
        tree.links.new(glass.outputs[0], total.inputs[1])
        return total.outputs[0]

    scene = node_scene(surface)
    sky(scene, (1, 1, 1), 1)  # seen from inside, through the glass
    layers, _ = render(scene, spp=8)
    np.testing.assert_allclose(layers["Direct"] + layers["Indirect"] + layers["Emission"], layers["Combined"], rtol=1e-4)
    assert layers["Direct"].min() > 0 and layers["GlossyIndirect"].min() > 0
    assert not layers["DiffuseIndirect"].any()


def test_albedo_zero_and_the_world_give_no_irradiance(cornell):
    for thing in [thing for thing in cornell.objects if thing.type == "MESH"]:
        bpy.data.objects.remove(thing)
    sky(cornell, (0.25, 0.5, 1), 2)
    cornell.render.film_transparent = True
    cornell.cycles.film_exposure = 3
    layers, _ = render(cornell)
    np.testing.assert_allclose(layers["Emission"], np.broadcast_to([0.5, 1.0, 2.0], layers["Emission"].shape), rtol=1e-5)
    assert not layers["Irradiance"].any() and not layers["Indirect"].any()


def test_same_seed_same_picture_other_seed_independent_noise(cornell):
    first, again, other = (render(cornell, seed=seed)[0]["DiffuseIndirect"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert metrics.relmse(first, other) > 1e-3


@pytest.mark.parametrize("border", [(0, 0, 16, 12), (3, 2, 11, 9), (15, 11, 16, 12)])
def test_border_is_a_part_of_the_whole(cornell, border):
    whole, _ = render(cornell)
    part, _ = render(cornell, border=border)
    x0, y0, x1, y1 = border
    assert (part.offset, part.full_size) == ((x0, y0), (16, 12))
    for name in CONTRACT:
        np.testing.assert_array_equal(part[name], whole[name][y0:y1, x0:x1])


def test_the_scenes_own_region_is_rendered(cornell):
    render_settings = cornell.render
    render_settings.use_border = True
    render_settings.border_min_x, render_settings.border_max_x = 0.26, 0.77
    render_settings.border_min_y, render_settings.border_max_y = 0.1, 0.6
    part, _ = render(cornell)
    assert (part.offset, part.size) == ((4, 5), (8, 6))
    assert render_settings.use_border and not render_settings.use_crop_to_border


def everything(scene):
    """Every simple RNA value of what a reference touches."""
    view_layers = list(scene.view_layers)
    owners = [scene, scene.render, scene.cycles, scene.render.image_settings, *view_layers, *(layer.cycles for layer in view_layers)]
    owners += [c.dof for c in bpy.data.cameras]
    values = {}
    for i, owner in enumerate(owners):
        for prop in owner.bl_rna.properties:
            if prop.identifier == "use_nodes":  # deprecated in 5.x, and nothing of a reference's
                continue
            if prop.type in {"BOOLEAN", "INT", "FLOAT", "ENUM", "STRING"} and not prop.is_readonly:
                value = getattr(owner, prop.identifier)
                values[i, prop.identifier] = tuple(value) if getattr(prop, "is_array", False) else value
        values[i, "camera"] = getattr(owner, "camera", None)
    return values


def unusual_settings(scene):
    """A user's settings, each different from what a reference sets."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "16"
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_percentage, scene.render.use_motion_blur = 37, True
    scene.render.threads_mode, scene.render.threads = "FIXED", 3
    scene.cycles.samples, scene.cycles.seed, scene.cycles.sample_clamp_indirect = 7, 5, 2.5
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "GAUSSIAN", 2.0
    scene.view_layers[0].use_pass_position = False
    scene.view_layers[0].samples = 3
    scene.view_layers.new("Second")
    scene.camera.data.dof.use_dof = True
    scene.frame_set(4)


def test_the_users_settings_are_as_before(cornell):
    unusual_settings(cornell)
    before = everything(cornell)
    _, stats = render(cornell, frame=9, threads=1)
    assert everything(cornell) == before
    assert cornell.frame_current == 4
    assert len(stats["warnings"]) == 2 and "motion blur" in stats["warnings"][0] and "depth of field" in stats["warnings"][1]


def test_the_users_settings_are_as_before_after_an_error(cornell, monkeypatch):
    unusual_settings(cornell)
    before = everything(cornell)

    def fail(*_):
        raise SceneError("out of memory")

    monkeypatch.setattr(reference, "_render", fail)
    with pytest.raises(SceneError, match="out of memory"):
        render(cornell, frame=9)
    assert everything(cornell) == before


def test_settings_of_the_user_do_not_change_pixels(cornell):
    expected, _ = render(cornell)
    unusual_settings(cornell)
    cornell.camera.data.dof.aperture_fstop = 0.01
    got, _ = render(cornell, threads=1, frame=1)
    for name in CONTRACT:
        np.testing.assert_array_equal(got[name], expected[name])


# The protocol of design.md, sections 3 and 4, with values that a user's file may have instead.
PROTOCOL = {
    "render.film_transparent": (False, True),
    "render.use_motion_blur": (False, True),
    "render.use_compositing": (False, True),
    "cycles.use_denoising": (False, True),
    "cycles.use_adaptive_sampling": (False, True),
    "cycles.sample_clamp_direct": (0, 1),
    "cycles.sample_clamp_indirect": (0, 10),
    "cycles.blur_glossy": (0, 1),
    "cycles.light_sampling_threshold": (0, 0.01),
    "cycles.caustics_reflective": (True, False),
    "cycles.caustics_refractive": (True, False),
    "cycles.use_fast_gi": (False, True),
    "cycles.use_animated_seed": (False, True),
    "cycles.time_limit": (0, 1),
    "cycles.pixel_filter_type": ("BOX", "BLACKMAN_HARRIS"),
    "cycles.filter_width": (1, 1.5),
    "cycles.diffuse_bounces": (3, 8),
    "cycles.transparent_max_bounces": (1024, 8),
}


def test_cycles_renders_by_the_protocol_whatever_the_file_says(cornell, monkeypatch):
    fields = {name: (getattr(cornell, name.split(".")[0]), name.split(".")[1]) for name in PROTOCOL}
    for name, (_, users) in PROTOCOL.items():
        setattr(*fields[name], users)
    seen = {}
    original = reference._render

    def watched(*arguments):
        seen.update({name: getattr(*field) for name, field in fields.items()})
        return original(*arguments)

    monkeypatch.setattr(reference, "_render", watched)
    render(cornell, bounces=3)
    assert seen == {name: value for name, (value, _) in PROTOCOL.items()}


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"camera": "Nobody"}, r"no camera called 'Nobody'.*'Camera'"),
        ({"view_layer": "Nothing"}, r"no view layer called 'Nothing'"),
        ({"border": (0, 0, 17, 12)}, r"does not lie in the picture of 16x12"),
        ({"border": (5, 5, 5, 8)}, r"does not lie in the picture"),
        ({"size": (2, 2)}, r"2x2 pixels; both sides"),
    ],
)
def test_what_cannot_be_rendered_is_one_line(cornell, settings, line):
    before = everything(cornell)
    with pytest.raises(SceneError, match=line):
        render(cornell, **settings)
    assert everything(cornell) == before


def test_a_scene_without_camera_is_one_line(cornell):
    cornell.camera = None
    with pytest.raises(SceneError, match="no active camera"):
        render(cornell)


def test_denoised_layers_are_the_contract_and_nearer_to_the_truth(cornell):
    size = {"size": (48, 36), "bounces": 2}
    truth, _ = render(cornell, spp=512, seed=9, **size)
    noisy, _ = render(cornell, spp=8, **size)
    clean, stats = render(cornell, spp=8, denoise=True, **size)
    assert tuple(clean) == CONTRACT
    np.testing.assert_array_equal(clean["Albedo"], noisy["Albedo"])
    np.testing.assert_allclose(clean["Direct"] + clean["Indirect"] + clean["Emission"], clean["Combined"], rtol=1e-6)
    np.testing.assert_allclose(clean["Irradiance"] * clean["Albedo"], np.pi * clean["DiffuseIndirect"] * (clean["Albedo"] > 0), atol=1e-4)
    raw, denoised = (metrics.relmse(layers["DiffuseIndirect"], truth["DiffuseIndirect"]) for layers in (noisy, clean))
    assert denoised < raw / 4  # 1/11 to 1/19 over 6 seeds
    seconds = stats["seconds"]
    assert stats["seconds_total"] == seconds["render"] + seconds["denoise"]
    assert seconds["denoise"] >= seconds["denoise.DiffuseIndirect"] > 0


def test_one_layer_alone_can_be_denoised(cornell):
    noisy, _ = render(cornell, size=(32, 32))
    clean, stats = render(cornell, size=(32, 32), denoise=True, prefilter=True, denoised=("DiffuseIndirect",))
    assert "denoise.Direct" not in stats["seconds"]
    np.testing.assert_array_equal(clean["Direct"], noisy["Direct"])
    assert not np.array_equal(clean["DiffuseIndirect"], noisy["DiffuseIndirect"])


def test_file_is_read_back_as_written(cornell, tmp_path):
    stats = reference.render_reference(cornell, tmp_path / "r.exr", spp=4, size=(16, 12), seed=3)
    layers = read_exr(tmp_path / "r.exr")
    assert set(layers) == set(CONTRACT)
    assert layers.view_layer == cornell.view_layers[0].name
    assert layers.metadata["blender"] == bpy.app.version_string and "seed=3" in layers.metadata["settings"]
    assert stats["seconds"]["write"] > 0
    assert [p.name for p in tmp_path.iterdir()] == ["r.exr"]


def test_blender_reads_the_file_as_multilayer(cornell, tmp_path):
    reference.render_reference(cornell, tmp_path / "r.exr", spp=1, size=(8, 8))
    image = bpy.data.images.load(str(tmp_path / "r.exr"))
    if hasattr(cornell, "compositing_node_group"):
        tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    else:
        cornell.use_nodes = True
        tree = cornell.node_tree
    node = tree.nodes.new("CompositorNodeImage")
    node.image = image
    assert node.has_layers
    assert set(CONTRACT) <= {output.name for output in node.outputs}


def test_cache_renders_once_and_knows_what_changes_pixels(cornell, tmp_path, monkeypatch):
    renders = []
    original = cache.render_reference
    monkeypatch.setattr(cache, "render_reference", lambda *a, **k: renders.append(1) or original(*a, **k))
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    identity = cache.scene_identity("cornell", {"detail": "low"})
    tiny = {"spp": 1, "size": (8, 8)}
    first = cache.cached_reference(cornell, identity, **tiny)
    assert first.is_relative_to(tmp_path) and len(renders) == 1
    assert json.loads(first.with_suffix(".json").read_text())["spp"] == 1
    assert cache.cached_reference(cornell, identity, threads=1, **tiny) == first and len(renders) == 1
    others = [
        cache.cached_path(identity, reference.ReferenceSettings(**{**tiny, "seed": 1})),
        cache.cached_path(identity, reference.ReferenceSettings(**{**tiny, "size": (8, 9)})),
        cache.cached_path(cache.scene_identity("cornell", {"detail": "full"}), reference.ReferenceSettings(**tiny)),
        cache.cached_path(cache.scene_identity("furnace"), reference.ReferenceSettings(**tiny)),
    ]
    monkeypatch.setattr(cache, "REFERENCE_VERSION", -1)
    others.append(cache.cached_path(identity, reference.ReferenceSettings(**tiny)))
    assert len({first, *others}) == 6
    half_a, half_b = cache.cached_halves(cornell, identity, **tiny)
    assert not np.array_equal(half_a["Combined"], half_b["Combined"])


def test_a_scene_file_is_known_by_its_content(tmp_path):
    file, copy, other = (tmp_path / name for name in ("a.blend", "b.blend", "c.blend"))
    file.write_bytes(b"scene")
    copy.write_bytes(b"scene")
    other.write_bytes(b"other")
    assert cache.scene_identity(file) == cache.scene_identity(copy) != cache.scene_identity(other)
    with pytest.raises(SceneError, match="none"):
        cache.scene_identity(tmp_path / "none.blend")


@pytest.fixture
def files(tmp_path):
    """(test, reference): a picture 10 % too bright, and the picture."""
    picture = np.random.default_rng(0).gamma(2, 0.5, (12, 16, 3))
    return tuple(
        write_exr(tmp_path / f"{name}.exr", Layers({"Indirect": picture * scale, "Normal": picture}))
        for name, scale in (("[test]", 1.1), ("reference", 1.0))
    )


def test_comparison_says_and_writes_the_figures(files, tmp_path):
    out = io.StringIO()
    result = compare_files(*files, json=tmp_path / "c.json", error_map=tmp_path / "c.png", console=Console(file=out, width=100))
    assert result["bias"] == pytest.approx(0.1, rel=1e-4)
    assert result["rmse"] > 0.1 and result["relmse"] > 0 and 0 < result["flip"] < 1 and result["invalid"] == 0
    assert json.loads((tmp_path / "c.json").read_text()) == result
    pixels = oiio.ImageInput.open(str(tmp_path / "c.png")).read_image(oiio.UINT8)
    assert pixels.shape == (12, 16, 3)
    assert (pixels[..., 0] >= pixels[..., 2]).all()
    assert "+0.1000" in out.getvalue() and "[test].exr" in out.getvalue()


def test_comparison_refuses_what_does_not_fit(files, tmp_path):
    with pytest.raises(SceneError, match=r"no layer 'Direct'; name one of Indirect, Normal"):
        compare_files(*files, "Direct")
    small = write_exr(tmp_path / "small.exr", Layers({"Indirect": np.ones((6, 8, 3))}))
    with pytest.raises(SceneError, match=r"8x6 and 16x12"):
        compare_files(small, files[1])


def test_comparison_of_a_region_is_that_of_its_pixels(files, tmp_path):
    whole = read_exr(files[1])["Indirect"]
    part = write_exr(tmp_path / "part.exr", Layers({"Indirect": whole[2:8, 3:11] * 1.2}, offset=(3, 2), full_size=(16, 12)))
    result = compare_files(part, files[1], console=Console(file=io.StringIO()))
    assert result["pixels"] == 48
    assert result["bias"] == pytest.approx(0.2, rel=1e-4)
    aside = write_exr(tmp_path / "aside.exr", Layers({"Indirect": whole[:2, :3]}, offset=(0, 0), full_size=(16, 12)))
    with pytest.raises(SceneError, match="different parts"):
        compare_files(aside, part)
