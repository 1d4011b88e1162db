"""The extension Lumitree for Blender 4.2 and newer.

It imports assets, changes the light of imported lamps, and bakes objects of Blender as a lamp. The
program `lumitree`, which is installed separately, does the work. Modules that import bpy are
imported when Blender registers the extension.
"""


def register() -> None:
    """Add the classes, the menu entry and the settings of lamps."""
    from . import interface

    interface.register()


def unregister() -> None:
    """Remove what `register` added."""
    from . import interface

    interface.unregister()
