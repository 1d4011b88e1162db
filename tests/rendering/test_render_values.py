"""Scenes that are built in Python: dictionaries and `mitsuba.Scene`, with lamps placed in them."""

import numpy as np
import pytest

import lumitree
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.rendering.layers import Unrecorded
from support.fields import random_asset
from support.lamps import AREA, sphere
from support.lamps import scene as shapes
from support.photometric_types import ies
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
    return lumitree.render(scene, [lamp], spp=8, progress=None, **options)


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


@pytest.mark.parametrize(
    ("film", "size"),
    [
        ({"width": 0, "height": 0}, "0 x 0"),
        ({"crop_width": 0, "crop_offset_x": 0, "crop_height": 8, "crop_offset_y": 0}, "0 x 8"),
        ({"width": 100_000, "height": 100_000}, "100,000 x 100,000"),
    ],
)
@pytest.mark.parametrize("built", [True, False])
def test_images_of_no_pixels_and_huge_ones_are_refused(mi, room, film, size, built):
    room["sensor"]["film"].update(film)
    scene = mi.load_dict(room | {"integrator": tracer(mi)}) if built else room
    with pytest.raises(LumitreeError, match=f"image of {size} pixels; expected 1 to 16,384 a side"):
        lumitree.render(scene, spp=1, progress=None)


def test_a_width_may_not_make_an_image_huge(room):
    room["sensor"]["film"].update(width=1, height=1000)
    with pytest.raises(LumitreeError, match="image of 100 x 100,000 pixels"):
        lumitree.render(room, spp=1, width=100, progress=None)


def test_scenes_of_another_variant_are_told():
    scene = type("Scene", (), {"__module__": "mitsuba.scalar_rgb"})()
    options = {"points": [(0, 0, 0)], "normals": (0, 0, 1)}
    for function, values in ((lumitree.render, {}), (lumitree.illuminance, options)):
        with pytest.raises(LumitreeError, match="another variant of Mitsuba than llvm_ad_rgb"):
            function(scene, progress=None, **values)
    with pytest.raises(LumitreeError, match=r"a scene is a name, path, .*, not of type int"):
        lumitree.render(7, progress=None)


def test_names_of_scenes_are_utf8(tmp_path):
    name = tmp_path / "r\udcff.xml"
    name.write_text(SMALL_ROOM)
    for function in (lumitree.render, lumitree.photometry):
        with pytest.raises(LumitreeError, match=r"^the name .*r\?.xml is not valid UTF-8") as told:
            function(name, progress=None)
        assert str(told.value).isprintable()


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
    film = mi.load_dict(room["sensor"]["film"])
    sensors = (mi.load_dict(room["sensor"]), room["sensor"] | {"film": film})
    for built in (scene, *(room | {"sensor": sensor} for sensor in sensors)):
        with pytest.raises(LumitreeError, match=r"the scene has a film that is created already"):
            render(built, width=12)


def test_a_width_keeps_what_a_crop_window_shows(mi, room):
    squares = {"type": "checkerboard", "to_uv": mi.ScalarTransform4f().scale([9, 5, 1])}
    room["wall"]["emitter"] = {"type": "area", "radiance": squares}
    window = {"crop_width": 12, "crop_height": 6, "crop_offset_x": 2, "crop_offset_y": 8}
    whole = render(room, width=96).pixels
    room["sensor"]["film"] |= window
    image = render(room, width=48)
    assert image.resolution == (48, 24)
    part = whole[32:56, 8:56]
    # Noise at the edges of squares; of another view it is about 0.5.
    assert np.abs(image.pixels - part).mean() < 0.1 * part.mean()


def test_objects_of_the_caller_keep_their_names(mi, room):
    scene = mi.load_dict(room | {"integrator": tracer(mi)})
    names = [each.id() for each in (*scene.shapes(), *scene.sensors())]
    assert names == ["wall", "sensor"]
    render(scene)
    assert [each.id() for each in (*scene.shapes(), *scene.sensors())] == names


def test_two_parts_of_a_file_stand_where_the_file_has_them(mi, room, tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(
        shapes(sphere("left", 0.2, (-1, 0, 0), AREA), sphere("right", 0.2, (1, 0, 0), AREA))
    )
    parts = [lumitree.load_luminaire(path, keep=(name,)) for name in ("left", "right")]
    lamps = [lumitree.Placement(part) for part in parts]
    image = lumitree.render(room, lamps, spp=4, progress=None)
    # Emitters of a radiance of 3 that are seen.
    assert min(image.pixels[:, :12].max(), image.pixels[:, 12:].max()) > 1
    with pytest.raises(LumitreeError, match="two is placed twice in the same place"):
        lumitree.render(room, [lamps[0], lumitree.Placement(parts[0])], spp=4)


def test_lumens_are_those_of_the_scene_in_its_unit(mi, room):
    lamp = lumitree.Placement(random_asset(3), at=(0, 0, 0), size=1.5, lumens=800)
    images = [
        lumitree.render(room, [lamp], spp=8, unit=unit, progress=None).pixels
        for unit in ("m", "cm", 0.01)
    ]
    assert images[0].max() > 0
    assert_similar(images[1], 1e4 * images[0])
    assert_similar(images[2], images[1])


def test_a_file_in_metres_is_as_large_in_a_scene_in_centimetres(mi, tmp_path):
    from lumitree.rendering.scene import open_placements

    (tmp_path / "a.ies").write_text(ies("C", [0], [0, 90], [[100, 0]]))
    for unit, length in ((1, 0.4), (0.01, 40), (0.001, 400)):
        placed, again = open_placements([lumitree.Placement(tmp_path / "a.ies")] * 2, unit)
        assert 2 * np.linalg.norm(placed.scene_from_box[:3, 0]) == pytest.approx(length / 2)
        assert 2 * np.linalg.norm(placed.scene_from_box[:3, 2]) == pytest.approx(length)
        assert placed.asset is again.asset


@pytest.mark.parametrize("placements", [lumitree.Placement("a.lumitree"), "a.lumitree", [None]])
def test_placements_are_a_list(room, placements):
    with pytest.raises(LumitreeError, match=r"placements has .*expected a list of lumitree.Placem"):
        lumitree.render(room, placements)


def test_a_room_without_light_is_told(room):
    with pytest.warns(LumitreeWarning, match="the scene has no light, and its image is black"):
        assert not lumitree.render(room, spp=1, progress=None).pixels.any()


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


@pytest.mark.slow
def test_the_image_so_far_is_shown_while_it_is_rendered(mi, room, monkeypatch):
    """After the first pass, then not more often than every two seconds; never the last one."""
    from lumitree.rendering import passes

    monkeypatch.setattr(passes, "_SAMPLES_PER_PASS", dict.fromkeys(passes._SAMPLES_PER_PASS, 768))
    images = []
    final = render(room, so_far=images.append)
    assert [image.spp for image in images] == [2]
    assert final.spp == 8
    assert images[0].png != final.png
    monkeypatch.setattr(passes, "_SECONDS_BETWEEN_IMAGES", 0.0)
    monkeypatch.setattr(passes, "_MOST_TIME_OF_IMAGES", 1.0)
    images.clear()
    again = render(room, so_far=images.append, denoise=False, aov=True)
    assert [image.spp for image in images] == [2, 4, 6]
    assert_similar(again.pixels, final.pixels)
    assert images[0].albedo is None


def test_images_state_exposure_and_view(mi, room, tmp_path):
    import json

    from PIL import Image

    found = render(room, view="srgb")
    settings = json.loads(found.settings)
    assert (settings["view"], settings["exposure"]) == ("srgb", 0)
    assert (settings["ev"], settings["white_balance"]) == (found.ev, found.white_balance)
    found.save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert json.loads(image.info["Comment"])["ev"] == settings["ev"]
    again = render(room, exposure=f"ev={found.ev + 1}", view="srgb")
    assert again.ev == json.loads(again.settings)["ev"] == found.ev + 1
    assert np.mean(decoded(again)) < np.mean(decoded(found)) / 1.2
    with pytest.raises(LumitreeError, match="exposure is 41; expected"):
        render(room, exposure=41)
    other = render(room, white_balance="off", exposure=2.0, bloom=0.5)
    given = json.loads(other.settings)
    assert (given["white_balance"], given["bloom"]) == ("off", 0.5)
    assert_similar(other.pixels, found.pixels)
    assert (decoded(other) != decoded(found)).any()


def decoded(result):
    """Pixels of the PNG file of an image, [H, W, 3]."""
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(result.png)), int)
