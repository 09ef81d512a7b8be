"""Lamps: everything that emits light, as tables, and the two ways of sampling it.

`build` makes the tables from a scene.  `sample` aims from a shading point at one emitter, `tree` chooses among many,
`direct` sums direct light with shadow rays, which `world_guide` aims at what is seen of the world, and
`highlights` adds those of small lamps on small things.  `emission` sends particles out, through `openings` where these are small.
"""

from .build import build_emitters
from .direct import DirectLight, direct_irradiance, direct_light
from .emission import focus_share, focused
from .groups import LightGroups
from .highlights import highlights
from .openings import Openings, find_openings
from .sharp import sharp_emitters
from .tables import Emitters
from .world import world_tables

__all__ = [
    "DirectLight",
    "Emitters",
    "LightGroups",
    "Openings",
    "build_emitters",
    "direct_irradiance",
    "direct_light",
    "find_openings",
    "focus_share",
    "focused",
    "highlights",
    "sharp_emitters",
    "world_tables",
]
