"""Operators that import lamps."""

# Blender reads annotations that are calls.
# pyright: reportInvalidTypeForm=false

from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
from bpy.props import (  # type: ignore[import-not-found]
    EnumProperty,
    IntProperty,
    StringProperty,
)
from bpy_extras.io_utils import ImportHelper  # type: ignore[import-not-found]

from . import lamps
from .program import ExtensionError, find_program
from .settings import LIGHTS, UP, program_setting

_NAMES = "*.lumitree;*.ies;*.ldt;*.ray;*.tm25ray;*.py"


class ImportLamp(bpy.types.Operator, ImportHelper):
    """Import a lamp that lumitree baked, or a photometric file, as lights and surfaces"""

    bl_idname = "import_scene.lumitree"
    bl_label = "Import Lumitree Asset"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    filename_ext = ".lumitree"
    filter_glob: StringProperty(default=_NAMES, options={"HIDDEN"})
    lights: IntProperty(**LIGHTS)
    up: EnumProperty(**UP)

    def invoke(self, context: Any, event: Any) -> set[str]:
        # A file that was dragged into the view is known already.
        if self.properties.is_property_set("filepath"):
            return context.window_manager.invoke_props_dialog(self)
        return ImportHelper.invoke(self, context, event)

    def draw(self, context: Any) -> None:
        self.layout.prop(self, "lights")
        self.layout.prop(self, "up")
        self.layout.label(text="A .py file runs its code:", icon="ERROR")
        self.layout.label(text="import only scripts that you trust")

    def execute(self, context: Any) -> set[str]:
        source = Path(bpy.path.abspath(self.filepath)).absolute()
        try:
            program = [] if source.suffix == ".py" else find_program(program_setting(context))
            lamp = lamps.import_lamp(context.scene, source, program, self.lights, self.up)
        except ExtensionError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        select_only(context, lamp)
        return {"FINISHED"}


class ImportAgain(bpy.types.Operator):
    """Import the lamp again with this number of lights and this axis; its place and light stay"""

    bl_idname = "lumitree.import_again"
    bl_label = "Import Again"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        lamp = lamps.lamp_of(context.object)
        return lamp is not None and bool(lamp.lumitree.source)

    def execute(self, context: Any) -> set[str]:
        lamp = lamps.lamp_of(context.object)
        settings = lamp.lumitree
        source = Path(bpy.path.abspath(settings.source))
        try:
            program = find_program(program_setting(context))
            new = lamps.import_lamp(context.scene, source, program, settings.lights, settings.up)
        except ExtensionError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        lamps.replace(lamp, new)
        select_only(context, lamp)
        return {"FINISHED"}


class DropLamp(bpy.types.FileHandler):
    """Assets that are dragged into the 3D view."""

    bl_idname = "LUMITREE_FH_import"
    bl_label = "Lumitree asset"
    bl_import_operator = ImportLamp.bl_idname
    bl_file_extensions = ".lumitree"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


def select_only(context: Any, thing: Any) -> None:
    """Make one object the selection and the active object."""
    for each in context.view_layer.objects:
        each.select_set(False)
    thing.select_set(True)
    context.view_layer.objects.active = thing
