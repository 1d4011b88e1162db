"""Glare of views, against the formula of CIE 117."""

import dataclasses
import functools
import math

import numpy as np
import pytest

import lumitree
from support.ies_text import ies_text
from support.slow import slow


def position_index(across, up):
    """By Luckiesh and Guth, as CIE 117 has it; offsets at a distance of 1, above the eye."""
    sigma = math.degrees(math.atan(math.hypot(across, up)))
    tau = math.degrees(math.atan2(abs(across), up))
    return math.exp(
        (35.2 - 0.31889 * tau - 1.22 * math.exp(-2 * tau / 9)) * 1e-3 * sigma
        + (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2
    )


@pytest.mark.parametrize(("offset", "side"), [((0, 0), 0.12), ((0, 0.35), 0.2)])
def test_ugr_of_a_square_source(mi, offset, side):
    """A square at a distance of 2 before a grey background, on the line of sight and above it."""
    lit, grey = 5000.0, 50.0
    scene = {
        "type": "scene",
        "square": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .translate([offset[0], offset[1], -2])
            .scale([side / 2, side / 2, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lit / 683}},
        },
        "background": {"type": "constant", "radiance": {"type": "rgb", "value": grey / 683}},
        "camera": {
            "type": "perspective",
            "fov": 60,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 256, "height": 256, "rfilter": {"type": "box"}},
        },
        "integrator": {"type": "path"},
    }
    image = lumitree.render(scene, spp=4)
    assert image.camera is not None
    assert (image.camera.horizontal, image.camera.vertical) == pytest.approx((60, 60), abs=1e-3)
    assert image.camera.direction == pytest.approx((0, 0, -1), abs=1e-6)
    found = lumitree.glare(image, vertical_illuminance=200)
    distance = math.hypot(2, *offset)
    omega = side**2 * 2 / distance**3
    position = position_index(0, offset[1] / 2)
    expected = 8 * math.log10(0.25 / grey * lit**2 * omega / position**2)
    # With the pixels that its border crosses.
    assert found.source_solid_angle == pytest.approx(omega, rel=0.1)
    assert found.ugr == pytest.approx(expected, abs=0.4)
    assert found.vertical_illuminance == pytest.approx(200, rel=1e-3)


@functools.cache
def rendered(size):
    """Any image of so many pixels a side, at 60 degrees."""
    film = {"type": "hdrfilm", "width": size, "height": size}
    camera = {"type": "perspective", "fov": 60, "film": film}
    light = {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}}
    scene = {"type": "scene", "light": light, "camera": camera, "integrator": {"type": "path"}}
    return lumitree.render(scene, spp=1)


def view_of(values):
    """An image of luminances [N, N], cd/m²."""
    pixels = np.repeat(np.asarray(values, np.float32)[..., None] / 683, 3, axis=2)
    return dataclasses.replace(rendered(len(values)), pixels=pixels)


def discs(size, discs, background):
    """Luminances [size, size] of discs of (across, up, radius, luminance) at a distance of 1."""
    fine = 8 * size
    across = math.tan(math.radians(30)) * ((2 * np.arange(fine) + 1) / fine - 1)
    values = np.full((fine, fine), float(background))
    for x, y, radius, lit in discs:
        values[(across - x) ** 2 + (-across[:, None] - y) ** 2 < radius**2] = lit
    return values.reshape(size, 8, size, 8).mean((1, 3))


# Three sources in the upper half of the view, and all of them: across, up, radius, cd/m².
SOURCES = (
    ((0.23, 0.16, 0.05, 5e3),),
    ((-0.31, 0.2, 0.05, 6e4),),
    ((0.1, 0.33, 0.05, 1e6),),
    ((0.23, 0.16, 0.05, 5e3), (-0.31, 0.2, 0.05, 6e4), (0.1, 0.33, 0.05, 1e6)),
)


@pytest.mark.parametrize("noise", [0, 0.15])
@pytest.mark.parametrize("size", [128, 512])
@pytest.mark.parametrize("sources", SOURCES)
def test_ugr_of_discs_by_hand(mi, sources, size, noise):
    """Neither luminance nor resolution nor noise of the pixels matters."""
    background = 80.0
    values = discs(size, sources, background)
    if noise:
        values *= np.random.default_rng(3).gamma(noise**-2, noise**2, values.shape)
    found = lumitree.glare(view_of(values), vertical_illuminance=500)
    # The area of a disc across the line of sight, seen obliquely.
    omegas = [math.pi * r**2 * (1 + x**2 + y**2) ** -1.5 for x, y, r, _ in sources]
    glare = sum(
        lit**2 * omega / position_index(x, y) ** 2
        for (x, y, _, lit), omega in zip(sources, omegas, strict=True)
    )
    assert found.ugr == pytest.approx(8 * math.log10(0.25 / background * glare), abs=0.3)
    assert found.background == pytest.approx(background, rel=0.02)


def test_noise_of_single_pixels_is_no_source(mi):
    values = discs(256, SOURCES[1], 80)
    clean = lumitree.glare(view_of(values), 500)
    values[::37, ::41] = 1e5
    assert lumitree.glare(view_of(values), 500).ugr == pytest.approx(clean.ugr, abs=0.3)


def test_sources_of_few_pixels_are_warned_of(mi):
    """The luminance of a source that fills no pixel is unknown."""
    image = view_of(discs(128, ((0.2, 0.2, 0.006, 1e6),), 80))
    with pytest.warns(lumitree.LumitreeWarning, match="at half the resolution: sources are small"):
        lumitree.glare(image, 500)


def test_ugr_of_a_room_at_three_resolutions(mi):
    """A ball and a panel in a grey room, with few samples per pixel."""
    to_world = mi.ScalarTransform4f()
    grey = {"type": "twosided", "bsdf": {"type": "diffuse"}}

    def emitter(luminance):
        return {"type": "area", "radiance": {"type": "rgb", "value": luminance / 683}}

    scene = {
        "type": "scene",
        "room": {"type": "cube", "to_world": to_world.scale([2, 1.4, 3]), "bsdf": grey},
        "ball": {"type": "sphere", "center": [-0.5, 0.6, -1], "radius": 0.15},
        "panel": {
            "type": "rectangle",
            "to_world": to_world.translate([0.6, 1.39, -1]).rotate([1, 0, 0], 90).scale(0.4),
            "emitter": emitter(5e3),
        },
        "integrator": {"type": "path", "max_depth": 6},
    }
    scene["ball"]["emitter"] = emitter(2e4)
    ratings = []
    for size in (128, 192, 384):
        scene["camera"] = {
            "type": "perspective",
            "fov": 70,
            "film": {"type": "hdrfilm", "width": size, "height": size},
            "to_world": to_world.look_at([0, 0, 2.5], [0, 0, -1], [0, 1, 0]),
        }
        image = lumitree.render(scene, spp=4)
        ratings.append(lumitree.glare(image, 500).ugr)
    assert max(ratings) - min(ratings) < 0.5


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.3, 0.2), (-0.2, -0.3)])
def test_one_source_has_the_figures_of_evalglare(mi, tmp_path, centre):
    """Uniform sources have no peaks that it could extract."""
    pyradiance = pytest.importorskip("pyradiance")
    values = discs(256, ((*centre, 0.08, 2e4),), 100)
    path = tmp_path / "view.hdr"
    # Radiance takes the luminance of (v, v, v) for 179 v cd/m².
    grey = np.repeat(values[..., None] / 179, 3, axis=2).astype(np.float32)
    mi.Bitmap(grey).write(str(path))
    view = ["-vtv", "-vh", "60", "-vv", "60", "-f"]
    options = {"detailed": True, "ev": 500.0, "bg_lum_mode": 1, "threshold": 5}
    output = pyradiance.evalglare(path, view=view, peak_extraction=False, **options).decode()
    names, _, numbers = output.strip().splitlines()[-1].partition(":")
    theirs = dict(zip(names.split(","), map(float, numbers.split()), strict=False))
    found = lumitree.glare(view_of(values), 500)
    assert found.ugr == pytest.approx(theirs["ugr"], abs=0.3)
    assert found.dgp == pytest.approx(theirs["dgp"], abs=0.01)
    assert found.source_solid_angle == pytest.approx(theirs["omega_sources"], rel=0.03)


@pytest.mark.parametrize(
    ("lamp", "background"), [(1500, 30), (1900, 30), (2100, 30), (20_000, 2500), (8000, 300)]
)
def test_ugr_of_dim_lamps_and_of_bright_rooms(mi, lamp, background):
    """Whether a source is above 2,000 cd/m² does not matter, nor whether the walls are."""
    values = np.full((256, 256), float(background))
    values[118:138, 118:138] = lamp
    found = lumitree.glare(view_of(values), vertical_illuminance=200)
    pixel = 2 * math.tan(math.radians(30)) / 256
    expected = 8 * math.log10(0.25 / background * lamp**2 * (20 * pixel) ** 2)
    assert found.ugr == pytest.approx(expected, abs=0.3)


def test_before_black_there_is_no_rating(mi):
    """Its formula divides by the background."""
    values = np.zeros((256, 256))
    values[100:140, 100:140] = 20_000.0
    found = lumitree.glare(view_of(values), vertical_illuminance=200)
    assert math.isnan(found.ugr)
    assert found.background == 0
    assert found.source_luminance == pytest.approx(20_000, rel=0.01)


def test_unknown_illuminances_and_infinite_pixels_do_not_count(mi):
    """The vertical illuminance is unknown inside solids. The rating does not depend on it."""
    values = np.full((256, 256), 30.0)
    values[118:138, 118:138] = 8000
    clean = lumitree.glare(view_of(values), 200)
    for vertical in (math.nan, math.inf, 0.0, -1.0):
        found = lumitree.glare(view_of(values), vertical)
        assert math.isnan(found.dgp)
        assert found.ugr == clean.ugr
    values[10, 10] = math.inf
    found = lumitree.glare(view_of(values), 200)
    assert found.ugr == pytest.approx(clean.ugr, abs=0.01)
    assert found.background == pytest.approx(clean.background, rel=0.01)


def test_an_even_view_has_no_source(mi):
    found = lumitree.glare(rendered(256), 200)
    assert math.isnan(found.ugr)
    assert found.source_solid_angle == 0
    assert found.background == pytest.approx(68.3, rel=0.02)


def test_the_corners_of_an_image_may_be_dark(mi):
    sphere = {"type": "sphere", "center": [0, 0, -2], "radius": 0.1}
    sphere["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 10}}
    camera = {"type": "perspective", "fov": 60, "film": {"type": "hdrfilm", "width": 512}}
    camera["film"] |= {"height": 512}
    camera["to_world"] = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    scene = {"type": "scene", "sphere": sphere, "camera": camera, "path": {"type": "path"}}
    image = lumitree.render(scene, spp=16)
    found = lumitree.glare(image, 1)
    # With pixels at the edge of the sphere.
    assert found.source_solid_angle == pytest.approx(math.pi * 0.05**2, rel=0.25)
    assert found.source_luminance == pytest.approx(6830, rel=0.25)
    assert found.background == 0


@pytest.mark.parametrize(("offset", "seen"), [((96, 64), True), ((95, 60), False)])
def test_the_view_of_a_crop_window(mi, offset, seen):
    """The middle of an image is a narrower view; any other part is none."""
    film = {"type": "hdrfilm", "width": 256, "height": 256, "crop_width": 64, "crop_height": 128}
    film |= {"crop_offset_x": offset[0], "crop_offset_y": offset[1]}
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 90, "film": film},
        "light": {"type": "constant"},
        "path": {"type": "path"},
    }
    image = lumitree.render(scene, spp=1)
    assert image.resolution == (64, 128)
    if not seen:
        assert image.camera is None
        return
    angles = (image.camera.horizontal, image.camera.vertical)
    assert angles == pytest.approx([2 * math.degrees(math.atan(x)) for x in (0.25, 0.5)])


def test_an_orthographic_image_is_refused(mi):
    camera = {"type": "orthographic", "film": {"type": "hdrfilm", "width": 64, "height": 64}}
    scene = {"type": "scene", "camera": camera, "light": {"type": "constant"}}
    scene["integrator"] = {"type": "path"}
    image = lumitree.render(scene, spp=1)
    with pytest.raises(lumitree.LumitreeError, match="not a perspective one"):
        lumitree.glare(image, 100)
    assert np.isfinite(image.luminance).all()


def panel(tmp_path, name="panel.ies"):
    """Photometric file of a square of 0.6 m that emits 1,150 cos γ cd downwards: 3,194 cd/m²."""
    gamma = np.append(np.arange(0, 90.5, 2.5), [90.001, 180])
    candela = 1150 * np.maximum(np.cos(np.deg2rad(gamma)), 0)
    (tmp_path / name).write_text(ies_text([candela], [0], gamma, (0.6, 0.6, 0)))
    return str(tmp_path / name)


@pytest.mark.parametrize("unit", [1.0, slow(0.01)])
def test_ugr_of_a_lamp_by_hand(mi, tmp_path, unit):
    """One panel 1.5 m above the eye, and 3 m ahead.

    r² = 11.25 m², cos γ = 1.5 / 3.354 = 0.4472, L = 1150 / 0.36 = 3194.4 cd/m²,
    ω = 0.36 · 0.4472 / 11.25 = 0.014311 sr. T / R = 0 and H / R = 0.5, so σ = 26.565° and τ = 0:
    ln p = (35.2 - 1.22) · 0.026565 + 21e-5 · 705.7 = 0.90268 + 0.14820, p = 2.8601.
    UGR = 8 log₁₀(0.25 / 25 · 3194.4² · 0.014311 / 2.8601²) = 8 log₁₀ 178.52 = 18.013.
    """
    lamp = lumitree.Placement(panel(tmp_path), at=(0, 2.7 / unit, -3 / unit))
    found = lumitree.lamp_glare([lamp], (0, 1.2 / unit, 0), (0, 0, -7), 25, unit=unit)
    assert found.luminance == pytest.approx([3194.4], rel=1e-3)
    assert found.solid_angle == pytest.approx([0.014311], rel=1e-3)
    assert found.position_index == pytest.approx([2.8601], rel=1e-3)
    assert found.ugr == pytest.approx(18.013, abs=0.01)


@pytest.mark.slow
def test_ugr_of_several_lamps(mi, tmp_path):
    """Sums over an array, lamps that are turned, scaled and dimmed, and one behind the eye."""
    source = panel(tmp_path)
    array = lumitree.Placement(source, (0.5, 2.7, -3), grid=(2, 2), pitch=(2, 2))
    found = lumitree.lamp_glare([array], (0, 1.2, 0), (0, 0, -1), 25)
    sums = 0.0
    for x, ahead in ((-0.5, 4), (1.5, 4), (-0.5, 2), (1.5, 2)):
        squared = x**2 + 1.5**2 + ahead**2
        omega = 0.36 * 1.5 / squared**1.5
        sums += 3194.4**2 * omega / position_index(x / ahead, 1.5 / ahead) ** 2
    assert found.ugr == pytest.approx(8 * math.log10(0.25 / 25 * sums), abs=0.02)
    # Towards the eye by a quarter of a turn; four times the area of equal intensity; half the flux.
    lamp = lumitree.Placement(
        source, (0, 1.2, -3), size=1.2, rotate=(1, 0, 0, -90), lumens=1150 * math.pi / 2
    )
    behind = lumitree.Placement(source, (0, 2.7, 3))
    found = lumitree.lamp_glare([lamp, behind], (0, 1.2, 0), (0, 0, -1), 25)
    assert found.luminance[0] == pytest.approx(3194.4 / 8, rel=5e-3)
    assert found.position_index == pytest.approx([1, math.inf])
    assert found.ugr == pytest.approx(
        8 * math.log10(0.25 / 25 * (3194.4 / 8) ** 2 * 1.44 / 9), abs=0.03
    )
    assert math.isnan(lumitree.lamp_glare([behind], (0, 1.2, 0), (0, 0, -1), 25).ugr)
    with pytest.raises(lumitree.LumitreeError, match="expected two different directions"):
        lumitree.lamp_glare([lamp], (0, 1.2, 0), (0, 1, 0), 25)
