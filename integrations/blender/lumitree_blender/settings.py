"""Settings: of each lamp, and of the extension."""

# Blender reads annotations that are calls.
# pyright: reportInvalidTypeForm=false

from typing import Any

import bpy  # type: ignore[import-not-found]
from bpy.props import (  # type: ignore[import-not-found]
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    StringProperty,
)

from . import light

LIGHTS: dict[str, Any] = {
    "name": "Lights",
    "description": "Largest number of point lights. More are more exact near the lamp, and noisier",
    "default": 16,
    "min": 1,
    "max": 1024,
}
UP: dict[str, Any] = {
    "name": "Up",
    "description": "Axis that points up in the lamp's file",
    "items": [("y", "Y", "as in glTF and OBJ"), ("z", "Z", "as in Blender")],
    "default": "y",
}


def _scale(lamp: Any) -> float:
    """Mean scale in the world, as drivers have it; 1 for the flux of a photometric file."""
    return 1.0 if lamp.get("absolute") else abs(lamp.matrix_world.to_3x3().determinant()) ** (1 / 3)


def _get_lumens(settings: Any) -> float:
    lamp = settings.id_data
    if "watts" not in lamp:
        return 0.0
    return light.lumens(lamp["watts"], lamp["tint"], lamp["gain"], _scale(lamp))


def _set_lumens(settings: Any, value: float) -> None:
    lamp = settings.id_data
    full = light.lumens(lamp["watts"], lamp["tint"], 1.0, _scale(lamp))
    if full > 0:
        lamp["gain"] = value / full
        lamp.update_tag()


def _set_tint(settings: Any, context: Any) -> None:
    lamp = settings.id_data
    tint = None
    if settings.use_temperature:
        tint = light.tint_for(lamp["watts"], settings.temperature)
    lamp["tint"] = tint or [1.0, 1.0, 1.0]
    lamp.update_tag()


class LumitreeLamp(bpy.types.PropertyGroup):
    """Settings of a lamp, on its empty.

    `lumens` shows the flux of the properties `watts`, `tint` and `gain`, which the script of the
    lamp made.
    """

    lumens: FloatProperty(
        name="Lumens",
        description="Luminous flux at the lamp's present scale, lm. It changes the property gain",
        min=0.0,
        get=_get_lumens,
        set=_set_lumens,
    )
    use_temperature: BoolProperty(
        name="Use Temperature",
        description="Give the whole light the colour of a black body. It changes the property tint",
        update=_set_tint,
    )
    temperature: FloatProperty(
        name="Temperature",
        description="Colour temperature, K",
        default=6500.0,
        min=light.MIN_TEMPERATURE,
        max=light.MAX_TEMPERATURE,
        step=10000,
        precision=0,
        update=_set_tint,
    )
    source: StringProperty(
        name="Asset", description="File that the lamp was imported from", subtype="FILE_PATH"
    )
    lights: IntProperty(**LIGHTS)
    up: EnumProperty(**UP)


class LumitreePreferences(bpy.types.AddonPreferences):
    """Preferences of the extension."""

    bl_idname = __package__

    program: StringProperty(
        name="Program",
        description="The program lumitree, or a Python that has it. Empty: lumitree on PATH",
        subtype="FILE_PATH",
    )

    def draw(self, context: Any) -> None:
        self.layout.prop(self, "program")
        self.layout.label(text="Install the program with: pip install lumitree")


def program_setting(context: Any) -> str:
    """The program that the preferences name."""
    addon = context.preferences.addons.get(__package__)
    return "" if addon is None else bpy.path.abspath(addon.preferences.program)
