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
    flux,
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


def score(baked, reference, max_radiance=1.0, baked_opacity=None, reference_opacity=None):
    flat = opacity(size=reference.shape[0])
    return view_metrics(
        baked,
        reference,
        flat if baked_opacity is None else baked_opacity,
        flat if reference_opacity is None else reference_opacity,
        max_radiance,
    )


class TestNames:
    def test_are_those_of_the_design(self):
        assert METRICS == (
            "psnr_linear",
            "ssim_linear",
            "psnr_mulaw",
            "ssim_mulaw",
            "psnr_pu21",
            "hdr_flip",
            "rel_mse",
            "opacity_rmse",
            "psnr_linear_black",
            "psnr_mulaw_black",
            "flux_error",
            "gain_linear",
            "gain_mulaw",
        )

    def test_of_a_view_come_in_order(self):
        assert tuple(score(noise(0), noise(1))) == VIEW_METRICS

    def test_values_are_plain_floats_that_json_holds(self):
        view = score(noise(0).astype(np.float32), noise(1).astype(np.float32))
        assert all(type(value) is float for value in view.values())
        json.dumps(view, allow_nan=False)


class TestIdentity:
    @pytest.mark.parametrize("image", [noise(3), grey(0.0), grey(2.5), lamp()])
    def test_scores_perfectly(self, image):
        view = score(image, image)
        for name in ("psnr_linear", "psnr_mulaw", "psnr_pu21"):
            assert view[name] == MAX_PSNR
        assert view["ssim_linear"] == pytest.approx(1)
        assert view["ssim_mulaw"] == pytest.approx(1)
        assert view["hdr_flip"] == view["rel_mse"] == view["opacity_rmse"] == 0

    def test_nearly_equal_images_are_capped_too(self):
        assert score(grey(0.5 + 1e-9), grey(0.5))["psnr_linear"] == MAX_PSNR


class TestLinear:
    @pytest.mark.parametrize("error", [0.1, -0.1, 0.01])
    def test_constant_error_has_known_psnr(self, error):
        view = score(grey(5 * (0.5 + error)), grey(5 * 0.5), max_radiance=5)
        assert view["psnr_linear"] == pytest.approx(-20 * math.log10(abs(error)))

    def test_radiance_above_l_max_is_clipped(self):
        assert score(grey(9.0), grey(4.0), max_radiance=4)["psnr_linear"] == MAX_PSNR

    def test_does_not_depend_on_the_unit(self):
        one, other = score(noise(0), noise(1)), score(7 * noise(0), 7 * noise(1), max_radiance=7)
        for name in set(VIEW_METRICS) - {"rel_mse"}:
            assert other[name] == pytest.approx(one[name], rel=1e-4), name


class TestMulaw:
    def test_by_hand(self):
        assert mulaw(np.array([0.0, 1.0])) == pytest.approx([0, 1])
        assert mulaw(np.array([0.001])) == pytest.approx([math.log(6) / math.log(5001)])

    def test_psnr_by_hand(self):
        view = score(grey(0.002), grey(0.001))
        error = (math.log(11) - math.log(6)) / math.log(5001)
        assert view["psnr_mulaw"] == pytest.approx(-20 * math.log10(error))


class TestPu21:
    # (luminance, V) evaluated from the equation of gfxdisp/pu21's pu21_encoder.m in Matlab's
    # precision; the ends are those that FFmpeg's port of it prints.
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
    def test_known_values(self, luminance, encoded):
        assert pu21(luminance) == pytest.approx(encoded, rel=1e-6, abs=1e-7)

    def test_100_candela_map_near_256(self):
        assert pu21(100) == pytest.approx(256, abs=0.5)

    def test_is_monotonic_over_its_range(self):
        assert (np.diff(pu21(np.geomspace(0.005, 10000, 500))) > 0).all()

    def test_clips_to_its_range(self):
        assert pu21([-1, 0, 1e6]) == pytest.approx(pu21([0.005, 0.005, 10000]))

    def test_psnr_shows_l_max_at_4000_candela_with_peak_256(self):
        view = score(grey(3 * 0.025), grey(3 * 0.25), max_radiance=3)
        expected = 20 * math.log10(256 / float(pu21(1000) - pu21(100)))
        assert view["psnr_pu21"] == pytest.approx(expected)


class TestSsim:
    def test_of_constants_is_the_luminance_term(self):
        view = score(grey(0.5), grey(0.8))
        c1 = 0.01**2
        expected = (2 * 0.5 * 0.8 + c1) / (0.5**2 + 0.8**2 + c1)
        assert view["ssim_linear"] == pytest.approx(expected)

    def test_smallest_view(self):
        image = noise(0, size=11)
        assert score(image, image)["ssim_linear"] == pytest.approx(1)

    def test_smaller_views_are_refused(self):
        image = noise(0, size=10)
        with pytest.raises(LumitreeError, match="10 x 10 pixels are too small for SSIM"):
            score(image, image)


class TestRelMse:
    def test_by_hand(self):
        view = score(grey(0.5), grey(0.3))
        assert view["rel_mse"] == pytest.approx(0.04 / (0.09 + 0.01))

    def test_before_black(self):
        assert score(grey(0.1), grey(0.0))["rel_mse"] == pytest.approx(1)


class TestHdrFlip:
    def test_grows_with_the_error(self):
        errors = [hdr_flip(lamp() * factor, lamp(), 1.0) for factor in (1, 1.05, 1.2, 2)]
        assert errors == sorted(errors)
        assert 0 == errors[0] < errors[1] < errors[-1] < 1

    def test_black_prediction(self):
        lit = (lamp().max(axis=-1) > 0).mean()
        # The filters of FLIP widen the lamp's edge by a few pixels.
        assert lit < hdr_flip(np.zeros_like(lamp()), lamp(), 1.0) < 2 * lit

    def test_black_reference_does_not_end_the_process(self):
        black = np.zeros_like(lamp())
        assert hdr_flip(black, black, 1.0) == 0
        assert 0 < hdr_flip(lamp(), black, 1.0) < 1

    @pytest.mark.parametrize("rows", [(0, 4), (60, 100), (30, 31)])
    def test_black_surroundings_are_left_out_exactly(self, rows):
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

    def test_very_dim_reference_does_not_end_the_process(self):
        assert 0 <= hdr_flip(np.zeros_like(lamp()), 1e-9 * lamp(), 1.0) < 0.01

    def test_exposures_are_the_packages_own_where_everything_is_lit(self):
        image = (0.05 + noise(5)).astype(np.float32)
        _, _, own = flip_evaluator.evaluate(image, image, "HDR", applyMagma=False, parameters={})
        ours = flip_exposures(image.astype(np.float64))
        for name, value in ours.items():
            assert value == pytest.approx(own[name], abs=5e-3)

    def test_background_does_not_drown_the_lamp(self):
        # With the package's own exposures 1e-6 behind the lamp scores 0.8 and more.
        clean, leaking = (hdr_flip(1.05 * lamp() + leak, lamp(), 1.0) for leak in (0.0, 1e-6))
        assert leaking == pytest.approx(clean, abs=0.005)

    def test_exposures_are_ordered_and_bounded(self):
        for image in (lamp(), 1e-12 * lamp(), 0 * lamp(), 100 * lamp(), noise(0)):
            start, stop = flip_exposures(image).values()
            assert start <= stop <= math.log2(2.12 / 1e-3)

    def test_is_quiet(self, capfd):
        hdr_flip(lamp(), lamp(), 1.0)
        assert capfd.readouterr() == ("", "")

    def test_it_is_left_out_where_the_package_is_missing(self, monkeypatch):
        monkeypatch.setattr(metrics, "flip_evaluator", None)
        names = tuple(score(noise(0), noise(1)))
        assert names == tuple(name for name in VIEW_METRICS if name != "hdr_flip")
        with pytest.raises(LumitreeError, match="needs the package flip-evaluator"):
            hdr_flip(noise(0), noise(1), 1.0)


class TestOpacity:
    def test_constant_error(self):
        image = grey(0.5)
        view = score(image, image, 1.0, opacity(0.75), opacity(0.5))
        assert view["opacity_rmse"] == pytest.approx(0.25)

    def test_root_of_the_mean_square(self):
        baked = opacity()
        baked[: SIZE // 4] = 0.8
        view = score(grey(0.5), grey(0.5), 1.0, baked, opacity())
        assert view["opacity_rmse"] == pytest.approx(0.4)


class TestBlack:
    def test_is_what_a_black_prediction_scores(self):
        reference = lamp()
        black = score(np.zeros_like(reference), reference)
        view = score(0.5 * reference, reference)
        assert view["psnr_linear_black"] == pytest.approx(black["psnr_linear"])
        assert view["psnr_mulaw_black"] == pytest.approx(black["psnr_mulaw"])

    def test_by_hand(self):
        reference = grey(0.0)
        reference[: SIZE // 4] = 0.2
        view = score(grey(0.0), reference, max_radiance=2)
        assert view["psnr_linear_black"] == pytest.approx(-10 * math.log10(0.25 * 0.1**2))

    def test_of_a_black_reference_is_the_cap(self):
        assert score(grey(1.0), grey(0.0))["psnr_linear_black"] == MAX_PSNR


class TestFlux:
    @staticmethod
    def sphere(radius, radiance, half_width, resolution=400):
        offset = ((np.arange(resolution) + 0.5) / resolution * 2 - 1) * half_width
        inside = np.hypot(offset[None, :], offset[:, None]) < radius
        return inside[..., None] * np.full(3, radiance)

    @pytest.mark.parametrize(("radius", "half_width"), [(1.0, 1.0), (1.0, 1.7), (0.5, 1.2)])
    def test_of_a_uniform_sphere(self, radius, half_width):
        views = (self.sphere(radius, 3.0, half_width) for _ in range(5))
        expected = 4 * math.pi**2 * radius**2 * 3.0
        assert flux(views, half_width) == pytest.approx(expected, rel=2e-3)

    def test_weighs_colours_by_luminance(self):
        red, white = grey([1.0, 0.0, 0.0]), grey(1.0)
        assert flux([red], 1.0) / flux([white], 1.0) == pytest.approx(0.2126)

    def test_is_the_mean_over_views(self):
        assert flux([grey(1.0), grey(3.0)], 1.0) == pytest.approx(flux([grey(2.0)], 1.0))

    @pytest.mark.parametrize("half_width", [0.0, -1.0, math.nan, math.inf])
    def test_bad_width(self, half_width):
        with pytest.raises(LumitreeError, match="half_width"):
            flux([grey(1.0)], half_width)

    def test_no_views(self):
        with pytest.raises(LumitreeError, match="no views"):
            flux([], 1.0)


class TestFluxError:
    def test_has_no_sign(self):
        references = [noise(0), noise(1)]
        for factor in (0.8, 1.2):
            baked = (factor * image for image in references)
            assert flux_error(baked, references) == pytest.approx(0.2)

    def test_of_equal_views_is_zero(self):
        assert flux_error([noise(0)], [noise(0)]) == 0

    def test_is_that_of_the_flux(self):
        baked, references = [noise(0), noise(1)], [noise(2), noise(3)]
        expected = abs(flux(baked, 1.3) / flux(references, 1.3) - 1)
        assert flux_error(baked, references) == pytest.approx(expected)

    def test_errors_of_single_views_may_cancel(self):
        assert flux_error([grey(2.0), grey(0.0)], [grey(1.0), grey(1.0)]) == pytest.approx(0)

    def test_black_references(self):
        with pytest.raises(LumitreeError, match="no light"):
            flux_error([grey(1.0)], [grey(0.0)])

    def test_no_views(self):
        with pytest.raises(LumitreeError, match="no light"):
            flux_error([], [])

    @pytest.mark.parametrize(("num_baked", "num_reference"), [(1, 2), (2, 1)])
    def test_missing_views(self, num_baked, num_reference):
        with pytest.raises(LumitreeError, match="only 1"):
            flux_error([grey(1.0)] * num_baked, [grey(1.0)] * num_reference)

    def test_shapes_differ(self):
        with pytest.raises(LumitreeError, match="view 0 differ in shape"):
            flux_error([grey(1.0, 8)], [grey(1.0, 9)])


class TestMean:
    def test_is_plain(self):
        views = [{"psnr_linear": 20.0, "rel_mse": 1.0}, {"psnr_linear": 30.0, "rel_mse": 0.0}]
        assert mean_metrics(views) == {"psnr_linear": 25.0, "rel_mse": 0.5}

    def test_keeps_the_order_of_names(self):
        views = [score(noise(0), noise(1)), score(noise(2), noise(3))]
        assert tuple(mean_metrics(views)) == VIEW_METRICS

    def test_no_views(self):
        with pytest.raises(LumitreeError, match="no views"):
            mean_metrics([])

    def test_names_differ(self):
        with pytest.raises(LumitreeError, match="view 1 has metrics"):
            mean_metrics([{"a": 1.0}, {"b": 1.0}])


class TestGainOverBlack:
    def test_is_the_ratio_of_the_squared_errors(self):
        # Squared errors 0.2² and 0.8²; encoded, those of the encoded values.
        encoded = mulaw(np.array([0.6, 0.8]))
        assert gain_over_black(score(grey(0.6), grey(0.8))) == pytest.approx(
            {
                "gain_linear": 20 * math.log10(0.8 / 0.2),
                "gain_mulaw": 20 * math.log10(encoded[1] / (encoded[1] - encoded[0])),
            }
        )

    def test_of_black_is_zero(self):
        gains = gain_over_black(score(grey(0.0), noise(0)))
        assert gains == {"gain_linear": 0.0, "gain_mulaw": 0.0}

    def test_is_negative_for_a_larger_error_than_that_of_black(self):
        assert gain_over_black(score(grey(0.9), grey(0.1)))["gain_linear"] < -10


class TestBadInput:
    @pytest.mark.parametrize("bad", [math.nan, math.inf])
    @pytest.mark.parametrize("which", range(4))
    def test_not_finite(self, which, bad):
        arrays = [grey(0.5), grey(0.5), opacity(), opacity()]
        arrays[which].flat[7] = bad
        with pytest.raises(LumitreeError, match="1 values that are NaN or infinite") as caught:
            view_metrics(*arrays, 1.0)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        ("which", "replacement"),
        [
            (0, grey(0.5, 20)),
            (1, grey(0.5)[..., 0]),
            (0, np.zeros((SIZE, SIZE, 4))),
            (2, opacity(size=20)),
            (3, grey(0.5)),
        ],
    )
    def test_shapes(self, which, replacement):
        arrays = [grey(0.5), grey(0.5), opacity(), opacity()]
        arrays[which] = replacement
        with pytest.raises(LumitreeError, match="shape") as caught:
            view_metrics(*arrays, 1.0)
        assert "\n" not in str(caught.value)

    def test_opacity_of_another_view(self):
        with pytest.raises(LumitreeError, match="that of the radiance"):
            view_metrics(grey(0.5), grey(0.5), opacity(size=20), opacity(size=20), 1.0)

    @pytest.mark.parametrize("max_radiance", [0.0, -1.0, math.nan, math.inf])
    def test_l_max(self, max_radiance):
        with pytest.raises(LumitreeError, match="L_max"):
            score(grey(0.5), grey(0.5), max_radiance)

    def test_inputs_are_left_alone(self):
        baked, reference = noise(0), noise(1)
        before = baked.copy(), reference.copy()
        score(baked, reference)
        assert (baked == before[0]).all()
        assert (reference == before[1]).all()


def test_psnr_of_another_peak():
    one, zero = np.ones((2, 2, 3)), np.zeros((2, 2, 3))
    assert metrics.psnr(one, zero, 256) == pytest.approx(20 * math.log10(256))
