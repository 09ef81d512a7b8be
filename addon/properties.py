"""The settings of a render, saved with each scene as `scene.lumigate`."""

import bpy

from ..core.settings import RenderSettings

_DEFAULT = RenderSettings()


class LumigateSettings(bpy.types.PropertyGroup):
    """`core.settings.RenderSettings` as Blender's properties."""

    vpls: bpy.props.IntProperty(
        name="VPLs", description="Virtual point lights that carry the indirect light", default=_DEFAULT.vpls, min=1, soft_max=65536
    )
    bounces: bpy.props.IntProperty(
        name="Bounces", description="Diffuse bounces of the indirect light", default=_DEFAULT.bounces, min=0, soft_max=32
    )
    pixel_samples: bpy.props.IntProperty(
        name="Pixel Samples", description="Primary samples of a pixel", default=_DEFAULT.pixel_samples, min=1, soft_max=64
    )
    seed: bpy.props.IntProperty(name="Seed", description="Seed of all random sequences", default=_DEFAULT.seed, min=0)

    def as_settings(self) -> RenderSettings:
        """The request that these properties make."""
        return RenderSettings(vpls=self.vpls, bounces=self.bounces, pixel_samples=self.pixel_samples, seed=self.seed)


CLASSES = (LumigateSettings,)


def attach() -> None:
    """Give every scene its settings."""
    bpy.types.Scene.lumigate = bpy.props.PointerProperty(type=LumigateSettings)


def detach() -> None:
    """Take them away again."""
    del bpy.types.Scene.lumigate
