"""Scenes with many lamps: how they are loaded, and which lamps overlap."""

import warnings

import numpy as np
import pytest
from test_scene import empty_room

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame, rotation, similarity
from lumitree.errors import LumitreeError, LumitreeWarning
from support.lamps import AREA, lamp_of, sphere
from support.light_fields import random_light_field

COUNT = 60


@pytest.fixture
def asset(tmp_path):
    frame = LocalFrame(np.ones(3), np.eye(4))
    lumitree.save(
        light_field_asset(random_light_field(0), frame, "lamp"), tmp_path / "lamp.lumitree"
    )
    return str(tmp_path / "lamp.lumitree")


@pytest.fixture
def created(monkeypatch, mi):
    """How many tables were made, and how deep they were made within each other."""
    from lumitree.core import alias_table
    from lumitree.rendering.emitter import PlacedLamp

    found = {"tables": 0, "depth": 0, "deepest": 0}
    table, make = alias_table.AliasTable.__init__, PlacedLamp.make_tables

    def counting(*args):
        found["tables"] += 1
        table(*args)

    def nested(lamp):
        found["depth"] += 1
        found["deepest"] = max(found["deepest"], found["depth"])
        make(lamp)
        found["depth"] -= 1

    monkeypatch.setattr(alias_table.AliasTable, "__init__", counting)
    monkeypatch.setattr(PlacedLamp, "make_tables", nested)
    return found


def loaded_as_shapes(mi, asset, tmp_path):
    place = mi.ScalarTransform4f().translate
    shapes = {f"lamp{i}": lumitree.shape(asset, place([3 * i, 0, 0])) for i in range(COUNT)}
    return mi.load_dict({"type": "scene", **shapes})


def loaded_as_file(mi, asset, tmp_path):
    lamps = "".join(
        f'<shape type="lumitree_proxy"><string name="filename" value="{asset}"/>'
        f'<transform name="to_world"><translate x="{3 * i}"/></transform></shape>'
        for i in range(COUNT)
    )
    (tmp_path / "room.xml").write_text(f'<scene version="3.0.0">{lamps}</scene>')
    return mi.load_file(str(tmp_path / "room.xml"))


def loaded_as_placements(mi, asset, tmp_path):
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import open_placements, place_luminaires

    items = open_placements([Placement(asset, at=(3 * i + 9, 0, 0)) for i in range(COUNT)])
    return place_luminaires(empty_room(mi), items)


@pytest.mark.parametrize("load", [loaded_as_shapes, loaded_as_file, loaded_as_placements])
def test_lamps_are_not_created_within_each_other(mi, asset, tmp_path, created, load):
    """Mitsuba's tasks that wait execute others: 155 lamps ended in a RecursionError."""
    scene = load(mi, asset, tmp_path)
    assert len(scene.emitters()) == COUNT
    assert (created["tables"], created["deepest"]) == (1, 1)


def test_a_step_that_fails_leaves_none_behind(mi):
    from lumitree.rendering.objects import complete_later

    done = []

    def failing():
        complete_later(lambda: done.append("left over"))
        raise LumitreeError("no light")

    with pytest.raises(LumitreeError):
        complete_later(failing)
    complete_later(lambda: done.append("next"))
    assert done == ["next"]


def test_too_many_geometries_within_each_other_are_explained(mi, monkeypatch, asset):
    from lumitree.rendering import register as plugins
    from lumitree.rendering import shapes as proxy_shape

    def endless(*args, **options):
        raise RecursionError

    monkeypatch.setattr(proxy_shape, "make_shapes", endless)
    monkeypatch.setattr(plugins, "_registered", set())
    plugins.register()
    try:
        with pytest.raises(RuntimeError, match="load it with parallel=False"):
            mi.load_dict({"type": "lumitree_proxy", "filename": asset})
    finally:
        monkeypatch.undo()
        plugins._registered.clear()
        plugins.register()


def test_an_explicit_luminaire_is_loaded_once(mi, monkeypatch, tmp_path):
    from lumitree.rendering import scene
    from lumitree.rendering.placement import Placement

    lamp_of(tmp_path, sphere("bulb", 1, inside=AREA))
    lamp = str(tmp_path / "lamp.xml")
    read, load = [], scene.load_luminaire
    monkeypatch.setattr(scene, "load_luminaire", lambda source: read.append(source) or load(source))
    placed = scene.open_placements([Placement(lamp, at=(i, 0, 0), size=0.5) for i in range(3)])
    assert read == [lamp]
    assert [box.scene_from_box[0, 3] for box in placed] == [0, 1, 2]


def random_boxes(random, count):
    boxes = []
    for _ in range(count):
        turn = rotation(random.normal(size=3), random.uniform(0, 360))
        box = similarity(turn, 1.0, random.uniform(-2, 2, 3))
        boxes.append(box @ np.diag([*random.uniform(0.1, 1, 3), 1]))
    return np.array(boxes)


def test_overlapping_boxes_are_those_that_share_points(mi):
    from lumitree.rendering.placement_checks import overlapping

    random = np.random.default_rng(0)
    boxes = random_boxes(random, 30)
    found = {(int(i), int(j)) for i, j in overlapping(boxes)}
    points = np.concatenate([random.uniform(-1, 1, (20000, 3)), np.ones((20000, 1))], axis=1)
    sharing, near = set(), 0
    for i in range(len(boxes)):
        for j in range(i + 1, len(boxes)):
            local = points @ (np.linalg.inv(boxes[j]) @ boxes[i]).T
            if (np.abs(local[:, :3]) < 0.99).all(axis=1).any():
                sharing.add((i, j))
            apart = np.abs(boxes[i, :3, 3] - boxes[j, :3, 3])
            near += (apart < np.abs(boxes[[i, j], :3, :3]).sum(axis=(0, 2))).all()
    assert sharing <= found
    # Boxes that share less than about a 20,000th of a box are found as well, but few do.
    assert len(found - sharing) <= 0.1 * len(sharing)
    assert near > len(found), "axes of the scene alone would not do"


@pytest.mark.parametrize(
    ("turn", "gap", "overlap"), [(0, -0.01, True), (0, 0.0, False), (0, 0.01, False),
                                 (45, 0.4, True), (45, 0.42, False)]
)  # fmt: skip
def test_boxes_that_only_touch_do_not_overlap(mi, turn, gap, overlap):
    """A cube beside one that is turned: its edge reaches √2 - 1 = 0.414 farther."""
    from lumitree.rendering.placement_checks import overlapping

    beside = similarity(rotation([0, 0, 1], turn), 1.0, [2 + gap, 0, 0])
    assert bool(len(overlapping(np.array([np.eye(4), beside])))) == overlap


def warned(mi, *placements):
    from lumitree.rendering.scene import open_placements, place_luminaires

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LumitreeWarning)
        place_luminaires(empty_room(mi), open_placements(placements))
    return [str(each.message) for each in caught]


def test_lamps_that_overlap_are_warned_of_once(mi, asset):
    from lumitree.rendering.placement import Placement

    apart = [Placement(asset, at=(2.0 * i, 0, 0), label=f"n{i}") for i in range(4)]
    assert warned(mi, *apart) == []
    (message,) = warned(mi, *apart, Placement(asset, at=(1, 1, 0), label="sixth"))
    assert message.startswith("n0 at (0, 0, 0) and sixth at (1, 1, 0), and 1 more pair, are lamps")


def test_a_lamp_in_the_place_of_the_same_lamp_is_twice_the_light(mi, asset):
    from lumitree.rendering.placement import Placement

    (message,) = warned(mi, Placement(asset, label="a"), Placement(asset, at=(0, 1e-5, 0)))
    assert message.startswith("a at (0, 0, 0) and ")
    assert "the same lamp in the same place: twice the light" in message


def test_explicit_lamps_may_overlap_each_other_only(mi, asset, tmp_path):
    from lumitree.rendering.placement import Placement

    lamp_of(tmp_path, sphere("bulb", 1, inside=AREA))
    lamp = str(tmp_path / "lamp.xml")
    explicit = [Placement(lamp, at=(x, 0, 0), label=f"x{x}") for x in (3, 4)]
    assert warned(mi, *explicit) == []
    (message,) = warned(mi, *explicit, Placement(asset, at=(2, 0, 0), label="baked"))
    assert "x3 at (3, 0, 0) and baked at (2, 0, 0) are lamps whose boxes overlap" in message


def test_objects_in_boxes_are_found_for_each_box(mi):
    from lumitree.rendering.placement_checks import contains_objects

    ball = {"type": "sphere", "center": [5, 0, 0], "radius": 0.3}
    scene = mi.load_dict({"type": "scene", "ball": ball})
    boxes = np.array([similarity(np.eye(3), 0.5, [x, 0, 0]) for x in np.arange(0, 301, 0.5)])
    assert np.flatnonzero(contains_objects(scene.shapes(), boxes)).tolist() == [9, 10, 11]


@pytest.mark.parametrize(("lamp", "parallel"), [("lumitree_proxy", False), ("sphere", True)])
def test_a_scene_file_with_lamps_is_created_in_one_thread(mi, asset, tmp_path, lamp, parallel):
    from lumitree.lamp.scene_file import SceneFile

    shape = sphere("ball", 1)
    if lamp == "lumitree_proxy":
        shape = f'<shape type="{lamp}"><string name="filename" value="{asset}"/></shape>'
    (tmp_path / "room.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    file = SceneFile(tmp_path / "room.xml")
    assert len(file.instantiate().shapes()) == 1
    assert file._config.parallel == parallel


@pytest.mark.parametrize(("at", "size", "told"), [(500, 1.0, False), (3e3, 1.0, True),
                                                  (3e3, 100.0, False)])  # fmt: skip
def test_a_lamp_too_far_for_the_coordinates_of_the_scene_is_told_of(mi, asset, at, size, told):
    from lumitree.rendering.placement import Placement

    messages = warned(mi, Placement(asset, at=(0, at, 0), size=size, label="far"))
    assert len(messages) == told
    for message in messages:
        assert message.startswith("far: at 3000 units from the origin")
        assert "multiples of 0.00024, 0.02% of its size" in message
