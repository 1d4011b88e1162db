"""Lamps in a scene of Blender: made by scripts of `lumitree export`, found and replaced."""

import runpy
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]

from .program import ExtensionError, Job, export_command

# The beginning of every script of `lumitree export`.
_BEGINNING = '"""A lamp for Blender 4.2 or newer, written by lumitree.'
# Properties that the script gives the lamp's empty.
_PROPERTIES = ("gain", "tint", "watts")
# Marks the objects that the script made.
_PART = "lumitree_part"


def lamp_of(thing: Any) -> Any:
    """The empty of the lamp that an object is, or belongs to; None if it belongs to none."""
    while thing is not None and not all(name in thing for name in _PROPERTIES):
        thing = thing.parent
    return thing


def import_lamp(
    scene: Any, source: Path, program: Sequence[str], lights: int = 16, up: str = "y"
) -> Any:
    """Add a lamp to a scene; returns its empty.

    Args:
        source: an asset, a photometric file, or a script of `lumitree export`, which is run.
        program: from `program.find_program`; not used for a script.
        lights, up: as for `program.export_command`; not used for a script.

    Raises:
        ExtensionError: the program failed, or the script is not of lumitree, or failed.
    """
    if source.suffix == ".py":
        return run_script(source, scene)
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "lamp.py"
        job = Job([export_command(program, source, script, lights, up)], Path(folder) / "log")
        job.wait()
        lamp = run_script(script, scene)
    remember(lamp, source, lights, up)
    return lamp


def remember(lamp: Any, source: Path, lights: int, up: str) -> None:
    """Note where a new lamp comes from, for another import, and name it after that file."""
    settings = lamp.lumitree
    settings.source, settings.lights, settings.up = str(source), lights, up
    name, things = lamp.name, [lamp, *lamp.users_collection, *lamp.children]
    for thing in [*things, *(each.data for each in lamp.children)]:
        thing.name = thing.name.replace(name, source.stem, 1)


def run_script(path: Path, scene: Any) -> Any:
    """Run a script of `lumitree export`; returns the lamp's empty.

    Raises:
        ExtensionError: another program wrote the file, it cannot be read, or it failed.
    """
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            first = file.readline().rstrip()
    except OSError as error:
        raise ExtensionError(f"{path.name} cannot be read: {error.strerror}") from error
    if not first.startswith(_BEGINNING):
        raise ExtensionError(f"{path.name} is not a script of 'lumitree export'; it was not run")
    try:
        collection = runpy.run_path(str(path), run_name="lamp")["add_lamp"](scene)
    except Exception as error:
        raise ExtensionError(f"{path.name} failed: {type(error).__name__}: {error}") from error
    (lamp,) = (thing for thing in collection.objects if thing.parent is None)
    for thing in lamp.children:
        thing[_PART] = True
    lamp.lumitree.temperature = lamp.get("temperature", lamp.lumitree.temperature)
    return lamp


def replace(old: Any, new: Any) -> None:
    """Give the lamp `old` the lights and surfaces of `new`, which ends.

    The place of the old one, its factors on the light, and its collections stay.
    """
    for thing in [each for each in old.children if _PART in each]:
        data = thing.data
        bpy.data.objects.remove(thing)
        # Copies of the lamp that the user made may share it.
        if data.users == 0:
            bpy.data.batch_remove([data])
    for child in new.children:
        for collection in old.users_collection:
            collection.objects.link(child)
    old["watts"], old.empty_display_size = new["watts"], new.empty_display_size
    old["absolute"] = new.get("absolute", False)
    (scratch,) = new.users_collection
    # Parents and drivers refer to the old empty from here on.
    new.user_remap(old)
    bpy.data.collections.remove(scratch)
    bpy.data.objects.remove(new)
    old.update_tag()
