"""Settings of a bake, saved with each scene as `scene.lumigate_lightmaps` and with each object as `object.lumigate_lightmap`."""

import bpy

from ..core.settings import CONTENTS, BakeSettings, RenderSettings
from .lightmap_uv import LAYER, Unwrap

_DEFAULT = BakeSettings()
_CONTENT_LABELS = {"irradiance": "Irradiance", "indirect": "Indirect Only", "full": "Full"}


class LightmapSettings(bpy.types.PropertyGroup):
    """What `lumigate bake` takes, as Blender's properties."""

    objects: bpy.props.EnumProperty(
        name="Objects",
        items=(
            ("SELECTED", "Selected", "Bake the selected mesh objects"),
            ("ALL", "All", "Bake every mesh object that a render shows"),
            ("CHANGED", "Changed", "Bake the objects whose mesh, place or materials have changed since their last bake"),
        ),
    )
    content: bpy.props.EnumProperty(
        name="Content", items=[(name, _CONTENT_LABELS[name], text[0].upper() + text[1:]) for name, text in CONTENTS.items()]
    )
    atlas: bpy.props.BoolProperty(name="One Atlas", description="One image for all objects instead of one each")
    use_density: bpy.props.BoolProperty(name="By Texel Density", description="Choose the size of images by texels a metre")
    size: bpy.props.IntProperty(
        name="Size", description="Texels along a side of each image", default=512, min=1, max=16384, soft_min=64, subtype="PIXEL"
    )
    density: bpy.props.FloatProperty(
        name="Texel Density",
        description="Texels a metre, where an object has no density of its own",
        default=32.0,
        min=0.01,
        soft_max=512.0,
    )
    margin: bpy.props.IntProperty(
        name="Margin",
        description="Texels around each chart that are filled, too",
        default=_DEFAULT.margin,
        min=0,
        soft_max=64,
        subtype="PIXEL",
    )
    texel_samples: bpy.props.IntProperty(
        name="Texel Samples",
        description="Shading points of a texel, each with rays of its own",
        default=_DEFAULT.texel_samples,
        min=1,
        max=16,
    )
    stitch: bpy.props.BoolProperty(
        name="Stitch Seams", description="Let both sides of a UV seam show the same light", default=_DEFAULT.stitch
    )
    layer: bpy.props.StringProperty(name="UV Map", description="The UV map to bake on, made where it is missing", default=LAYER)
    unwrap: bpy.props.EnumProperty(
        name="Unwrap",
        items=(
            ("smart", "Smart UV Project", "Few large charts"),
            ("pack", "Lightmap Pack", "Every face by itself, which never overlaps"),
        ),
    )
    format: bpy.props.EnumProperty(
        name="Format",
        items=(
            ("exr", "OpenEXR", "Linear 32-bit floats"),
            ("png", "PNG", "8 bits with the sRGB curve; the brightest texel is white, and the material knows the scale"),
        ),
    )
    packed: bpy.props.BoolProperty(name="Packed", description="Keep the images in the .blend file", default=True)
    folder: bpy.props.StringProperty(
        name="Folder",
        description="Where images on disk go",
        default="//lightmaps",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )
    materials: bpy.props.BoolProperty(
        name="Set Up Materials", description="Show the lightmaps on the objects; one click takes it back", default=True
    )

    def unwrapping(self) -> Unwrap:
        """How UV maps are made."""
        return Unwrap(self.layer, self.unwrap)

    def bake_settings(self, render: RenderSettings) -> BakeSettings:
        """The request that these properties and those of a render make."""
        return BakeSettings(render, self.content, self.texel_samples, self.margin, self.stitch)


class ObjectLightmap(bpy.types.PropertyGroup):
    """What an object wants of its lightmap, and what its last one was made from."""

    density: bpy.props.FloatProperty(name="Texel Density", description="Texels a metre; 0 takes the scene's", min=0.0, soft_max=512.0)
    stamp: bpy.props.StringProperty(options={"HIDDEN"})


CLASSES = (LightmapSettings, ObjectLightmap)


def attach() -> None:
    """Give every scene and object its settings."""
    bpy.types.Scene.lumigate_lightmaps = bpy.props.PointerProperty(type=LightmapSettings)
    bpy.types.Object.lumigate_lightmap = bpy.props.PointerProperty(type=ObjectLightmap)


def detach() -> None:
    """Take them away again."""
    del bpy.types.Object.lumigate_lightmap
    del bpy.types.Scene.lumigate_lightmaps
