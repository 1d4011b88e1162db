"""Shapes of a scene are chosen by id, by their BSDF's id or by number, and are listed."""

import gc

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.errors import LumitreeError
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import build_again, reusable_shapes, shape_groups
from support.lamps import AREA, cube, scene, sphere

BARE = f'<shape type="sphere">{AREA}</shape>'
ROOM = scene(
    '<bsdf type="diffuse" id="paint"/>',
    BARE,
    cube("wall", 3, inside='<ref id="paint"/>'),
    '<shape type="disk"><bsdf type="twosided"><bsdf type="diffuse" id="felt"/></bsdf></shape>',
    '<shape type="shapegroup" id="group"><shape type="cube"/></shape>',
    '<shape type="instance" id="copy"><ref id="group"/></shape>',
    sphere("#1", 0.5),
    '<emitter type="constant"/>',
)
LISTED = (
    "#0 - (sphere, emits)",
    "#1 wall (cube, BSDF paint)",
    "#2 - (disk, BSDF felt)",
    "#3 copy (instance)",
    "#4 #1 (sphere)",
)


@pytest.fixture
def room(mi, tmp_path):
    path = tmp_path / "room.xml"
    path.write_text(ROOM)
    return path


def numbers(path, keep=(), drop=()):
    return [shape.number for shape in SceneFile(path, keep, drop).shapes]


def test_they_are_listed_in_the_order_of_the_file(room):
    assert tuple(map(str, SceneFile(room).shapes)) == LISTED


@pytest.mark.parametrize(
    ("keep", "drop", "expected"),
    [
        (["#0"], [], [0]),
        (["#0", "#2"], [], [0, 2]),
        (["paint"], [], [1]),
        (["felt", "copy"], [], [2, 3]),
        (["*"], ["#1"], [0, 2, 3, 4]),
        ([], ["#0", "p*"], [2, 3, 4]),
        # A number, not the id that looks like one; the id can be written as a pattern.
        (["#1"], [], [1]),
        (["[#]1"], [], [4]),
    ],
)
def test_numbers_and_ids_of_bsdfs_choose(room, keep, drop, expected):
    assert numbers(room, keep, drop) == expected


@pytest.mark.parametrize("pattern", ["lamp", "#5", "#99999999999", "#", "#-1"])
def test_a_pattern_without_a_match_lists_what_there_is(room, pattern):
    with pytest.raises(LumitreeError, match="BSDF's id or number; there are #0 - ") as caught:
        SceneFile(room, [pattern])
    assert ", ".join(LISTED) in str(caught.value)
    assert f"'lumitree preview {room} --keep \"*\"' lists" in str(caught.value)


@pytest.mark.parametrize("kind", ["sphere", "disk", "cylinder", "rectangle", "cube"])
def test_a_group_of_shapes_is_built_again(mi, kind):
    """Mitsuba builds a scene again if its shapes are marked: then rays find where they are now.

    Another scene under OptiX depends on the mark.
    """
    group = {"type": "shapegroup", "shape": {"type": kind}}
    repeated = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    scene = mi.load_dict({"type": "scene", "group": group, "repeated": repeated})
    ray = mi.Ray3f(mi.Point3f(6.9, 0.2, 1), mi.Vector3f(-1, 0, -0.55))
    parameters = mi.traverse(scene)
    shape = "group.shape."
    if kind == "cube":
        vertices = np.array(parameters[shape + "vertex_positions"]).reshape(-1, 3)
        vertices[:, 0] += 5
        parameters[shape + "vertex_positions"] = on_device(mi.Float, vertices)
        # Normals that do not follow from the vertices.
        parameters[shape + "vertex_normals"] = on_device(mi.Float, np.tile([0.0, 1, 0], (24, 1)))
    else:
        parameters[shape + "to_world"] = mi.Transform4f().translate([5, 0, 0])
    # Nothing has been told of the change.
    scene.parameters_changed([])
    assert not scene.ray_test(ray)[0]
    build_again(shape_groups(scene))
    scene.parameters_changed([])
    assert scene.ray_test(ray)[0]
    if kind == "cube":
        normals = np.array(mi.traverse(scene)[shape + "vertex_normals"]).reshape(-1, 3)
        assert (normals == [0, 1, 0]).all()


def test_reading_a_scene_does_not_keep_it(mi):
    """Its shapes are freed with it, and not by the garbage collector: their number is free."""
    from lumitree.rendering.objects import shape_number

    gc.collect()
    gc.disable()
    try:
        numbers = []
        for _ in range(2):
            scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
            numbers.append(shape_number(scene.shapes()[0]))
            reusable_shapes(scene)
            del scene
    finally:
        gc.enable()
    assert numbers[0] == numbers[1]
