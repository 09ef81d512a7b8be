"""The extension in Blender: what registers, what is left behind, and what the manifest says."""

import threading
import tomllib
from pathlib import Path
from types import SimpleNamespace

import addon_utils
import bpy
import pytest

import lumigate
from lumigate.addon import job, registration
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


class Drawn:
    """A layout that notes the properties which a panel draws."""

    def __init__(self):
        self.names = []

    def __getattr__(self, _name):
        return lambda *_args, **_keywords: self

    def prop(self, _owner, name, *_args, **_keywords):
        self.names.append(name)

    prop_search = prop


@pytest.mark.parametrize("kind", ["MIRRORBALL", "EQUIRECTANGULAR"])
def test_panoramas_that_are_refused_say_so(registered, kind):
    camera, labels = bpy.data.cameras.new("Dome"), []
    camera.type, camera.panorama_type = "PANO", kind
    layout = Drawn()
    layout.label = lambda text, **_keywords: labels.append(text)
    bpy.types.LUMIGATE_PT_panorama.draw(SimpleNamespace(layout=layout), SimpleNamespace(camera=camera))
    assert labels == (["Only Equirectangular is rendered"] if kind == "MIRRORBALL" else [])


def drawn(panel, context) -> list[str]:
    """What a panel shows in `context`: nothing where it or one of its parents is not there."""
    layout, parents = Drawn(), [panel]
    while parent := getattr(parents[-1], "bl_parent_id", ""):
        parents.append(getattr(bpy.types, parent))
    if all(shown.poll(context) for shown in parents if hasattr(shown, "poll")):
        panel.draw(SimpleNamespace(layout=layout, columns=lambda: layout, bl_space_type="PROPERTIES"), context)
    return layout.names


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("RENDER_PT_simplify_render", "simplify_subdivision_render"),
        ("LUMIGATE_PT_film", "pixel_filter_type"),
        ("LUMIGATE_PT_panorama", "latitude_max"),
        ("LUMIGATE_LIGHT_PT_light", "energy"),
        ("LUMIGATE_LIGHT_PT_beam_shape", "spot_size"),
        ("LUMIGATE_LIGHT_PT_settings", "use_shadow"),
        ("LUMIGATE_OBJECT_PT_visibility_ray_visibility", "visible_diffuse"),
        ("LUMIGATE_OBJECT_PT_lightgroup", "lightgroup"),
        ("LUMIGATE_WORLD_PT_ray_visibility", "camera"),
        ("LUMIGATE_WORLD_PT_settings_light_group", "lightgroup"),
    ],
)
def test_what_counts_can_be_edited(registered, name, shown):
    scene = bpy.context.scene
    lamp = bpy.data.objects.new("Spot", bpy.data.lights.new("Spot", "SPOT"))
    camera = bpy.data.cameras.new("Dome")
    camera.type, camera.panorama_type = "PANO", "EQUIRECTANGULAR"
    own = {
        "camera": camera,
        "light": lamp.data,
        "object": lamp,
        "world": bpy.data.worlds.new("Sky"),
        "view_layer": scene.view_layers[0],
        "scene": scene,
        "preferences": bpy.context.preferences,
    }
    panel = getattr(bpy.types, name)
    assert shown in drawn(panel, SimpleNamespace(engine="LUMIGATE", **own))
    if name.startswith("LUMIGATE"):  # beside Cycles' own
        assert not panel.poll(SimpleNamespace(engine="CYCLES", **own))


@pytest.mark.parametrize("kind", ["surface", "displacement"])
def test_materials_show_their_nodes(registered, kind):
    material = bpy.data.materials.new("Paint")
    if not material.node_tree:
        material.use_nodes = True
    assert getattr(bpy.types, f"LUMIGATE_MATERIAL_PT_{kind}").poll(SimpleNamespace(engine="LUMIGATE", material=material))
    assert not getattr(bpy.types, f"LUMIGATE_MATERIAL_PT_{kind}").poll(SimpleNamespace(engine="LUMIGATE", material=None))


@pytest.mark.parametrize(
    "name", ["DATA_PT_EEVEE_light", "DATA_PT_EEVEE_light_distance", "EEVEE_MATERIAL_PT_surface", "OBJECT_PT_visibility"]
)
def test_panels_of_what_does_not_count_are_hidden(registered, name):
    assert "LUMIGATE" not in getattr(bpy.types, name).COMPAT_ENGINES


def test_lamps_have_a_panel_without_cycles():
    addon_utils.disable("cycles")
    try:
        lumigate.register()
        context = SimpleNamespace(engine="LUMIGATE", light=bpy.data.lights.new("Spot", "SPOT"))
        assert "spot_size" in drawn(bpy.types.DATA_PT_spot, context)
        assert not bpy.types.LUMIGATE_LIGHT_PT_light.poll(context)
        lumigate.unregister()
    finally:
        addon_utils.enable("cycles")


def test_operators_are_offered_only_with_a_camera(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not bpy.ops.lumigate.add_indirect_light.poll()
    assert not bpy.ops.lumigate.check_scene.poll()


def test_manifest_names_this_version():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == lumigate.__version__
    assert manifest["id"] == "lumigate"
