"""The extension in Blender: what registers, what is left behind, and what the manifest says."""

import tomllib
from pathlib import Path

import bpy
import numpy as np
import pytest

import lumigate
from lumigate.addon import registration
from lumigate.addon.operators import IMAGE_NAME, load_layers
from lumigate.core.layers import Layers
from lumigate.core.settings import RenderSettings

ROOT = Path(lumigate.__file__).parent


def traces() -> tuple:
    """Everything of ours that Blender could still hold: classes, properties, operators, handlers, timers."""
    handlers = [f for name in dir(bpy.app.handlers) if isinstance(h := getattr(bpy.app.handlers, name), list) for f in h]
    return (
        sorted(name for name in dir(bpy.types) if "lumigate" in name.lower()),
        [p.identifier for p in bpy.types.Scene.bl_rna.properties if "lumigate" in p.identifier],
        sorted(dir(bpy.ops.lumigate)),
        len(handlers),
    )


@pytest.fixture
def registered():
    lumigate.register()
    yield
    lumigate.unregister()


def test_unregister_leaves_nothing_behind():
    before = traces()
    for _ in range(3):
        lumigate.register()
        assert traces() != before
        lumigate.unregister()
        assert traces() == before


def test_a_failed_registration_is_undone(monkeypatch):
    def fail():
        raise RuntimeError("no")

    before = traces()
    monkeypatch.setattr(registration.properties, "attach", fail)
    with pytest.raises(RuntimeError, match="no"):
        lumigate.register()
    assert traces() == before


def test_scene_settings_have_the_defaults_of_the_command_line(registered):
    assert bpy.context.scene.lumigate.as_settings() == RenderSettings()


def test_scene_settings_reach_the_request(registered):
    settings = bpy.context.scene.lumigate
    settings.vpls, settings.bounces, settings.pixel_samples, settings.seed = 17, 0, 3, 5
    assert settings.as_settings() == RenderSettings(vpls=17, bounces=0, pixel_samples=3, seed=5)


def test_operator_is_offered_only_with_a_camera(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)

    assert not bpy.ops.lumigate.render_layers.poll()


def test_layers_become_one_packed_multilayer_image():
    layers = Layers({"Combined": np.ones((4, 6, 3)), "Indirect": np.zeros((4, 6, 3)), "Depth": np.ones((4, 6))})
    load_layers(layers)
    image = load_layers(layers)
    assert [i.name for i in bpy.data.images if i.name.startswith(IMAGE_NAME)] == [IMAGE_NAME]
    assert image.type == "MULTILAYER"
    assert image.packed_file is not None


def test_manifest_names_this_version():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == lumigate.__version__
    assert manifest["id"] == "lumigate"
