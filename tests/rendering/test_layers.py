"""Light of lamps recorded apart, buffers of surfaces, budgets, and denoising."""

import dataclasses
import io
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.cli import main
from lumitree.core.images import read_exr, write_exr
from lumitree.errors import LumitreeError
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.slow import slow

ROOM = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/>
<transform name="to_world"><lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>{}</film>
</sensor>
<shape type="rectangle"><transform name="to_world"><scale value="6"/>
<translate z="-2"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.4, 0.2"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><rotate y="1" angle="20"/>
<translate x="2.2" z="-1"/></transform>
<emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter></shape>
</scene>"""


@pytest.fixture
def room(tmp_path):
    (tmp_path / "room.xml").write_text(ROOM.format(""))
    return tmp_path / "room.xml"


@pytest.fixture
def lamps(mi, tmp_path):
    """Two placements of one asset; the second is called as the layer of the room is."""
    lumitree.save(random_asset(3), tmp_path / "lamp.lumitree")
    path = str(tmp_path / "lamp.lumitree")
    return [
        lumitree.Placement(path, at=(-1.5, 0, 0), size=1.0),
        lumitree.Placement(path, at=(0, 0, 0), size=0.8, gain=2.0, label="room"),
    ]


def render(room, lamps=(), **options):
    return lumitree.render(room, lamps, progress=None, **options)


FOG = """<sensor type="perspective"><medium type="homogeneous" name="medium">
<rgb name="sigma_t" value="0.05, 0.1, 0.2"/><rgb name="albedo" value="0.9, 0.5, 0.7"/></medium>"""


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ['<sensor type="perspective">', slow(FOG)], ids=["clear", "fog"])
def test_layers_add_up_to_the_image(room, lamps, tmp_path, sensor):
    room.write_text(room.read_text().replace('<sensor type="perspective">', sensor))
    path = tmp_path / "layers.exr"
    plain = render(room, lamps, spp=64)
    result = render(room, lamps, spp=64, layers=True)
    result.save_layers(path)
    layers = {name: light for name, light in read_exr(path).items() if "." not in name}
    assert all(np.array_equal(layers[name], light) for name, light in result.layers.items())
    assert sorted(layers) == ["lamp", "room", "room_2"]
    assert sum(layers.values()) == pytest.approx(result.pixels, abs=1e-4)
    # Equal seeds; rounding may send a few paths elsewhere.
    assert np.median(np.abs(result.pixels - plain.pixels)) < 1e-5
    assert all(layer.mean() > 0.01 for layer in layers.values())


@pytest.mark.slow
def test_a_layer_has_the_light_of_its_lamp_only(room, lamps):
    """Against images with one lamp each; the second lamp has twice the gain of the first."""
    both, none = (render(room, each, spp=2048, layers=True).layers for each in (lamps, []))
    # On the right of the image no lamp is in front of the room's light.
    assert both["room"][:, 20:].mean() == pytest.approx(none["room"][:, 20:].mean(), rel=0.03)
    dark = [lumitree.Placement(lamps[0].source, at=lamps[0].at, size=1.0, gain=0.0), lamps[1]]
    layers = render(room, dark, spp=64, layers=True).layers
    assert not layers["lamp"].any()
    assert layers["room_2"].mean() > 0.01


@pytest.mark.slow
def test_layers_of_geometries(mi, room, tmp_path):
    """A lamp without gain shows nothing, and the other one its own shapes."""
    path = str(tmp_path / "geometry.lumitree")
    lumitree.save(with_geometry(small_geometry()), path)
    lamps = [
        lumitree.Placement(path, at=(-1.2, 0, 1), size=1.5, label="on"),
        lumitree.Placement(path, at=(0.8, 0, 1), size=1.5, gain=0, label="off"),
    ]
    result = render(room, lamps, spp=256, layers=True)
    layers = result.layers
    assert sum(layers.values()) == pytest.approx(result.pixels, abs=1e-3)
    assert not layers["off"].any()
    left, right = layers["on"][4:12, 2:10].max(), layers["on"][4:12, 16:].max()
    assert left > 3 * right > 0


@pytest.mark.slow
def test_mix_changes_the_light_of_one_layer(room, lamps, tmp_path):
    path = tmp_path / "layers.exr"
    result = render(room, lamps, spp=16, layers=True)
    result.save_layers(path)
    layers = result.layers
    assert np.array_equal(lumitree.mix(layers).pixels, lumitree.mix(path).pixels)
    assert lumitree.mix(path).pixels == pytest.approx(result.pixels, abs=1e-5)
    mixed = lumitree.mix(path, {"lamp": (0, 1, 2), "room": 0.5})
    expected = layers["lamp"] * [0, 1, 2] + layers["room"] * 0.5 + layers["room_2"]
    assert mixed.pixels == pytest.approx(expected, abs=1e-5)
    assert mixed.layers == ["lamp", "room", "room_2"]
    plain = lumitree.mix(path)
    assert (mixed.ev, mixed.white_balance) == (plain.ev, plain.white_balance)
    assert lumitree.mix(path, exposure="ev=0.25").ev == 0.25
    with pytest.raises(LumitreeError, match="the image is not made of layers only"):
        lumitree.mix(layers | {"odd": layers["room"][1:]})
    with pytest.raises(LumitreeError, match=r"no layer 'hall'; it has lamp, room, room_2"):
        lumitree.mix(path, gain={"hall": 2})
    with pytest.raises(LumitreeError, match="gain"):
        lumitree.mix(path, gain={"lamp": -1})
    image = tmp_path / "image.exr"
    dark = render(room, spp=1)
    dark.save(image)
    with pytest.raises(LumitreeError, match="no layers; render it with layers=True"):
        dark.save_layers(path)
    with pytest.raises(LumitreeError, match="no albedo and normals; render it with aov=True"):
        dark.save_aov(path)
    with pytest.raises(LumitreeError, match=r"'a.png' does not end in \.exr"):
        result.save_layers("a.png")
    with pytest.raises(LumitreeError, match="is not made of layers only; expected"):
        lumitree.mix(image)
    render(room, spp=1, aov=True).save_aov(image)
    with pytest.raises(LumitreeError, match="is not made of layers only; expected"):
        lumitree.mix(image)


def test_mixed_lamps_are_clamped_before_pixels_are_averaged(room, lamps, tmp_path):
    """The edge of the room's emitter, as of an image that was rendered with the gain."""
    path, shown = tmp_path / "layers.exr", {"exposure": "ev=-9.5", "white_balance": "off"}
    result = render(room, lamps, spp=32, layers=True, **shown)
    highlights = result.layer_highlights
    assert result.highlights is not None
    assert highlights["room"].square.max() == pytest.approx(4, rel=1e-4)
    for name in ("seen", "square"):
        total = sum(getattr(each, name) for each in highlights.values())
        assert total == pytest.approx(getattr(result.highlights, name), rel=1e-4, abs=1e-6)
    result.save_layers(path)
    from_file, from_result = (pixels_of(lumitree.mix(each, **shown)) for each in (path, result))
    assert np.array_equal(from_file, from_result)
    assert from_file == pytest.approx(pixels_of(result), abs=1)
    room.write_text(room.read_text().replace("3, 2, 1", "9, 6, 3"))
    brighter = pixels_of(render(room, lamps, spp=32, layers=True, **shown))
    found = pixels_of(lumitree.mix(path, {"room": 3}, **shown))
    assert found == pytest.approx(brighter, abs=1)
    # Files of versions without highlights.
    write_exr(path, result.layers)
    old = pixels_of(lumitree.mix(path, {"room": 3}, **shown))
    assert (old - brighter).max() > 20


def pixels_of(image):
    return np.asarray(Image.open(io.BytesIO(image.png)), int)


@pytest.mark.slow
def test_layers_have_no_names_of_other_channels(room, lamps, tmp_path):
    path = tmp_path / "layers.exr"
    named = [
        lumitree.Placement(lamps[0].source, at=(x, 0, 0), size=0.5, label=label)
        for x, label in ((-1, "RGB"), (0, "RGBA"), (1, "RGB"))
    ]
    result = render(room, named, spp=4, layers=True)
    assert list(result.layers) == ["room", "RGB_2", "RGBA_2", "RGB_3"]
    result.save_layers(path)
    assert lumitree.mix(path).pixels == pytest.approx(result.pixels, abs=1e-5)


def test_buffers_describe_the_surfaces(mi, room, tmp_path):
    """Against Mitsuba's integrator `aov`, where a single surface covers the pixel."""
    result = render(room, spp=64, aov=True)
    result.save_aov(tmp_path / "aov.exr")
    assert result.albedo is not None
    assert result.normals is not None
    found = read_exr(tmp_path / "aov.exr")
    scene = mi.load_file(str(room))
    aov = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,nn:sh_normal"})
    expected = np.array(mi.render(scene, integrator=aov, spp=64))
    inner = slice(1, 16), slice(1, 12)
    assert np.array_equal(found["albedo"], result.albedo)
    assert np.array_equal(found["RGB"], result.pixels)
    assert found["albedo"][inner] == pytest.approx(expected[inner][..., :3], abs=0.01)
    normal = np.stack([found[f"normal.{c}"] for c in "XYZ"], axis=-1)
    assert np.array_equal(normal, result.normals)
    assert normal[inner] == pytest.approx(expected[inner][..., 3:6], abs=0.01)
    assert found["albedo"][8, 5] == pytest.approx([0.6, 0.4, 0.2], abs=0.01)


@pytest.mark.slow
def test_noise_is_the_deviation_between_seeds(mi, room):
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.scene import load_scene

    scene, integrator = load_scene(str(room), box_filter=True)
    images = [
        render_passes(scene, integrator, Budget(32, noise=1e-4), seed=seed) for seed in range(24)
    ]
    grey = np.array([image.radiance for image in images], np.float64).mean(axis=-1)
    blocks = [
        (rows, columns) for rows in halves(grey.shape[1]) for columns in halves(grey.shape[2])
    ]
    level = np.array([grey[:, rows, columns].mean() for rows, columns in blocks])
    variance = grey.var(axis=0, ddof=1)
    error = np.sqrt([variance[each].mean() for each in blocks])
    weights = 1 / np.maximum(level, np.median(level))
    measured = (weights * error).sum() / (weights * level).sum()
    assert np.mean([image.noise or 0 for image in images]) == pytest.approx(measured, rel=0.1)
    assert all(image.spp == 32 for image in images)


@pytest.mark.parametrize("broken", [None, np.nan, np.inf])
@pytest.mark.parametrize("chance", [0.3, 0.003])
def test_noise_of_light_that_rare_samples_find(mi, chance, broken):
    """Nor does a lamp that is seen without noise hide it, or a pixel in each block that is NaN."""
    from lumitree.rendering.passes import Budget, render_passes

    generator = np.random.default_rng(5)

    def passes(plan):
        for _, samples in plan:
            light = generator.binomial(samples, chance, (64, 80)) / samples / chance
            light[:16, :16] = 1e4
            if broken is not None:
                light[5::16, 3::16] = broken
            yield np.repeat(light[..., None], 3, axis=-1).astype(np.float32)

    film = SimpleNamespace(crop_size=lambda: [80, 64])
    scene: Any = SimpleNamespace(sensors=lambda: [SimpleNamespace(film=lambda: film)])
    found = render_passes(
        scene, scene, Budget(40, noise=1e-4), renderer=lambda plan: nullcontext(passes(plan))
    )
    # One of the 20 blocks has no noise.
    expected = 0.95 * np.sqrt((1 - chance) / chance / 40)
    assert found.noise == pytest.approx(expected, rel=0.05)


def halves(size):
    """Slices of 16 pixels."""
    return [slice(start, start + 16) for start in range(0, size, 16)]


def test_a_render_stops_at_the_first_limit(room):
    assert render(room).spp == 64
    found = render(room, noise=0.05)
    assert found.noise is not None
    assert found.noise <= 0.05
    assert 8 <= found.spp < 1 << 14
    assert render(room, noise=1e-4, spp=20).spp == 20
    assert 1 <= render(room, time=1e-3).spp <= 16


def test_a_pass_that_would_end_too_late_is_not_begun(mi, room, monkeypatch):
    """A clock that advances by a second for each pass."""
    from lumitree.rendering import passes
    from lumitree.rendering.scene import load_scene

    scene, integrator = load_scene(str(room))
    ticks = iter(range(100))
    monkeypatch.setattr(passes.time, "perf_counter", lambda: float(next(ticks)))
    # The clock is read before the first pass, and before and after each.
    image = passes.render_passes(scene, integrator, passes.Budget(seconds=6.5))
    assert image.spp == 3 * 16
    assert image.seconds == 6


@pytest.mark.parametrize(
    "film",
    ["", '<rfilter type="mitchell"/>', '<rfilter type="box"/>'],
    ids=["none", "other", "box"],
)
def test_the_filter_becomes_a_box(mi, tmp_path, film):
    from lumitree.rendering.scene import load_scene

    path = tmp_path / "room.xml"
    path.write_text(ROOM.format(film))
    scene, _ = load_scene(str(path), box_filter=True)
    film = scene.sensors()[0].film()
    assert film.rfilter().class_name() == "BoxFilter"
    assert tuple(film.size()) == (24, 16)


@pytest.mark.slow
def test_denoising_reduces_the_error_and_leaves_what_is_seen(mi, room, lamps):
    pytest.importorskip("mitsuba_oidn", reason="the optional dependency denoise is not installed")
    room.write_text(ROOM.format('<rfilter type="box"/>'))
    reference = render(room, lamps, spp=512, width=96)
    noisy = render(room, lamps, spp=4, width=96)
    clean = render(room, lamps, spp=4, width=96, denoise=True)
    errors = [np.abs(each.pixels - reference.pixels).mean() for each in (noisy, clean)]
    assert errors[1] < 0.8 * errors[0]
    assert clean.pixels.mean() == pytest.approx(reference.pixels.mean(), rel=0.05)
    # The light itself, away from its edges.
    seen = slice(30, 34), slice(78, 82)
    assert clean.pixels[seen] == pytest.approx(noisy.pixels[seen], rel=1e-3)


def test_without_the_denoiser_nothing_is_rendered(room, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    with pytest.raises(
        LumitreeError, match=r"needs the package mitsuba-oidn .* 'lumitree\[denoise"
    ):
        render(room, denoise=True)


def test_a_photograph_without_the_denoiser_is_told(monkeypatch):
    import sys

    from lumitree.errors import LumitreeWarning
    from lumitree.rendering.layers import denoised_pixels

    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    pixels = np.random.default_rng(0).integers(0, 256, (4, 4, 3), np.uint8)
    with pytest.warns(LumitreeWarning, match=r"not denoised, .* 'lumitree\[denoise"):
        assert np.array_equal(denoised_pixels(pixels), pixels)


def test_heterogeneous_media_have_no_layers(room):
    medium = '<medium type="heterogeneous" name="interior"/>'
    text = room.read_text().replace("</bsdf></shape>", f"</bsdf>{medium}</shape>", 1)
    room.write_text(text)
    with pytest.raises(LumitreeError, match=r"heterogeneous media; denoise, layers"):
        render(room, layers=True)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"noise": 0.0}, "noise"),
        ({"time": -1.0}, "time"),
    ],
)
def test_wrong_arguments_are_refused(room, options, match):
    with pytest.raises(LumitreeError, match=match):
        render(room, **options)


@pytest.mark.parametrize("gain", ["lamp", "=2", "lamp=a", "lamp=1,2"])
def test_wrong_gains_are_refused(tmp_path, capsys, gain):
    assert main(["mix", "layers.exr", "-o", str(tmp_path / "a.png"), "--gain", gain]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not" in line


@pytest.mark.parametrize("option", ["--layers", "--aov"])
def test_wrong_names_of_layers_are_refused_before_any_work(tmp_path, capsys, option):
    assert main(["render", "no.xml", "-o", str(tmp_path / "a.png"), option, "a.png"])
    assert "'a.png' does not end in .exr" in capsys.readouterr().err


def test_a_gain_by_a_pattern_is_of_all_layers_that_match(mi):
    layers = {name: np.full((2, 2, 3), 1, np.float32) for name in ("hall", "hall_2", "room")}
    assert lumitree.mix(layers, {"hall*": 0.5}).pixels == pytest.approx(2.0)


@pytest.mark.parametrize("gain", [1, 1e6])
def test_mixtures_beyond_single_precision_are_refused(mi, gain):
    bright = np.full((2, 2, 3), 2e38, np.float32)
    layers = {"lamp": bright, "room": bright}
    with pytest.raises(LumitreeError, match=r"not finite, or above 1e\+30"):
        lumitree.mix(layers, {"lamp": gain})


@pytest.mark.parametrize("pixel_format", ["rgba", "luminance", slow("xyz"), slow("xyza")])
def test_films_of_other_formats_are_read_as_rgb(room, pixel_format):
    """Their layers and albedo are read, too."""
    expected = render(room, spp=1, layers=True, aov=True)
    film = f'<string name="pixel_format" value="{pixel_format}"/>'
    room.write_text(ROOM.format(film))
    found = render(room, spp=1, layers=True, aov=True)
    assert found.pixels == pytest.approx(expected.pixels, abs=1e-5)
    assert found.albedo == pytest.approx(expected.albedo, abs=1e-5)
    assert found.layers.keys() == expected.layers.keys()


def test_films_that_are_created_already(mi):
    """Alpha is left out; one without R, G and B is refused."""
    light = {"type": "constant", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    for pixel_format in ("rgba", "luminance", "xyz"):
        made = mi.load_dict({**film, "pixel_format": pixel_format})
        sensor = {"type": "perspective", "film": made}
        path = {"type": "path"}
        scene = {"type": "scene", "light": light, "sensor": sensor, "integrator": path}
        if pixel_format == "rgba":
            found = lumitree.render(scene, spp=1, aov=True)
            assert found.pixels == pytest.approx(np.broadcast_to([3, 2, 1], (4, 4, 3)))
            assert found.albedo is not None
            assert found.albedo.shape == (4, 4, 3)
            continue
        with pytest.raises(LumitreeError, match="does not store R, G and B"):
            lumitree.render(scene, spp=1)


def test_long_labels_are_cut_to_what_a_file_holds(room, lamps, tmp_path):
    """Names of channels have 255 bytes at most; beyond them three channels would be one."""
    long = [dataclasses.replace(each, label="ä" * 200) for each in lamps]
    render(room, long, spp=1, layers=True).save_layers(tmp_path / "layers.exr")
    layers = read_exr(tmp_path / "layers.exr")
    names = {name.partition(".")[0] for name in layers}
    assert sorted(names) == ["room", "ä" * 100, "ä" * 100 + "_2"]


@pytest.mark.parametrize("by_lamp", [None, False])
def test_lamps_that_are_seen_are_recorded_with_their_squares(mi, by_lamp):
    """So the radiance of an emitter is known in pixels that it covers in part."""
    from lumitree.rendering.passes import Budget
    from lumitree.rendering.render_job import Described, RenderJob

    turned = mi.ScalarTransform4f().translate([0, 0, 9]).rotate([1, 0, 0], 180).scale(9)
    film = {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    described = {
        "type": "scene",
        "integrator": {"type": "lumitree_path"},
        "lamp": {"type": "sphere", "center": [0, 0, 5], "emitter": emitter},
        "wall": {"type": "rectangle", "to_world": turned},
        "sensor": {"type": "perspective", "film": film},
    }
    job = RenderJob(Described(described, (), None, 1.0, True, by_lamp))
    rendering, _ = job.rendered(Budget(16), 0, None, None, None)
    found = job.highlights(rendering)
    assert found is not None
    grey = found.seen.mean(axis=-1)
    assert 0 < (grey > 0).mean() < 0.5
    partly = (grey > 0) & (grey < 1.9)
    assert partly.any()
    assert found.square[grey > 0] / grey[grey > 0] == pytest.approx(2, rel=1e-5)
    assert (rendering.radiance >= found.seen - 1e-6).all()
