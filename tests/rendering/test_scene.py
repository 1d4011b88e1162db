"""Scenes with luminaires placed in them: what is read, when it stops, and what is warned of."""

import signal
import warnings

import numpy as np
import pytest

import lumitree
from lumitree.core.device import on_device
from lumitree.errors import LumitreeWarning
from support.fields import random_asset
from support.lamps import sphere

ROOM = '<scene version="3.0.0"><integrator type="{}"/><sensor type="perspective"/>{}</scene>'


@pytest.fixture
def loads(monkeypatch):
    """Paths of the assets that were read."""
    from lumitree.rendering import asset_cache as opened

    read, load = [], opened.read_asset

    def counting(path):
        read.append(path)
        return load(path)

    monkeypatch.setattr(opened, "read_asset", counting)
    return read


@pytest.fixture
def asset(mi, tmp_path):
    lumitree.save(random_asset(3), tmp_path / "lamp.lumitree")
    return str(tmp_path / "lamp.lumitree")


def empty_room(mi, width=8):
    film = {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])
    sensor = {"type": "perspective", "to_world": look, "film": film}
    return mi.load_dict({"type": "scene", "sensor": sensor})


@pytest.mark.parametrize("places", [[(0, 0, 0)], [(-2, 0, 0), (2, 0, 0)]])
def test_an_asset_is_read_once_however_often_it_is_placed(mi, asset, loads, places):
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    items = [PlacedLuminaire(Placement(asset, at=at)) for at in places]
    scene = place_luminaires(empty_room(mi), items)
    assert len(scene.emitters()) == len(places)
    assert len(loads) == 1


def test_emitters_have_the_same_order_each_time(mi, asset):
    """Otherwise emitters are chosen by other random numbers, and equal seeds differ."""
    from lumitree.rendering.demo_room import demo_room
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    orders = set()
    for _ in range(6):
        items = [PlacedLuminaire(Placement(asset, at=(x, 0, 0))) for x in (3, 6, 9)]
        scene = place_luminaires(demo_room(16), items)
        centres = np.array([emitter.get_shape().bbox().center() for emitter in scene.emitters()])
        orders.add(centres.round(3).tobytes())
    assert len(scene.emitters()) == 5
    assert len(orders) == 1


def test_the_ball_of_the_demonstration_hangs_in_the_box_clear_of_the_lamp(mi):
    from lumitree.demo import LUMINAIRE
    from lumitree.rendering import demo_room
    from lumitree.rendering.scene import PlacedLuminaire

    placed = PlacedLuminaire(demo_room.lamp(LUMINAIRE))
    centre, radius = np.array(demo_room.BALL_CENTRE), demo_room.BALL_RADIUS
    box = placed.scene_from_box
    inside = np.abs(np.linalg.solve(box, [*centre, 1])[:3]) * np.diag(box)[:3]
    assert (inside + radius < np.diag(box)[:3]).all()
    lamp = mi.load_dict({"type": "scene", **placed.shapes("emission", "field")})
    directions = np.random.default_rng(0).normal(size=(1 << 14, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(*centre.tolist()), on_device(mi.Vector3f, directions))
    assert np.array(lamp.ray_intersect_preliminary(ray).t).min() > 1.1 * radius
    with_ball, without = (
        len(demo_room.demo_room(16, ball_in_box=ball).shapes()) for ball in (True, False)
    )
    assert with_ball == without + 2


def test_a_shape_is_read_once(mi, asset, loads):
    scene = mi.load_dict({"type": "scene", "lamp": lumitree.shape(asset)})
    assert len(scene.emitters()) == 1
    assert len(loads) == 1


def test_a_scene_file_reads_its_asset_once(mi, asset, loads, tmp_path):
    (tmp_path / "room.xml").write_text(
        '<scene version="3.0.0"><shape type="lumitree_proxy">'
        f'<string name="filename" value="{asset}"/></shape></scene>'
    )
    assert len(mi.load_file(str(tmp_path / "room.xml")).emitters()) == 1
    assert len(loads) == 1


def test_an_asset_that_has_changed_is_read_again(mi, asset, loads):
    first = lumitree.shape(asset)
    lumitree.save(random_asset(4), asset)
    second = lumitree.shape(asset)
    assert len(loads) == 2
    assert first.asset is not second.asset


def test_an_interrupt_ends_a_render_after_the_pass(mi, monkeypatch):
    from lumitree.rendering import passes as module
    from lumitree.rendering.scene import default_integrator

    rendered, render = [], mi.render

    def interrupted(*args, **options):
        image = render(*args, **options)
        rendered.append(options["spp"])
        signal.raise_signal(signal.SIGINT)
        return image

    monkeypatch.setattr(module.mi, "render", interrupted)
    passes = dict.fromkeys(module._SAMPLES_PER_PASS, 4 * 64)
    monkeypatch.setattr(module, "_SAMPLES_PER_PASS", passes)
    with pytest.raises(KeyboardInterrupt):
        module.render_passes(empty_room(mi), default_integrator(), module.Budget(12))
    assert rendered == [4]


@pytest.mark.parametrize(
    ("integrator", "at", "size", "warned"),
    [
        ("volpath", (0, 0, 0), 1.0, False),
        ("volpath", (0, 3e3, 0), 1.0, True),
        ("volpath", (0, 3e3, 0), 500.0, False),
        ("volpathmis", (0, 0, 0), 1e-4, True),
        ("path", (0, 3e3, 0), 1.0, False),
    ],
)
def test_a_lamp_too_far_or_too_small_for_volpath_is_warned_of(
    mi, asset, tmp_path, integrator, at, size, warned
):
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, load_scene

    path = tmp_path / "room.xml"
    path.write_text(ROOM.format(integrator, sphere("a", 1)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LumitreeWarning)
        load_scene(str(path), [PlacedLuminaire(Placement(asset, at=at, size=size))])
    messages = [str(each.message) for each in caught]
    assert any("volpath starts rays" in message for message in messages) == warned


@pytest.mark.slow
def test_volpath_is_off_where_it_is_warned_of(mi, asset):
    """Light on a floor below a lamp that is 3,000 times its size from the origin."""
    from test_coordinates import mean_radiance

    def lamp(place):
        return lumitree.shape(asset, place)

    near, _ = mean_radiance(mi, lamp, "floor", [0, 0, 0], 1, "volpath")
    far, _ = mean_radiance(mi, lamp, "floor", [3e3] * 3, 1, "volpath")
    assert (np.abs(far / near - 1) > 0.01).all()
