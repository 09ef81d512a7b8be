"""Lightmaps: light on the texels of UV maps, by the same methods as the camera's view."""

from .bake import BakeResult, Lightmap, Target, bake, bake_corners
from .charts import check_charts, texels_a_metre

__all__ = ["BakeResult", "Lightmap", "Target", "bake", "bake_corners", "check_charts", "texels_a_metre"]
