"""Measurements of lamps with known intensities, and their errors."""

# pyright: reportOptionalMemberAccess=false
import dataclasses

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame, rotation, similarity
from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeError
from lumitree.formats.light_field import bake_distribution
from lumitree.formats.type_c import Grid, IntensityDistribution, angles_of, node_solid_angles
from lumitree.measure import far_field as module
from lumitree.measure.batches import BATCHES, jackknife
from lumitree.measure.far_field import (
    MAX_NOISE,
    STEPS,
    asset_source,
    chosen_step,
    file_source,
    luminaire_source,
    measure,
)
from lumitree.measure.near_field import DISTANCES, NearFieldTest
from lumitree.measure.photometric_figures import (
    Estimate,
    evaluated,
    half_widths,
    plane_curve,
    width_at,
)
from lumitree.rendering.asset_flux import asset_lumens
from support.camera_flux import flux_by_camera_paths
from support.fields import uniform_asset
from support.lamps import AREA, lamp_of, sphere
from support.light_fields import random_light_field

RADIANCE = np.array([3.0, 2.0, 1.0])
PATHS = 1 << 18


def disk(radius, emitter=AREA):
    """A horizontal disk at the origin that faces down."""
    return (
        '<shape type="disk"><transform name="to_world">'
        f'<scale value="{radius}"/><rotate x="1" angle="90"/></transform>{emitter}</shape>'
    )


@pytest.fixture(scope="module")
def ball(mi, tmp_path_factory):
    """A sphere of radius 0.5 that emits RADIANCE."""
    return lamp_of(tmp_path_factory.mktemp("ball"), sphere("ball", 0.5, (1, 2, 3), inside=AREA))


@pytest.fixture(scope="module")
def downlight(mi, tmp_path_factory):
    """A disk of radius 0.5 that faces down."""
    return lamp_of(tmp_path_factory.mktemp("disk"), disk(0.5))


@pytest.fixture(scope="module")
def measured_ball(ball):
    return measure(luminaire_source(ball), 1 << 19, step=15)


@pytest.fixture(scope="module")
def measured_disk(downlight):
    return measure(luminaire_source(downlight), 1 << 19, step=10)


def test_a_sphere_is_isotropic(measured_ball):
    data = evaluated(measured_ball)
    figures, candela = data.figures, luminance(RADIANCE) * np.pi * 0.25
    z = (data.distribution.intensity - candela) / data.intensity_error
    # 16 batches: Student's t with 15 degrees of freedom, whose variance is 15/13. Neighbours are
    # correlated, and the poles repeat one number.
    assert np.abs(z).max() < 7
    assert 0.7 < (z[:, 1:-1] ** 2).mean() < 1.8
    assert abs(figures.lumens.value - 4 * np.pi * candela) < 5 * figures.lumens.error + 1e-3
    assert abs(figures.upward_share.value - 0.5) < 5 * figures.upward_share.error
    assert figures.light_output_ratio.value == pytest.approx(1, abs=1e-5)
    assert data.size == pytest.approx([1, 1, 1])
    assert {each.value for each in figures.beam_angles.values()} == {360}
    assert data.distribution.lumens == pytest.approx(figures.lumens.value)


def test_a_sphere_is_its_far_field_everywhere(measured_ball):
    """By Gauss's law for isotropic light; each sphere gets the flux of the far field."""
    limits = measured_ball.near_field.limits()
    assert len(limits) == 11
    for limit in limits:
        assert abs(limit.difference) < 5 * limit.difference_error
        assert limit.difference_error < 0.06
        assert limit.candela == pytest.approx(luminance(RADIANCE) * np.pi * 0.25, rel=0.1)


def test_a_lambertian_disk(measured_disk):
    data = evaluated(measured_disk)
    figures, peak = data.figures, luminance(RADIANCE) * np.pi * 0.25
    assert abs(figures.lumens.value - np.pi * peak) < 5 * figures.lumens.error + 1e-3 * peak
    assert figures.upward_share.value == 0
    # The mean of the cosine over the hat at straight down.
    fine = np.deg2rad((np.arange(10_000) + 0.5) / 1000)
    weight = (1 - fine / fine.max()) * np.sin(fine)
    expected = peak * (weight * np.cos(fine)).sum() / weight.sum()
    assert abs(data.distribution.intensity[0, 0] - expected) < 5 * data.intensity_error[0, 0]
    for name in ("C0-C180", "C90-C270"):
        # The cosine is 1/2 at 60 and 1/10 at 84.3 degrees; steps of 10 degrees blur the edge.
        assert figures.beam_angles[name].value == pytest.approx(120, abs=4)
        assert figures.field_angles[name].value == pytest.approx(168.5, abs=6)
        assert 0 < figures.beam_angles[name].error < 4
    for at_65, at_75, _ in figures.luminance.values():
        assert [at_65.value, at_75.value] == pytest.approx(
            2 * [float(luminance(RADIANCE))], rel=0.1
        )
        assert 0 < at_65.error < 0.1 * at_65.value


def test_the_near_field_of_a_lambertian_disk(measured_disk):
    """On the axis E d² / I - 1 = -a² / (d² + a²), at all distances; the size is 2 a = 1."""
    test = measured_disk.near_field
    difference, error = test.differences()
    exact = -1 / (4 * DISTANCES**2 + 1)
    # The first direction is straight down. A cone of 5 degrees is not the axis: 0.4 % at most.
    assert (np.abs(difference[:, 0] - exact) < 4 * error[:, 0] + 4e-3).all()
    assert error[:, 0].max() < 0.06
    limits = {limit.direction: limit for limit in test.limits()}
    five = DISTANCES.tolist().index(5)
    assert limits["down"].difference == difference[five, 0]
    # No light goes up.
    assert limits["up"].distance is limits["up"].difference is None
    assert not limits["up"].is_known


@pytest.mark.parametrize(
    ("difference", "error", "expected"),
    [
        # 5 % at 4.36 radii of a disk, 2.18 times its size; the sizes are 3 m.
        (lambda d: -1 / (4 * d**2 + 1), 0.001, (3 * 2.18, True)),
        (lambda d: 0 * d, 0.001, (3.0, True)),
        (lambda d: 0 * d - 0.06, 0.001, (None, True)),
        # It is not known where the difference becomes small, or whether it is small anywhere.
        (lambda d: -1 / (4 * d**2 + 1), 0.03, (None, False)),
        (lambda d: 0 * d, 0.03, (None, False)),
        (lambda d: np.nan * d, 0.001, (None, False)),
        # Near distances may be uncertain.
        (lambda d: 1 / d, np.where(DISTANCES < 10, 0.1, 0.01), (3 * 20.0, True)),
    ],
)
def test_the_distance_of_the_far_field(difference, error, expected):
    test = NearFieldTest(3.0, (0.0, 0.0), 2)
    distance, known = test._limit(difference(DISTANCES), error + 0 * DISTANCES)
    assert known is expected[1]
    assert distance == (expected[0] and pytest.approx(expected[0], rel=0.02))


@pytest.mark.slow
def test_a_luminaire_that_absorbs(mi, tmp_path):
    """A black plate below a sphere: light output ratio, shares, and the flux of `preview`."""
    black = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    plate = (
        '<shape type="rectangle"><transform name="to_world"><scale x="2" y="2" z="1"/>'
        f'<rotate x="1" angle="-90"/><translate x="0" y="-0.5" z="0"/></transform>{black}</shape>'
    )
    lamp = lamp_of(tmp_path, sphere("ball", 0.2, inside=AREA), plate)
    figures = evaluated(measure(luminaire_source(lamp), PATHS)).figures
    emitted = luminance(RADIANCE) * 4 * np.pi**2 * 0.04
    assert figures.emitted_lumens.value == pytest.approx(emitted, rel=1e-4)
    reference = flux_by_camera_paths(lamp, 1 << 21)
    error = np.hypot(figures.lumens.error, reference.lumens_error)
    assert abs(figures.lumens.value - reference.lumens) < 4 * error
    ratio = figures.light_output_ratio
    assert ratio.value == pytest.approx(figures.lumens.value / emitted, rel=1e-3)
    assert 0 < ratio.error < 0.01
    # The plate covers no more than the lower half.
    assert figures.upward_share.value > 0.5


def test_an_asset_emits_what_its_light_field_has(mi):
    """In a turned frame; the cells have the same intensity, by bin and direction."""
    half = np.array([1.0, 0.5, 0.25])
    frame = LocalFrame(half, similarity(rotation([1, 2, 3], 50), 0.3, [1, 2, 3]))
    asset = light_field_asset(random_light_field(3, depth=1, count=3), frame, "random")
    measurement = measure(asset_source(asset), PATHS, step=30)
    data = evaluated(measurement)
    figures = data.figures
    assert figures.emitted_lumens is figures.light_output_ratio is None
    assert figures.lumens.value == pytest.approx(asset_lumens(asset), rel=1e-2)
    assert (
        abs(figures.lumens.value - asset_lumens(asset))
        < 5 * figures.lumens.error + 1e-5 * figures.lumens.value
    )
    # The reference: directions uniform on the sphere, each with the intensity of a bin near it.
    random = np.random.default_rng(0)
    directions = random.normal(size=(1 << 18, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    local = directions @ frame.rotation
    from lumitree.asset.light_field import unpack
    from lumitree.core.octahedral import bin_of

    field = asset.light_field
    table = field.scale * field.dense(luminance(unpack(field.intensity))).sum(axis=0)
    offset = mi.Vector2f(on_device(mi.Point2f, random.random((len(local), 2)) - 0.5))
    bins = np.array(bin_of(on_device(mi.Vector3f, local), field.resolution, offset))
    flux = table[bins] * frame.scale**2 * 4 * np.pi / len(local)
    grid = Grid(30)
    reference = grid.intensity(directions, flux)
    error = np.sqrt(data.intensity_error**2 + grid.variance(directions, flux))
    z = (data.distribution.intensity - reference) / error
    assert np.abs(z).max() < 6
    assert (z[:, 1:-1] ** 2).mean() < 1.8


def test_an_asset_without_an_light_field(mi):
    """A cube of density; its flux is the opaque cube's, 6 · 4 · π · L."""
    data = evaluated(measure(asset_source(uniform_asset(1e4, RADIANCE)), 1 << 16, step=30))
    assert data.figures.lumens.value == pytest.approx(24 * np.pi * luminance(RADIANCE), rel=0.02)


def test_a_file_is_measured_as_its_asset(mi):
    """Intensities, box and opening, and the rays that are drawn of it."""
    gamma = np.linspace(0, 180, 19)
    intensity = np.tile(100 * np.cos(np.deg2rad(gamma)).clip(0), (4, 1))
    file = IntensityDistribution("file", np.linspace(0, 270, 4), gamma, intensity)
    colour = (1.2, 0.95, 0.9)
    of_file = file_source(file, colour)
    of_asset = asset_source(bake_distribution(file, colour), file)
    found, expected = (measure(each, 1 << 14, seed=1) for each in (of_file, of_asset))
    np.testing.assert_allclose(found.intensity, expected.intensity)
    np.testing.assert_allclose(found.watts, expected.watts, rtol=5e-3)
    np.testing.assert_allclose(found.size, expected.size)
    assert found.opening == expected.opening
    tests = found.near_field, expected.near_field
    assert tests[0] is not None
    assert tests[1] is not None
    np.testing.assert_array_equal(tests[0].differences()[0], tests[1].differences()[0])


def test_the_largest_intensity_is_not_one_of_noise(ball):
    """A node with a large intensity in one batch."""
    measurement = measure(luminaire_source(ball), 1 << 14, step=30)
    measurement.intensity[:, 3, 2] *= 1.2
    measurement.intensity[5, 7, 4] *= 20
    figures = evaluated(measurement).figures
    assert (figures.max_c, figures.max_gamma) == (90, 60)
    assert figures.max_candela.value == pytest.approx(measurement.intensity[:, 3, 2].mean())


def test_kept_rays_have_the_flux_of_all(ball):
    measurement = measure(luminaire_source(ball), 1 << 16, step=30, kept_rays=10_000)
    rays = measurement.rays
    assert 10_000 <= len(rays) <= 3 << 12
    assert luminance(rays.flux.sum(axis=0)) == pytest.approx(
        luminance(measurement.watts.mean(axis=0)), rel=0.01
    )
    assert np.linalg.norm(rays.origin - [1, 2, 3], axis=1) == pytest.approx(0.5, rel=1e-3)
    assert len(measure(luminaire_source(ball), 1 << 12, step=30).rays) == 0


def test_equal_seeds_give_equal_numbers(ball):
    first, second, other = (
        measure(luminaire_source(ball), 1 << 12, step=30, seed=seed) for seed in (1, 1, 2)
    )
    assert first.intensity.tolist() == second.intensity.tolist()
    assert first.intensity.tolist() != other.intensity.tolist()


def test_batches_are_traced_in_pieces(ball, monkeypatch):
    """Large ones, so that memory is bounded; the estimates have the same mean."""
    whole = measure(luminaire_source(ball), 1 << 16, step=30, kept_rays=1 << 12)
    monkeypatch.setattr(module, "MAX_AT_ONCE", 1 << 10)
    parts = measure(luminaire_source(ball), 1 << 16, step=30, kept_rays=1 << 12)
    assert parts.num_rays == whole.num_rays == 1 << 16
    assert len(parts.rays) == len(whole.rays) == 1 << 12
    exact = luminance(RADIANCE) * np.pi**2
    for measurement in (whole, parts):
        assert luminance(measurement.watts.mean(axis=0)) == pytest.approx(exact, rel=1e-3)
        assert luminance(measurement.emitted.mean(axis=0)) == pytest.approx(exact, rel=1e-3)
        mean, error = jackknife(lambda used, m=measurement: m.intensity[used].mean(axis=0))
        assert np.abs((mean - exact / 4 / np.pi) / error).max() < 7
        assert luminance(measurement.rays.flux.sum(axis=0)) == pytest.approx(exact, rel=1e-3)
        difference, spread = measurement.near_field.differences()
        assert (np.abs(difference) < 5 * spread).all()


def test_a_dark_lamp_is_refused(mi, tmp_path):
    dark = '<emitter type="area"><rgb name="radiance" value="0"/></emitter>'
    lamp = lamp_of(tmp_path, sphere("ball", 0.5, inside=dark))
    with pytest.raises(LumitreeError, match="no light leaves"):
        measure(luminaire_source(lamp), 1 << 10)


def test_a_first_piece_without_light(ball):
    """Light that few paths carry: the first piece has none by chance."""
    source, calls = luminaire_source(ball), []

    class LitLater:
        def draw(self, count, seed):
            rays = source.rays.draw(count, seed)
            calls.append(count)
            return dataclasses.replace(rays, flux=rays.flux * (len(calls) > 1))

    measurement = measure(dataclasses.replace(source, rays=LitLater()), 1 << 12)
    assert measurement.grid.step == STEPS[-1]
    exact = luminance(RADIANCE) * np.pi**2
    assert luminance(measurement.watts.mean(axis=0)) == pytest.approx(exact * 15 / 16, rel=1e-3)


@pytest.mark.parametrize("count", [1 << 8, 1 << 14, 1 << 19])
def test_the_chosen_step_is_the_finest_with_little_noise(count):
    random = np.random.default_rng(count)
    directions = random.normal(size=(count, 3))
    flux = np.full(count, 1 / count)
    step = chosen_step(directions, flux, BATCHES)

    def noise(each):
        """RMS of the relative error of isotropic light over the sphere, in closed form.

        The squares of hats integrate to about (2/3)² of the hats.
        """
        grid = Grid(each)
        angles = node_solid_angles(grid.c, grid.gamma)[:, 1:-1]
        rows = np.sin(np.deg2rad(grid.gamma[1:-1]))
        relative = 4 / 9 * 4 * np.pi / angles / (BATCHES * count)
        return np.sqrt((relative * rows).sum() / (rows.sum() * len(angles)))

    allowed = [each for each in STEPS if noise(each) <= MAX_NOISE]
    assert step == (allowed[0] if allowed else STEPS[-1])


def test_planes_and_widths():
    """A curve around a plane: up on the side of C, back on the other."""
    grid = Grid(30)
    intensity = np.add.outer(grid.c, grid.gamma)
    curve = plane_curve(grid, intensity, 90.0)
    assert curve.tolist() == [*[90, 120, 150, 180, 210, 240, 270], *[420, 390, 360, 330, 300]]
    # Half of the largest value, 10, is reached 15 degrees to one side and 30 to the other.
    assert width_at(np.array([0.0, 5, 10, 0, 0, 0]), 30, 0.5) == 45
    assert width_at(np.array([10.0, 0, 0, 0, 0, 5]), 30, 0.5) == 45
    assert width_at(np.array([10.0, 6, 7, 8]), 90, 0.5) == 360
    assert width_at(np.zeros(4), 90, 0.5) == 0
    assert half_widths(np.array([10.0, 0, 0, 0, 0, 5]), 30, 0.5) == (15, 30)
    # The cone is about the first angle, and not about the largest value.
    assert half_widths(np.array([4.0, 8, 0, 0]), 90, 0.5) == (157.5, 45)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1234.567, 1.234, "1,234.6 ± 1.2"),
        (0.123456, 0.00123, "0.1235 ± 0.0012"),
        (98765.0, 1234.0, "98,800 ± 1,200"),
        (12.0, 0.0, "12"),
        (6502.7755, 1e-11, "6,503"),
        (14428.3, 0.2, "14,428"),
        (5.0, float("nan"), "5"),
    ],
)
def test_estimates_are_shown_to_two_digits_of_their_errors(value, error, text):
    assert str(Estimate(value, error)) == text


def test_the_angles_of_kept_rays_are_in_the_frame_of_the_file(downlight):
    rays = measure(luminaire_source(downlight), 1 << 12, step=30, kept_rays=1).rays
    assert (angles_of(rays.direction)[1] < 90).all()
