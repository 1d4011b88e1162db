"""Exposure and white balance of photographs."""

import numpy as np
import pytest

from lumitree.core.images import auto_exposure, tonemap
from lumitree.core.photometry import (
    blackbody_colour,
    srgb_from_xyz,
    xyz_from_srgb,
    xyz_temperature,
)
from lumitree.errors import LumitreeError
from lumitree.rendering.photograph import (
    Highlights,
    PhotoSettings,
    automatic_ev,
    bloomed,
    ev_of_white,
    light_on_scene,
    white_for,
    white_radiance,
)


def plain(exposure: float | str = 0.0):
    """Settings without white balance, view transform and bloom."""
    return PhotoSettings(exposure=exposure, white_balance="off", view="srgb", bloom=0)


@pytest.fixture
def image():
    """A room with warm light, noise, a lamp that is seen and a window into the dark."""
    random = np.random.default_rng(0)
    room = 0.02 * random.uniform(0.5, 1.5, (96, 128, 1)) * np.array([1.5, 1.0, 0.6])
    room[8:40, 80:120] = 0
    room[48:56, 16:24] = 500.0
    return room


def test_the_exposure_value_is_absolute(image):
    """White is 1.2 x 2^EV cd/m², whatever else is in the image."""
    for ev in (-3.0, 9.5):
        grey = 1.2 * 2**ev / 683
        assert white_radiance(ev) == pytest.approx(grey)
        assert ev_of_white(grey) == pytest.approx(ev)
        image[0, 0] = 0.4 * grey
        shown = plain(f"ev={ev}").photograph(image)
        assert shown.ev == ev
        assert (shown.pixels[0, 0] == tonemap(np.full(3, 0.4))).all()


def test_a_stop_is_a_factor_of_two(image):
    automatic = plain().photograph(image)
    brighter = plain(1.0).photograph(image)
    assert brighter.ev == pytest.approx(automatic.ev - 1)
    absolute = plain(f"ev={automatic.ev - 1}").photograph(image)
    twice = plain(f"ev={automatic.ev}").photograph(2 * image)
    for shown in (absolute, twice):
        assert np.array_equal(shown.pixels, brighter.pixels)


@pytest.mark.parametrize("factor", [2.0, 2.0**-20])
def test_twice_the_light_gives_the_same_photograph(image, factor):
    settings = PhotoSettings()
    first, second = (settings.photograph(each) for each in (image, factor * image))
    assert np.array_equal(first.pixels, second.pixels)
    assert second.ev - first.ev == pytest.approx(np.log2(factor))
    assert second.white_balance == pytest.approx(first.white_balance)


def test_lamps_and_dark_openings_do_not_count(image):
    room = 0.02 * np.ones_like(image) * np.array([1.5, 1.0, 0.6])
    expected = automatic_ev(room)
    assert automatic_ev(image) == pytest.approx(expected, abs=0.1)
    room[8:40, 80:120] = 1e-6
    room[48:80, 16:60] = 5000.0
    assert automatic_ev(room) == pytest.approx(expected)


def test_automatic_exposure_is_by_blocks_and_ignores_what_is_no_number():
    grey = np.full((21, 35, 3), 0.02)
    expected = automatic_ev(grey)
    random = np.random.default_rng(0)
    noisy = grey * random.exponential(size=(21, 35, 1))
    assert automatic_ev(noisy) == pytest.approx(expected, abs=0.1)
    image = np.full((64, 64, 3), 0.02)
    for value in (np.nan, np.inf, -np.inf):
        image[3, 4] = value
        assert automatic_ev(image) == pytest.approx(expected, abs=0.02)
        assert auto_exposure(image) == pytest.approx(0.9 / 0.02)
    # A black image has an exposure that another one can have.
    PhotoSettings(exposure=f"ev={automatic_ev(np.zeros((8, 8, 3)))}")


@pytest.mark.parametrize("temperature", [2200.0, 2700.0, 4000.0, 9000.0])
def test_grey_under_a_lamp_comes_closer_to_grey(mi, temperature):
    """Automatic: 70 % of the way in reciprocal temperatures. A number: the whole way."""
    grey = np.full((16, 16, 3), 0.3 * np.array(blackbody_colour(temperature)))
    automatic = PhotoSettings(exposure="ev=9", view="srgb", bloom=0).photograph(grey)
    expected = 1 / (0.3 / 6504 + 0.7 / temperature)
    assert automatic.white_balance == pytest.approx(expected, rel=0.01)
    # The number that is printed shows other images alike.
    settings = {"exposure": "ev=9", "view": "srgb", "bloom": 0}
    alike = PhotoSettings(white_balance=automatic.white_balance, **settings).photograph(grey)
    assert np.abs(alike.pixels.astype(int) - automatic.pixels).max() <= 2
    whole = PhotoSettings(white_balance=temperature, **settings).photograph(grey)
    assert np.ptp(whole.pixels[0, 0].astype(int)) <= 1
    assert whole.white_balance == temperature


@pytest.mark.parametrize("temperature", [2200.0, 2700.0, 3000.0, 4000.0])
def test_warm_light_stays_warm_and_does_not_become_pink(mi, temperature):
    """It is shown near the Planckian locus; 70 % of a straight line is 0.007 below it at 2200 K."""
    light = xyz_from_srgb(np.array(blackbody_colour(temperature)))
    white = white_for(light)
    assert white is not None
    shown = white.adaptation() @ srgb_from_xyz(light)
    kelvin, duv = xyz_temperature(xyz_from_srgb(shown))
    assert temperature < kelvin < 6504
    assert abs(duv) < 0.0025


def test_white_for_light_between_colours_and_lamps(mi):
    """Daylight is its own white, and greenish light gets a greenish one."""
    daylight = xyz_from_srgb(np.ones(3))
    white = white_for(daylight)
    assert white is not None
    assert white.xyz == pytest.approx(daylight, rel=2e-3)
    greenish = white_for(xyz_from_srgb(np.array([0.8, 1.0, 0.6])))
    assert greenish is not None
    assert xyz_temperature(greenish.xyz)[1] > 0.005


def test_white_balance_off_changes_nothing(image):
    shown = plain("ev=5").photograph(image)
    assert np.array_equal(shown.pixels, tonemap(image / white_radiance(5)))
    assert shown.white_balance is None


def test_the_albedo_tells_the_light_in_a_coloured_room(mi):
    lamp, paint = np.array(blackbody_colour(3000.0)), np.array([0.2, 0.4, 0.7])
    radiance = np.broadcast_to(0.1 * lamp * paint, (16, 16, 3))
    light = light_on_scene(radiance, np.broadcast_to(paint, radiance.shape))
    assert light is not None
    assert xyz_temperature(light)[0] == pytest.approx(3000, rel=0.01)


@pytest.mark.parametrize("colour", [[0.0, 1.0, 0.1], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
def test_coloured_light_keeps_its_colour(mi, colour):
    image = np.full((16, 16, 3), np.array(colour))
    shown = PhotoSettings(view="srgb", bloom=0).photograph(image)
    assert shown.white_balance is None
    assert (shown.pixels == plain().photograph(image).pixels).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"exposure": 41.0}, "exposure is 41.0; expected -40.0 to 40.0 stops"),
        ({"exposure": float("nan")}, "exposure is nan; expected"),
        ({"exposure": "bright"}, "exposure is 'bright'; expected stops .* such as ev=9.5"),
        ({"exposure": "ev=nan"}, "exposure is 'ev=nan'; expected"),
        ({"white_balance": "warm"}, "white_balance is 'warm'; expected auto, off or"),
        ({"white_balance": 900.0}, r"white_balance is 900.0; expected 1,000.0 to 20,000.0 K"),
        ({"view": "neon"}, "expected agx, srgb"),
        ({"bloom": 1.5}, "bloom is 1.5; expected 0 to 1"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(LumitreeError, match=message):
        PhotoSettings(**settings)


def filament(shares, level=1000.0, samples=4096):
    """Radiance and highlights of a row of pixels that an emitter covers to these shares."""
    covered = np.random.default_rng(0).random((1, len(shares), samples)) < np.array(shares)[:, None]
    light = np.where(covered, level, 0.0)
    seen = np.repeat(light.mean(-1)[..., None], 3, -1)
    return seen, Highlights(seen, (light**2).mean(-1))


def test_a_filament_is_clamped_before_pixels_are_averaged():
    shares = [0.0, 0.25, 0.5, 1.0, 1.0]
    seen, highlights = filament(shares)
    bright, clamped = highlights.divide(10.0)
    assert np.array_equal(bright, seen)
    assert clamped[0, :, 0] == pytest.approx(10 * np.array(shares), abs=0.25)
    # Pixels that are not brighter stay.
    bright, clamped = highlights.divide(2000.0)
    assert not bright.any()
    assert not clamped.any()


def test_a_filament_with_a_gain():
    """As if the samples had it; the square is by the mean of R, G and B."""
    warm, gain = np.array([1.5, 1.0, 0.5]), np.array([2.0, 0.5, 0.25])
    seen, highlights = filament([0.0, 0.25, 1.0])
    found = Highlights(seen * warm, highlights.square).scaled(gain)
    level = (warm * gain).mean()
    assert found.seen == pytest.approx(seen * warm * gain)
    assert found.square == pytest.approx(level**2 * highlights.square)


def test_the_automatic_exposure_is_not_computed_in_vain(image, monkeypatch):
    from lumitree.rendering import photograph

    monkeypatch.setattr(photograph, "automatic_ev", lambda _: pytest.fail("it is computed"))
    assert plain("ev=3").photograph(image).ev == 3


def test_the_edge_of_a_filament_is_no_staircase():
    """It is smooth in a photograph; without knowledge of its cover it would be white at once."""
    seen, highlights = filament(np.tile([0, 0, 0.02, 1, 1, 0.02, 0, 0], (9, 1))[0])
    settings = PhotoSettings(exposure=f"ev={ev_of_white(1.0)}", white_balance="off", bloom=0)
    shown = settings.photograph(seen, highlights=highlights).pixels[0, :, 0]
    assert shown[1] < 100 < shown[2] < 215 < 240 < shown[3]
    assert settings.photograph(seen).pixels[0, 2, 0] > 240


def test_other_light_of_the_pixels_of_a_filament_stays():
    seen, highlights = filament([0.0, 1.0, 0.0])
    settings = PhotoSettings(exposure="ev=0", white_balance="off", view="srgb", bloom=0)
    wall = np.full_like(seen, 0.4 * white_radiance(0))
    pixels = settings.photograph(seen + wall, highlights=highlights).pixels
    dark = settings.photograph(np.zeros_like(seen), highlights=filament([0, 0, 0])[1]).pixels
    assert (pixels[0, 1] == 255).all()
    assert not dark.any()


@pytest.mark.parametrize("shape", [(48, 64), (33, 17)])
def test_bloom_keeps_the_light(shape):
    image = np.random.default_rng(0).uniform(0, 0.1, (*shape, 3))
    image[0, 3] = image[20, 10] = 10.0
    shown = bloomed(image, 0.2)
    assert shown.sum(axis=(0, 1)) == pytest.approx(image.sum(axis=(0, 1)), rel=1e-9)
    assert shown[20, 10, 0] < 9.9
    assert shown[20, 11, 0] > image[20, 11, 0] + 0.01
    assert np.array_equal(bloomed(image, 0), image)
    # Uniform light is not changed.
    assert bloomed(np.ones_like(image), 0.2) == pytest.approx(1)


def test_gilt_beside_a_bulb_does_not_decide_the_white_balance():
    """A few blocks of orange light 100 times as bright as the light on the walls."""
    image, albedo = np.full((64, 96, 3), 0.5), np.full((64, 96, 3), 0.5)
    expected = PhotoSettings().photograph(image, albedo=albedo).white_balance
    image[8:16, 8:24], albedo[8:16, 8:24] = (3.0, 1.0, 0.2), 0.06
    found = PhotoSettings().photograph(image, albedo=albedo).white_balance
    assert found == pytest.approx(expected, rel=0.05)
