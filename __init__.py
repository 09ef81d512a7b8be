"""Lumigate: indirect light of a Blender scene by virtual point lights, into image layers.

The repository's root is the package `lumigate`, and the Blender extension of that name.  Nothing here
imports Blender before `register` is called, so that the package works under plain Python too.
"""

__version__ = "0.1.0"


def register() -> None:
    """Called by Blender when the extension is enabled."""
    from .addon import registration

    registration.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled: leaves nothing behind."""
    from .addon import registration

    registration.unregister()
