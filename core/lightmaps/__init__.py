"""Lightmaps: light on the texels of UV maps, by the same methods as the camera's view."""

from .bake import BakeResult, Lightmap, Target, bake
from .charts import check_charts, texels_a_metre

__all__ = ["BakeResult", "Lightmap", "Target", "bake", "check_charts", "texels_a_metre"]
