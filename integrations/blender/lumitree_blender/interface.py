"""Panels and menu entries, and what Blender registers."""

from typing import Any

import bpy  # type: ignore[import-not-found]

from .bake import BakeSelected
from .lamps import lamp_of
from .operators import DropLamp, ImportAgain, ImportLamp
from .settings import LumitreeLamp, LumitreePreferences


def draw_lamp(layout: Any, lamp: Any) -> None:
    """The settings of a lamp."""
    settings = lamp.lumitree
    layout.use_property_split = True
    layout.label(text=lamp.name, icon="LIGHT")
    layout.prop(settings, "lumens")
    row = layout.row(heading="Temperature")
    # A colour temperature needs light in all channels.
    row.enabled = min(lamp["watts"]) > 0
    row.prop(settings, "use_temperature", text="")
    kelvin = row.row()
    kelvin.active = settings.use_temperature
    kelvin.prop(settings, "temperature", text="K")
    layout.separator()
    layout.prop(settings, "source")
    layout.prop(settings, "lights")
    layout.prop(settings, "up", expand=True)
    layout.operator(ImportAgain.bl_idname, icon="FILE_REFRESH")


class SidebarPanel(bpy.types.Panel):
    """Tab of the sidebar of the 3D view."""

    bl_idname = "VIEW3D_PT_lumitree"
    bl_label = "Lumitree"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Lumitree"

    def draw(self, context: Any) -> None:
        column = self.layout.column()
        column.operator(ImportLamp.bl_idname, text="Import Asset", icon="IMPORT")
        column.operator(BakeSelected.bl_idname, icon="OUTLINER_OB_LIGHT")
        lamp = lamp_of(context.object)
        if lamp is not None:
            draw_lamp(self.layout.column(), lamp)


class ObjectPanel(bpy.types.Panel):
    """Panel of the object properties of a lamp."""

    bl_idname = "OBJECT_PT_lumitree"
    bl_label = "Lumitree"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "object"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return lamp_of(context.object) is not None

    def draw(self, context: Any) -> None:
        draw_lamp(self.layout.column(), lamp_of(context.object))


_CLASSES = (
    LumitreePreferences,
    LumitreeLamp,
    ImportLamp,
    ImportAgain,
    DropLamp,
    BakeSelected,
    SidebarPanel,
    ObjectPanel,
)


def _import_entry(menu: Any, context: Any) -> None:
    menu.layout.operator(ImportLamp.bl_idname, text="Lumitree asset (.lumitree)")


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Object.lumitree = bpy.props.PointerProperty(type=LumitreeLamp)
    bpy.types.TOPBAR_MT_file_import.append(_import_entry)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_import_entry)
    del bpy.types.Object.lumitree
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
