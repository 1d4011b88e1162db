"""The operator that bakes objects of Blender as a lamp."""

# Blender reads annotations that are calls.
# pyright: reportInvalidTypeForm=false

import dataclasses
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
from bpy.props import (  # type: ignore[import-not-found]
    EnumProperty,
    IntProperty,
    StringProperty,
)
from bpy_extras.io_utils import ExportHelper  # type: ignore[import-not-found]
from mathutils import Vector  # type: ignore[import-not-found]

from . import lamps
from .model_file import prepared
from .operators import select_only
from .program import ExtensionError, Job, bake_command, export_command, find_program
from .settings import LIGHTS, program_setting

_LOOK_SECONDS, _SCRIPT = 0.5, "lamp.py"
# Blender's lights that glTF has.
_LIGHTS = ("POINT", "SPOT")
# Nodes that Blender's glTF exporter leaves out, so that a default or white takes their place.
_NOT_EXPORTED = {
    "BLACKBODY": "Blackbody",
    "BSDF_GLASS": "Glass BSDF",
    "BSDF_GLOSSY": "Glossy BSDF",
    "BSDF_METALLIC": "Metallic BSDF",
    "BSDF_REFRACTION": "Refraction BSDF",
}


class BakeSelected(bpy.types.Operator, ExportHelper):
    """Bake the selected objects with lumitree, put the lamp in their place, and hide them"""

    bl_idname = "lumitree.bake_selected"
    bl_label = "Bake Selected as Lamp"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    filename_ext = ".lumitree"
    filter_glob: StringProperty(default="*.lumitree", options={"HIDDEN"})
    quality: EnumProperty(
        name="Quality",
        description="Number of light paths",
        items=[
            ("preview", "Preview", "1 million light paths"),
            ("standard", "Standard", "2 million light paths"),
            ("high", "High", "16 million light paths"),
        ],
        default="standard",
    )
    lights: IntProperty(**LIGHTS)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.mode == "OBJECT" and bool(context.selected_objects)

    def execute(self, context: Any) -> set[str]:
        try:
            program = find_program(program_setting(context))
            asset = Path(bpy.path.abspath(self.filepath)).absolute()
            if lost := not_exported(context.selected_objects):
                self.report({"WARNING"}, f"glTF has no {', '.join(lost)}: use a Principled BSDF")
            self.bake = Bake.started(context, program, asset, self.quality, self.lights)
            if bpy.app.background:
                # Without a window there are no events.
                self.bake.job.wait()
                return self._finish(context)
        except ExtensionError as error:
            return self._fail(context, error)
        manager = context.window_manager
        self.timer = manager.event_timer_add(_LOOK_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, "The bake was cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            # The lamp is added in object mode.
            if not self.bake.job.poll() or context.mode != "OBJECT":
                context.workspace.status_text_set(self.bake.job.progress())
                return {"PASS_THROUGH"}
            return self._finish(context)
        except ExtensionError as error:
            return self._fail(context, error)

    def cancel(self, context: Any) -> None:
        """End the program. Blender calls this when a file is opened, or none is chosen, too."""
        bake = getattr(self, "bake", None)
        if bake is not None:
            bake.job.stop()
        self._clean(context)

    def _finish(self, context: Any) -> set[str]:
        lamp = self.bake.finished(context)
        self._clean(context)
        self.report({"INFO"}, f"Baked {lamp.name}: {lamp.lumitree.lumens:.0f} lm")
        return {"FINISHED"}

    def _fail(self, context: Any, error: ExtensionError) -> set[str]:
        self._clean(context)
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def _clean(self, context: Any) -> None:
        bake, timer = getattr(self, "bake", None), getattr(self, "timer", None)
        if bake is not None:
            bake.folder.cleanup()
        if timer is not None:
            context.window_manager.event_timer_remove(timer)
            context.workspace.status_text_set(None)


@dataclasses.dataclass
class Bake:
    """A bake that runs.

    Attributes:
        job: the commands.
        folder: of all files until the end, so that nothing else is left of a bake that fails.
        names: of the objects, which are hidden at the end.
        centre: [3] of the objects, where the lamp's empty goes.
        asset: file that is written.
        lights: largest number of point lights.
    """

    job: Job
    folder: "tempfile.TemporaryDirectory[str]"
    names: list[str]
    centre: Any
    asset: Path
    lights: int

    @classmethod
    def started(
        cls, context: Any, program: Sequence[str], asset: Path, quality: str, lights: int
    ) -> "Bake":
        """Export the selected objects, and start the commands.

        Raises:
            ExtensionError: the selection holds what glTF has not, or the program does not start.
        """
        selected = context.selected_objects
        check_objects(selected)
        names, centre = [thing.name for thing in selected], centre_of(selected)
        folder = tempfile.TemporaryDirectory(prefix="lumitree-")
        try:
            work = Path(folder.name)
            model, made = work / "lamp.glb", work / asset.name
            export_selected(model)
            model.write_bytes(prepared(model.read_bytes(), centre))
            commands = [
                bake_command(program, model, made, quality),
                export_command(program, made, work / _SCRIPT, lights, "y"),
            ]
            job = Job(commands, work / "log")
        except BaseException:
            folder.cleanup()
            raise
        return cls(job, folder, names, centre, asset, lights)

    def finished(self, context: Any) -> Any:
        """Keep the asset, and add the lamp in place of the objects; returns its empty.

        Raises:
            ExtensionError: the asset cannot be written.
        """
        made = Path(self.folder.name) / self.asset.name
        try:
            shutil.move(made, self.asset)
        except OSError as error:
            raise ExtensionError(f"{self.asset} cannot be written: {error.strerror}") from error
        lamp = lamps.run_script(made.with_name(_SCRIPT), context.scene)
        lamps.remember(lamp, self.asset, self.lights, "y")
        lamp.location = self.centre
        for name in self.names:
            # The user may have removed or renamed some meanwhile.
            thing = context.view_layer.objects.get(name)
            if thing is not None:
                thing.hide_set(True)
                thing.hide_render = True
        select_only(context, lamp)
        return lamp


def check_objects(things: Sequence[Any]) -> None:
    """Refuse lights that Blender's exporter leaves out, or that belong to no lamp."""
    for thing in things:
        if thing.type == "LIGHT" and thing.data.type not in _LIGHTS:
            raise ExtensionError(
                f"{thing.name} is a light of type {thing.data.type.lower()}, which is not baked; "
                "give a surface an emission, or use point and spot lights"
            )


def not_exported(things: Sequence[Any]) -> list[str]:
    """Names of the nodes in materials of objects that the exporter leaves out."""
    slots = [slot for thing in things for slot in thing.material_slots]
    trees = [slot.material.node_tree for slot in slots if slot.material is not None]
    nodes = {node.type for tree in trees if tree is not None for node in tree.nodes}
    return [name for kind, name in _NOT_EXPORTED.items() if kind in nodes]


def centre_of(things: Sequence[Any]) -> Any:
    """Centre of the bounding box of objects, in the world."""
    corners = [thing.matrix_world @ Vector(each) for thing in things for each in thing.bound_box]
    low, high = (Vector(map(pick, *corners)) for pick in (min, max))
    return (low + high) / 2


def export_selected(path: Path) -> None:
    """Write the selected objects as a binary glTF file.

    Raises:
        ExtensionError: Blender's exporter is disabled, or failed.
    """
    if "io_scene_gltf2" not in bpy.context.preferences.addons:
        raise ExtensionError("Blender's add-on 'glTF 2.0 format' is disabled; enable it")
    try:
        bpy.ops.export_scene.gltf(
            filepath=str(path),
            export_format="GLB",
            use_selection=True,
            export_apply=True,
            export_yup=True,
            export_lights=True,
            export_import_convert_lighting_mode="SPEC",
            export_animations=False,
            export_cameras=False,
        )
    except RuntimeError as error:
        lines = str(error).strip().splitlines()
        raise ExtensionError(f"Blender's glTF exporter failed: {lines[-1]}") from error
