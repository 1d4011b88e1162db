"""Metrics of images: values by hand, properties, and refusals."""

import json
import math

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.measure import metrics
from lumitree.measure.metrics import (
    MAX_PSNR,
    METRICS,
    VIEW_METRICS,
    flip_exposures,
    flux_error,
    gain_over_black,
    hdr_flip,
    mean_metrics,
    mulaw,
    pu21,
    view_metrics,
)

# It has no wheel for Python 3.14.
flip_evaluator = pytest.importorskip("flip_evaluator")
SIZE = 24


def grey(value, size=SIZE):
    return np.full((size, size, 3), value, np.float64)


def opacity(value=0.0, size=SIZE):
    return np.full((size, size), value, np.float64)


def noise(seed, size=SIZE):
    return np.random.default_rng(seed).random((size, size, 3))


def lamp(size=64, radius=0.35):
    """A lit disc before black, as a view of a luminaire is: most pixels are 0."""
    offset = (np.arange(size) + 0.5) / size * 2 - 1
    lit = np.hypot(offset[None, :], offset[:, None]) < radius
    return lit[..., None] * np.array([0.9, 0.6, 0.3]) * (0.5 + 0.5 * offset[:, None, None] ** 2)


def score(baked, reference, max_radiance=1.0):
    flat = opacity(size=reference.shape[0])
    return view_metrics(baked, reference, flat, flat, max_radiance)


def test_names_are_in_order_and_values_plain_floats():
    view = score(noise(0).astype(np.float32), noise(1).astype(np.float32))
    assert tuple(view) == VIEW_METRICS == METRICS[: len(VIEW_METRICS)]
    assert METRICS[len(VIEW_METRICS) :] == ("flux_error", "gain_linear", "gain_mulaw")
    assert all(type(value) is float for value in view.values())
    json.dumps(view, allow_nan=False)


@pytest.mark.parametrize("image", [noise(3), grey(0.0), grey(2.5), lamp()])
def test_equal_images_score_perfectly(image):
    view = score(image, image)
    for name in ("psnr_linear", "psnr_mulaw", "psnr_pu21"):
        assert view[name] == MAX_PSNR
    assert view["ssim_linear"] == pytest.approx(1)
    assert view["ssim_mulaw"] == pytest.approx(1)
    assert view["hdr_flip"] == view["rel_mse"] == view["opacity_rmse"] == 0
    # Nearly equal images are limited too.
    assert score(image * (1 + 1e-12), image)["psnr_linear"] == MAX_PSNR


def test_values_by_hand():
    for error in (0.1, -0.1, 0.01):
        view = score(grey(5 * (0.5 + error)), grey(5 * 0.5), max_radiance=5)
        assert view["psnr_linear"] == pytest.approx(-20 * math.log10(abs(error)))
    # Radiance above L_max is clipped.
    assert score(grey(9.0), grey(4.0), max_radiance=4)["psnr_linear"] == MAX_PSNR
    assert mulaw(np.array([0.0, 0.001, 1.0])) == pytest.approx([0, math.log(6) / math.log(5001), 1])
    error = (math.log(11) - math.log(6)) / math.log(5001)
    view = score(grey(0.002), grey(0.001))
    assert view["psnr_mulaw"] == pytest.approx(-20 * math.log10(error))
    # SSIM of constants is its luminance term.
    expected = (2 * 0.5 * 0.8 + 1e-4) / (0.5**2 + 0.8**2 + 1e-4)
    assert score(grey(0.5), grey(0.8))["ssim_linear"] == pytest.approx(expected)
    assert score(grey(0.5), grey(0.3))["rel_mse"] == pytest.approx(0.04 / (0.09 + 0.01))
    assert score(grey(0.1), grey(0.0))["rel_mse"] == pytest.approx(1)
    one, zero = np.ones((2, 2, 3)), np.zeros((2, 2, 3))
    assert metrics.psnr(one, zero, 256) == pytest.approx(20 * math.log10(256))


def test_they_do_not_depend_on_the_unit():
    one, other = score(noise(0), noise(1)), score(7 * noise(0), 7 * noise(1), max_radiance=7)
    for name in set(VIEW_METRICS) - {"rel_mse"}:
        assert other[name] == pytest.approx(one[name], rel=1e-4), name


# (luminance, V) evaluated from the equation of gfxdisp/pu21's pu21_encoder.m in Matlab's
# precision; the ends are printed by FFmpeg's port of it.
@pytest.mark.parametrize(
    ("luminance", "encoded"),
    [
        (0.005, 5.4705e-10),
        (0.1, 5.7170738),
        (1, 36.5439111),
        (10, 123.6474842),
        (1000, 420.0969206),
        (10000, 595.39392),
    ],
)
def test_pu21_of_known_luminances(luminance, encoded):
    assert pu21(luminance) == pytest.approx(encoded, rel=1e-6, abs=1e-7)


def test_pu21_and_its_psnr():
    assert pu21(100) == pytest.approx(256, abs=0.5)
    assert (np.diff(pu21(np.geomspace(0.005, 10000, 500))) > 0).all()
    assert pu21([-1, 0, 1e6]) == pytest.approx(pu21([0.005, 0.005, 10000]))
    # L_max is displayed at 4,000 cd/m², and the peak is 256.
    view = score(grey(3 * 0.025), grey(3 * 0.25), max_radiance=3)
    expected = 20 * math.log10(256 / float(pu21(1000) - pu21(100)))
    assert view["psnr_pu21"] == pytest.approx(expected)


def test_hdr_flip_grows_with_the_error(capfd):
    errors = [hdr_flip(lamp() * factor, lamp(), 1.0) for factor in (1, 1.05, 1.2, 2)]
    assert errors == sorted(errors)
    assert 0 == errors[0] < errors[1] < errors[-1] < 1
    # The filters of FLIP widen the lamp's edge by a few pixels.
    lit = (lamp().max(axis=-1) > 0).mean()
    assert lit < hdr_flip(np.zeros_like(lamp()), lamp(), 1.0) < 2 * lit
    assert capfd.readouterr() == ("", "")


def test_black_and_dim_references_do_not_end_the_process():
    black = np.zeros_like(lamp())
    assert hdr_flip(black, black, 1.0) == 0
    assert 0 < hdr_flip(lamp(), black, 1.0) < 1
    assert 0 <= hdr_flip(black, 1e-9 * lamp(), 1.0) < 0.01


@pytest.mark.parametrize("rows", [(0, 4), (60, 100), (30, 31)])
def test_black_surroundings_are_cut_off_exactly(rows):
    """Where both images are black, and the filters reach nothing else, the error is 0."""
    reference, baked = np.zeros((2, 160, 128, 3))
    part = slice(*rows), slice(50, 70)
    reference[part] = 0.5 * noise(3, 64)[: rows[1] - rows[0], :20]
    baked[part] = 1.3 * reference[part]
    images = (each.astype(np.float32) for each in (reference, baked))
    _, whole, _ = flip_evaluator.evaluate(
        *images, "HDR", applyMagma=False, parameters=flip_exposures(reference)
    )
    assert 0 < whole < 0.2
    assert hdr_flip(baked, reference, 1.0) == pytest.approx(whole, rel=1e-5)


def test_exposures_of_hdr_flip():
    """They are the package's own where everything is lit, and ordered and bounded elsewhere."""
    image = (0.05 + noise(5)).astype(np.float32)
    _, _, expected = flip_evaluator.evaluate(image, image, "HDR", applyMagma=False, parameters={})
    for name, value in flip_exposures(image.astype(np.float64)).items():
        assert value == pytest.approx(expected[name], abs=5e-3)
    for image in (lamp(), 1e-12 * lamp(), 0 * lamp(), 100 * lamp(), noise(0)):
        start, stop = flip_exposures(image).values()
        assert start <= stop <= math.log2(2.12 / 1e-3)
    # With the package's exposures 1e-6 behind the lamp scores 0.8 and more.
    clean, leaking = (hdr_flip(1.05 * lamp() + leak, lamp(), 1.0) for leak in (0.0, 1e-6))
    assert leaking == pytest.approx(clean, abs=0.005)


def test_without_the_package_there_is_no_hdr_flip(monkeypatch):
    monkeypatch.setattr(metrics, "flip_evaluator", None)
    names = tuple(score(noise(0), noise(1)))
    assert names == tuple(name for name in VIEW_METRICS if name != "hdr_flip")
    with pytest.raises(LumitreeError, match="needs the package flip-evaluator"):
        hdr_flip(noise(0), noise(1), 1.0)


def test_the_error_of_opacity_is_a_root_mean_square():
    baked = opacity()
    baked[: SIZE // 4] = 0.8
    view = view_metrics(grey(0.5), grey(0.5), baked, opacity(), 1.0)
    assert view["opacity_rmse"] == pytest.approx(0.4)


def test_black_predictions():
    reference = grey(0.0)
    reference[: SIZE // 4] = 0.2
    view = score(grey(0.1), reference, max_radiance=2)
    assert view["psnr_linear_black"] == pytest.approx(-10 * math.log10(0.25 * 0.1**2))
    black = score(np.zeros_like(lamp()), lamp())
    view = score(0.5 * lamp(), lamp())
    for kind in ("linear", "mulaw"):
        assert view[f"psnr_{kind}_black"] == pytest.approx(black[f"psnr_{kind}"])
    assert score(grey(1.0), grey(0.0))["psnr_linear_black"] == MAX_PSNR


def test_the_gain_over_black_is_the_ratio_of_squared_errors():
    # Squared errors 0.2² and 0.8²; encoded, the errors of the encoded values.
    encoded = mulaw(np.array([0.6, 0.8]))
    assert gain_over_black(score(grey(0.6), grey(0.8))) == pytest.approx(
        {
            "gain_linear": 20 * math.log10(0.8 / 0.2),
            "gain_mulaw": 20 * math.log10(encoded[1] / (encoded[1] - encoded[0])),
        }
    )
    gains = gain_over_black(score(grey(0.0), noise(0)))
    assert gains == {"gain_linear": 0.0, "gain_mulaw": 0.0}
    assert gain_over_black(score(grey(0.9), grey(0.1)))["gain_linear"] < -10


def test_the_error_of_the_flux():
    references = [noise(0), noise(1)]
    for factor in (0.8, 1.2):
        baked = (factor * image for image in references)
        assert flux_error(baked, references) == pytest.approx(0.2)
    assert flux_error([noise(0)], [noise(0)]) == 0
    # Errors of single views may cancel, and colours count by their luminance.
    assert flux_error([grey(2.0), grey(0.0)], [grey(1.0), grey(1.0)]) == pytest.approx(0)
    red = grey([1.0, 0.0, 0.0])
    assert flux_error([red], [grey(1.0)]) == pytest.approx(1 - 0.2126)


def test_means_are_plain_and_in_order():
    views = [{"psnr_linear": 20.0, "rel_mse": 1.0}, {"psnr_linear": 30.0, "rel_mse": 0.0}]
    assert mean_metrics(views) == {"psnr_linear": 25.0, "rel_mse": 0.5}
    views = [score(noise(0), noise(1)), score(noise(2), noise(3))]
    assert tuple(mean_metrics(views)) == VIEW_METRICS


FLAT = (grey(0.5), grey(0.5), opacity(), opacity())


def changed(which, value):
    """`FLAT` with a number in place of one."""
    arrays = [each.copy() for each in FLAT]
    arrays[which].flat[7] = value
    return arrays


@pytest.mark.parametrize(
    ("call", "message"),
    [
        *((lambda w=w, v=v: view_metrics(*changed(w, v), 1.0), "1 values that are NaN")
          for w in range(4) for v in (math.nan, math.inf)),
        (lambda: view_metrics(grey(0.5, 20), *FLAT[1:], 1.0), "shape"),
        (lambda: view_metrics(FLAT[0], grey(0.5)[..., 0], *FLAT[2:], 1.0), "shape"),
        (lambda: view_metrics(np.zeros((SIZE, SIZE, 4)), *FLAT[1:], 1.0), "shape"),
        (lambda: view_metrics(*FLAT[:3], grey(0.5), 1.0), "shape"),
        (lambda: view_metrics(*FLAT[:2], *[opacity(size=20)] * 2, 1.0), "shape"),
        *((lambda v=v: view_metrics(*FLAT, v), "L_max") for v in (0.0, -1.0, math.nan, math.inf)),
        (lambda: score(noise(0, 10), noise(0, 10)), "too small for SSIM"),
        (lambda: flux_error([grey(1.0)], [grey(0.0)]), "no light"),
        (lambda: flux_error([], []), "no light"),
        (lambda: flux_error([grey(1.0)], [grey(1.0)] * 2), "only 1"),
        (lambda: flux_error([grey(1.0)] * 2, [grey(1.0)]), "only 1"),
        (lambda: flux_error([grey(1.0, 8)], [grey(1.0, 9)]), "shape"),
        (lambda: mean_metrics([]), "no views"),
        (lambda: mean_metrics([{"a": 1.0}, {"b": 1.0}]), "view 1"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_in_a_line(call, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
