"""The settings in Blender are those of the core, generated from one table."""

import bpy
import pytest

import lumigate
from lumigate.addon.properties import SHOWN
from lumigate.core.settings import QUALITIES, QUALITY_ERRORS, RenderSettings, options


@pytest.fixture
def settings():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    lumigate.register()
    yield bpy.context.scene.lumigate
    lumigate.unregister()


def test_the_defaults_are_those_of_the_command_line(settings):
    assert settings.quality == "MEDIUM"
    assert settings.as_settings() == RenderSettings(quality="medium")


def test_every_option_is_a_property_with_a_tooltip(settings):
    properties = settings.bl_rna.properties
    for name, field in options().items():
        if name in SHOWN:
            assert properties[name].name == field.metadata["option"].label
            assert properties[name].description.startswith(field.metadata["option"].help)
    assert set(options()) - set(SHOWN) == {"threads"}  # Blender's own


def test_the_seconds_of_a_budget_have_a_unit(settings):
    assert settings.bl_rna.properties["time_budget"].unit == "TIME_ABSOLUTE"


@pytest.mark.parametrize("name", [name for name, field in options().items() if field.type == "int" and name in SHOWN])
def test_numbers_reach_the_request_and_keep_their_bounds(settings, name):
    least = int(SHOWN[name].metadata["option"].least)
    setattr(settings, name, 37)
    assert getattr(settings.as_settings(), name) == 37
    setattr(settings, name, -5)
    assert getattr(settings.as_settings(), name) == least


def test_menus_and_switches_reach_the_request(settings):
    settings.method, settings.visibility, settings.denoise, settings.compensation = "instant-radiosity", "none", "OFF", False
    settings.direct_samples = 3
    found = settings.as_settings()
    assert (found.method, found.visibility, found.denoise, found.compensation) == ("instant-radiosity", "none", False, False)
    assert found.direct_samples == 3 and found.reflections is None


@pytest.mark.parametrize("name", QUALITIES)
def test_a_preset_puts_its_numbers_in(settings, name):
    settings.quality = name.upper()
    assert {number: getattr(settings.as_settings(), number) for number in QUALITIES[name]} == QUALITIES[name]
    assert settings.quality == name.upper()


def test_other_numbers_are_a_custom_quality(settings):
    settings.vpls += 1
    assert settings.quality == "CUSTOM"
    assert settings.as_settings().quality is None


def test_a_named_quality_is_what_automatic_aims_at(settings):
    settings.quality = "FINAL"
    assert settings.as_settings().with_defaults().target_error == QUALITY_ERRORS["final"]
    settings.goal = "TIME"
    assert settings.as_settings().quality is None


def test_the_aim_decides_which_end_there_is(settings):
    settings.time_budget, settings.target_error = 3.0, 0.25
    assert settings.as_settings().time_budget is None
    settings.goal = "TIME"
    assert (settings.as_settings().time_budget, settings.as_settings().target_error) == (3.0, None)
    settings.goal = "ERROR"
    assert (settings.as_settings().time_budget, settings.as_settings().target_error) == (None, 0.25)


def test_threads_are_blenders_own(settings):
    render = bpy.context.scene.render
    render.threads_mode, render.threads = "FIXED", 3
    assert settings.as_settings().threads == 3


def test_settings_are_saved_with_the_file(settings, tmp_path):
    settings.quality, settings.goal, settings.fuzziness = "FINAL", "ERROR", 3
    wanted = settings.as_settings()
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.context.scene.lumigate.as_settings() == wanted
