"""Image textures against Cycles: extension, interpolation, projection, colour space, alpha, storage."""

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate.addon.materials import MaterialUse, compile_materials
from lumigate.core.surfaces import textures

WIDTH, HEIGHT = 7, 5


def pattern(channels=4):
    """(HEIGHT, WIDTH, channels) values in 0..1."""
    values = np.random.default_rng(3).random((HEIGHT, WIDTH, channels))
    if channels == 4:
        values[..., 3] = 0.2 + 0.8 * values[..., 3]
    return values.astype(np.float32)


def written(tmp_path, name, pixels, depth=oiio.UINT8):
    """An image file (rows from the top)."""
    path = str(tmp_path / name)
    out = oiio.ImageOutput.create(path)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], depth)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    out.open(path, spec)
    out.write_image(np.ascontiguousarray(pixels))
    out.close()
    return bpy.data.images.load(path)


def emission(node, image, output="Color", coordinates=None, **settings):
    def build(tree, end):
        inputs = {} if coordinates is None else {"Vector": coordinates}
        made = node(tree, "ShaderNodeTexImage", image=image, inputs=inputs, **settings)
        emit = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(made.outputs[output], emit.inputs[0])
        tree.links.new(emit.outputs[0], end.inputs[0])

    return build


def check(grid, atol=2e-4):
    for name, got in grid.compare().items():
        np.testing.assert_allclose(got.emission, np.maximum(got.passes["Emit"], 0), atol=atol, err_msg=name)
    assert not grid.warnings


def test_extension_and_interpolation(grid, node, tmp_path):
    image = written(tmp_path, "a.png", pattern(3))
    for extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
        for interpolation in ("Closest", "Linear", "Cubic", "Smart"):
            grid.add(f"{extension} {interpolation}", emission(node, image, extension=extension, interpolation=interpolation))
    check(grid)


def test_projection(grid, node, tmp_path):
    image = written(tmp_path, "a.png", pattern(3))

    def generated(tree):
        return tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]

    for projection in ("FLAT", "BOX", "SPHERE", "TUBE"):
        grid.add(projection, emission(node, image, coordinates=generated, projection=projection, projection_blend=0.3))
    check(grid)


def test_storage_and_color_space(grid, node, tmp_path):
    """8 and 16 bits, half floats, grey, with and without alpha, in every colour space that scenes use."""
    files = {
        "grey.png": (pattern(1), oiio.UINT8),
        "rgb.png": (pattern(3), oiio.UINT8),
        "deep.png": (pattern(3), oiio.UINT16),
        "float.exr": (pattern(3) * 3, oiio.HALF),
    }
    for file, (pixels, depth) in files.items():
        for space in ("sRGB", "Non-Color", "Linear Rec.709"):
            image = written(tmp_path, f"{space[:4]}_{file}", pixels, depth)
            image.colorspace_settings.name = space
            grid.add(f"{file} {space}", emission(node, image))
    check(grid, atol=2e-3)


def test_unusual_color_space(grid, node, tmp_path):
    for space in ("AgX Base sRGB", "Linear Rec.2020", "ACEScg"):
        image = written(tmp_path, f"{space}.png", pattern(3))
        image.colorspace_settings.name = space
        grid.add(space, emission(node, image))
    check(grid, atol=0.012)


@pytest.mark.parametrize("packed", [False, True])
def test_alpha(grid, node, tmp_path, packed):
    for mode in ("STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"):
        for space in ("sRGB", "Non-Color", "Linear Rec.709"):
            for depth, file in ((oiio.UINT8, "a.png"), (oiio.UINT16, "b.png"), (oiio.HALF, "c.exr")):
                pixels = pattern(4)
                if mode == "PREMUL":
                    pixels[..., :3] *= pixels[..., 3:]
                image = written(tmp_path, f"{mode} {space} {file}", pixels, depth)
                image.alpha_mode = mode
                image.colorspace_settings.name = space
                if packed:
                    image.pack()
                grid.add(f"{mode} {space} {file} color", emission(node, image))
                grid.add(f"{mode} {space} {file} alpha", emission(node, image, output="Alpha"))
                grid.add(f"{mode} {space} {file} both", _both(node, image))
    # A byte of colour times a byte of alpha is rounded to a byte in Cycles.
    check(grid, atol=0.012)


def _both(node, image):
    def build(tree, end):
        made = node(tree, "ShaderNodeTexImage", image=image)
        emit = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(made.outputs["Color"], emit.inputs[0])
        tree.links.new(made.outputs["Alpha"], emit.inputs["Strength"])
        tree.links.new(emit.outputs[0], end.inputs[0])

    return build


def test_generated_image(grid, node):
    for is_float in (False, True):
        image = bpy.data.images.new(f"float {is_float}", WIDTH, HEIGHT, alpha=False, float_buffer=is_float)
        pixels = pattern(4)
        pixels[..., 3] = 1
        image.pixels.foreach_set(pixels.ravel())
        grid.add(f"float {is_float}", emission(node, image))
    check(grid, atol=2e-3)


def test_no_image_and_missing_file_show_pink(grid, node, tmp_path):
    image = written(tmp_path, "gone.png", pattern(3))
    (tmp_path / "gone.png").unlink()
    image.reload()
    grid.add("no image", emission(node, None))
    grid.add("missing", emission(node, image))
    compared = grid.compare()
    for name in ("no image", "missing"):
        np.testing.assert_allclose(compared[name].emission[0], (1, 0, 1), err_msg=name)
    np.testing.assert_allclose(compared["missing"].passes["Emit"][0], (1, 0, 1))
    (warning,) = [w for w in grid.warnings if "gone.png" in w]
    assert "'missing'" in warning


def test_texture_that_nothing_reads_is_not_loaded(grid, node, tmp_path):
    unused = written(tmp_path, "unused.png", pattern(3))

    def build(tree, end):
        node(tree, "ShaderNodeTexImage", image=unused)
        tree.links.new(node(tree, "ShaderNodeEmission").outputs[0], end.inputs[0])

    grid.add("it", build)
    found = compile_materials([MaterialUse(grid.materials["it"][0])])
    assert found.materials.tables.texels_u8.size <= 4


def test_one_image_is_stored_once(grid, node, tmp_path):
    image = written(tmp_path, "a.png", pattern(3))
    for extension in ("REPEAT", "CLIP"):
        grid.add(extension, emission(node, image, extension=extension))
    found = compile_materials([MaterialUse(m) for m, *_ in grid.materials.values()])
    assert found.materials.tables.texels_u8.size == WIDTH * HEIGHT * 3
    assert len(found.materials.tables.texture_header) == 2


def test_coordinates_beyond_all_bounds_are_black():
    pool = textures.TexturePool()
    pool.add("a", lambda: np.full((2, 2, 3), 255, np.uint8), textures.REPEAT, textures.LINEAR, 0)
    for u in (np.nan, np.inf, -1e30):
        assert textures.sample(*pool.tables(), 0, np.float32(u), np.float32(0.5)) == (0, 0, 0, 0)


def tiled(tmp_path, numbers, name="tile.<UDIM>.png", **options):
    """An image in tiles that differ, one file each."""
    rng = np.random.default_rng(5)
    for number in numbers:
        column, row = (number - 1001) % 10, (number - 1001) // 10
        file = name.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")
        image = written(
            tmp_path, file, rng.random((HEIGHT, WIDTH, 3 + options.get("alpha", False))).astype(np.float32), **options.get("file", {})
        )
    image.filepath, image.source = str(tmp_path / name), "TILED"
    for number in numbers:
        if number not in {tile.number for tile in image.tiles}:
            image.tiles.new(number)
    return image


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("name", ["tile.<UDIM>.png", "tile.<UVTILE>.png"])
def test_tiles(grid, node, tmp_path, name, packed):
    image = tiled(tmp_path, (1001, 1002, 1012), name)
    if packed:
        image.pack()
        for file in tmp_path.iterdir():
            file.unlink()
    for extension in ("REPEAT", "EXTEND"):
        grid.add(extension, emission(node, image, extension=extension))
    check(grid)


def test_a_missing_tile_is_pink(grid, node, tmp_path):
    image = tiled(tmp_path, (1001, 1002))
    (tmp_path / "tile.1002.png").unlink()
    grid.add("it", emission(node, image))
    got = grid.compare()["it"]
    np.testing.assert_allclose(got.emission, got.passes["Emit"], atol=2e-4)
    assert [line for line in grid.warnings if "tile.1002.png" in line]


@pytest.mark.parametrize("name, depth", [("tile.<UDIM>.exr", oiio.FLOAT), ("tile.<UDIM>.tif", oiio.UINT16)])
def test_tiles_of_more_than_8_bits(grid, node, tmp_path, name, depth):
    image = tiled(tmp_path, (1001, 1011), name, file={"depth": depth})
    for space in ("sRGB", "Non-Color", "AgX Base sRGB"):
        copy = image.copy()
        copy.colorspace_settings.name = space
        grid.add(space, emission(node, copy))
    check(grid, atol=0.012)


def test_tiles_with_alpha(grid, node, tmp_path):
    image = tiled(tmp_path, (1001, 1002), alpha=True)
    for mode in ("STRAIGHT", "CHANNEL_PACKED", "NONE"):
        copy = image.copy()
        copy.alpha_mode = mode
        for output in ("Color", "Alpha"):
            grid.add(f"{mode} {output}", emission(node, copy, output))
    check(grid, atol=0.01)


def sequence(tmp_path):
    """A film of five frames."""
    for number in range(1, 6):
        image = written(tmp_path, f"film_{number:03d}.png", np.full((HEIGHT, WIDTH, 3), 0.15 * number, np.float32))
    image.filepath, image.source = str(tmp_path / "film_001.png"), "SEQUENCE"
    return image


@pytest.mark.parametrize("frame", [1, 3, 7, 40])
def test_sequences_follow_the_frame(grid, node, tmp_path, frame):
    image = sequence(tmp_path)
    users = {
        "as it is": dict(frame_duration=5),
        "later": dict(frame_duration=4, frame_start=3, frame_offset=1),
        "again": dict(frame_duration=4, use_cyclic=True),
    }
    for name, settings in users.items():

        def build(tree, end, settings=settings):
            made = node(tree, "ShaderNodeTexImage", image=image)
            for key, value in settings.items():
                setattr(made.image_user, key, value)
            emit = tree.nodes.new("ShaderNodeEmission")
            tree.links.new(made.outputs["Color"], emit.inputs[0])
            tree.links.new(emit.outputs[0], end.inputs[0])

        grid.add(name, build)
    bpy.context.scene.frame_set(frame)
    check(grid)
