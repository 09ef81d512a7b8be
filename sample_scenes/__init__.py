"""Scenes built by script: no binaries, no downloads, the same arrays every time."""

from __future__ import annotations

from importlib import import_module

DESCRIPTIONS = {
    "cornell": "The Cornell box with its measured dimensions and reflectances: two blocks, one lamp.",
    "atrium": "A two-storey colonnade round a court under sun and open sky: arches, curtains, palms.",
    "corridor": "A dark corridor between six rooms, three of them lit: all its light comes through doors ajar.",
    "cathedral": "A Gothic nave with rib vaults: sun and sky through coloured glass onto a polished floor.",
    "furnace": "A closed sphere of one albedo and one emission, whose light is known in closed form.",
    "gallery": "A museum of three halls with 200 spot and point lamps over pictures and sculptures.",
    "window": "A room with one window in a wide sunlit land: most of its light comes in by way of the ground outside.",
}
NAMES: tuple[str, ...] = tuple(DESCRIPTIONS)


def build(name: str, *, detail: str = "full", **parameters):
    """Replace the open file by the sample scene `name` and return its `bpy.types.Scene`.

    detail: `full`, or `low` for a light version for tests.  parameters: those of the scene's own `build`.
    Raises KeyError for an unknown name or detail, TypeError for an unknown parameter.
    """
    from .stage import Detail

    if name not in NAMES:
        raise KeyError(f"no sample scene is called {name!r}; there are {', '.join(NAMES)}")
    full = {"full": True, "low": False}[detail]
    return import_module(f".{name}", __name__).build(Detail(full), **parameters)
