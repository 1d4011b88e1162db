"""Scenes that are built in Python: dictionaries and `mitsuba.Scene`, with lamps placed in them."""

import numpy as np
import pytest

import lumitree
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.rendering.layers import Unrecorded
from support.fields import random_asset
from support.small_room import SMALL_ROOM


@pytest.fixture
def room(mi):
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": transform().look_at([0, 1, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}},
        },
        "wall": {"type": "rectangle", "to_world": transform().translate([0, 0, -2]).scale(6)},
    }


def render(scene, **options):
    lamp = lumitree.Placement(random_asset(3), at=(0, 0, 0), size=1.5, label="lamp")
    return lumitree.render(scene, [lamp], samples_per_pixel=8, progress=None, **options)


def assert_similar(first, second):
    """Equal seeds; samples of a pixel are added in any order."""
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-6)


def tracer(mi, **options):
    lumitree.register()
    return mi.load_dict({"type": "lumitree_path", "max_depth": 3, **options})


def test_files_dictionaries_and_scenes_give_equal_images(mi, room, tmp_path):
    (tmp_path / "room.xml").write_text(SMALL_ROOM)
    file = render(tmp_path / "room.xml").pixels
    assert file.max() > 0
    assert_similar(render(room).pixels, file)
    built = mi.load_dict(room | {"integrator": tracer(mi)})
    assert_similar(render(built).pixels, file)


def test_a_dictionary_may_hold_objects(mi, room):
    objects = {
        "integrator": tracer(mi),
        "sensor": mi.load_dict(room["sensor"]),
        "wall": mi.load_dict(room["wall"]),
    }
    assert_similar(render(room | objects).pixels, render(room).pixels)


def test_layers_of_a_scene_leave_its_integrator_as_it_was(mi, room):
    integrator = tracer(mi)
    scene = mi.load_dict(room | {"integrator": integrator})
    first = render(scene, layers=True)
    assert list(first.layers) == ["room", "lamp"]
    assert not first.layers["room"].any()
    assert type(integrator.layers) is Unrecorded
    assert_similar(render(scene).pixels, render(scene).pixels)


def test_dictionaries_take_widths_and_scenes_do_not(mi, room):
    assert render(room, width=12).resolution == (12, 8)
    assert room["sensor"]["film"]["width"] == 24
    scene = mi.load_dict(room | {"integrator": tracer(mi)})
    for built in (scene, room | {"sensor": mi.load_dict(room["sensor"])}):
        with pytest.raises(LumitreeError, match=r"the scene has a film that is created already"):
            render(built, width=12)


def test_the_path_integrator_of_a_scene_is_replaced_with_a_warning(mi, room):
    with pytest.warns(LumitreeWarning, match=r"PathIntegrator, which is created already; using"):
        render(mi.load_dict(room))


def test_scenes_that_cannot_be_rendered_are_refused(mi, room):
    del room["sensor"]
    for scene in (room, mi.load_dict(room)):
        with pytest.raises(LumitreeError, match="the scene has no sensor"):
            render(scene)
    with pytest.raises(LumitreeError, match="the scene's dictionary cannot be loaded"):
        render({"type": "scene", "wall": {"type": "no_such_plugin"}})


def test_the_image_so_far_is_shown_while_it_is_rendered(mi, room, monkeypatch):
    """After the first pass, then not more often than every two seconds; never the last one."""
    from lumitree.rendering import passes

    monkeypatch.setattr(passes, "_SAMPLES_PER_PASS", dict.fromkeys(passes._SAMPLES_PER_PASS, 768))
    images = []
    final = render(room, so_far=images.append)
    assert [image.samples_per_pixel for image in images] == [2]
    assert final.samples_per_pixel == 8
    assert images[0].png != final.png
    monkeypatch.setattr(passes, "_SECONDS_BETWEEN_IMAGES", 0.0)
    monkeypatch.setattr(passes, "_MOST_TIME_OF_IMAGES", 1.0)
    images.clear()
    again = render(room, so_far=images.append, denoise=False, aov=True)
    assert [image.samples_per_pixel for image in images] == [2, 4, 6]
    assert_similar(again.pixels, final.pixels)
    assert images[0].albedo is None


def test_images_state_exposure_and_view(mi, room, tmp_path):
    import io
    import json

    from PIL import Image

    found = render(room, view="standard")
    settings = json.loads(found.settings)
    assert settings["view"] == "standard"
    assert settings["exposure"] == pytest.approx(found.exposure)
    found.save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert json.loads(image.info["Comment"])["exposure"] == settings["exposure"]
    pytest.importorskip("PyOpenColorIO", reason="the optional dependency filmic is not installed")
    filmic = render(room, view="filmic")
    assert_similar(filmic.pixels, found.pixels)
    shown, clipped = (np.asarray(Image.open(io.BytesIO(each.png)), int) for each in (filmic, found))
    assert (shown != clipped).any()
