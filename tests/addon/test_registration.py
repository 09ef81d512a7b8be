"""The extension in Blender: what registers, what is left behind, and what the manifest says."""

import threading
import tomllib
from pathlib import Path

import bpy
import pytest

import lumigate
from lumigate.addon import compat, job, registration
from lumigate.core.threads import end_threads, run_chunks

ROOT = Path(lumigate.__file__).parent


def traces() -> tuple:
    """Everything of ours that Blender could still hold: classes, properties, operators, handlers, panels, timers, threads."""
    handlers = [f for name in dir(bpy.app.handlers) if isinstance(h := getattr(bpy.app.handlers, name), list) for f in h]
    owners = (bpy.types.Scene, bpy.types.ViewLayer, bpy.types.WindowManager)
    return (
        sorted(name for name in dir(bpy.types) if "lumigate" in name.lower()),
        [p.identifier for owner in owners for p in owner.bl_rna.properties if "lumigate" in p.identifier],
        sorted(dir(bpy.ops.lumigate)),
        len(handlers),
        {panel.__name__: sorted(getattr(panel, "COMPAT_ENGINES", ())) for panel in bpy.types.Panel.__subclasses__()},
        [thread.name for thread in threading.enumerate() if thread.name.startswith("lumigate")],
    )


@pytest.fixture
def registered():
    lumigate.register()
    yield
    lumigate.unregister()


def test_unregister_leaves_nothing_behind():
    end_threads()  # of other tests
    before = traces()
    for _ in range(3):
        lumigate.register()
        run_chunks(lambda begin, end: None, 2, 1, 2)
        assert all(mine != its for mine, its in zip(traces()[::5], before[::5], strict=True))  # classes and threads
        lumigate.unregister()
        assert traces() == before


def test_a_failed_registration_is_undone(monkeypatch):
    def fail():
        raise RuntimeError("no")

    before = traces()
    monkeypatch.setattr(registration.compat, "attach", fail)
    with pytest.raises(RuntimeError, match="no"):
        lumigate.register()
    assert traces() == before


def test_a_running_job_ends_with_the_extension():
    lumigate.register()
    advanced = threading.Event()

    def work(advance):
        while advance("view", 0.5):
            advanced.set()

    running = job.Job(work)
    assert advanced.wait(20)
    lumigate.unregister()
    assert running.done and running.cancelled


@pytest.mark.parametrize(
    "name",
    [
        "RENDER_PT_color_management",
        "RENDER_PT_simplify",
        "CYCLES_MATERIAL_PT_surface",
        "CYCLES_WORLD_PT_surface",
        "CYCLES_WORLD_PT_settings_light_group",
        "CYCLES_LIGHT_PT_light",
        "CYCLES_LIGHT_PT_beam_shape",  # a spot's cone, an area's spread
        "CYCLES_LIGHT_PT_nodes",
        "CYCLES_OBJECT_PT_visibility_ray_visibility",
        "CYCLES_OBJECT_PT_lightgroup",
    ],
)
def test_blenders_panels_of_what_counts_serve_the_engine(registered, name):
    panel = getattr(bpy.types, name)
    parents = [panel]
    while getattr(parents[-1], "bl_parent_id", ""):
        parents.append(getattr(bpy.types, parents[-1].bl_parent_id))
    assert all("LUMIGATE" in shown.COMPAT_ENGINES for shown in parents)


@pytest.mark.parametrize(
    "name", ["DATA_PT_EEVEE_light", "DATA_PT_EEVEE_light_distance", "EEVEE_MATERIAL_PT_surface", "OBJECT_PT_visibility"]
)
def test_panels_of_what_does_not_count_are_hidden(registered, name):
    assert "LUMIGATE" not in getattr(bpy.types, name).COMPAT_ENGINES


def test_lamps_have_a_panel_without_cycles(monkeypatch):
    monkeypatch.setattr(compat, "_CYCLES", ("NO_PT_such_panel",))
    lumigate.register()
    try:
        assert all("LUMIGATE" in getattr(bpy.types, name).COMPAT_ENGINES for name in ("DATA_PT_EEVEE_light", "DATA_PT_spot"))
    finally:
        lumigate.unregister()


def test_operators_are_offered_only_with_a_camera(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not bpy.ops.lumigate.add_indirect_light.poll()
    assert not bpy.ops.lumigate.check_scene.poll()


def test_manifest_names_this_version():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == lumigate.__version__
    assert manifest["id"] == "lumigate"
