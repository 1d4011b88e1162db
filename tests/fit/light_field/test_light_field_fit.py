"""The bake of the light field against closed forms, and its saved state."""

import dataclasses
import gc
import os

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.file import save
from lumitree.asset.light_field import unpack
from lumitree.core.device import on_device
from lumitree.core.octahedral import bin_solid_angles, solid_angles
from lumitree.core.progress import reporting
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field import bake as module
from lumitree.fit.light_field.bake import bake_light_field, relative_noise
from lumitree.trace.cameras import PATH_DEPTH
from lumitree.trace.light_field_config import LightFieldConfig
from lumitree.trace.light_paths import LampRays, trace_light
from support.lamps import AREA, GLASS, cube, lamp_of, sphere
from support.light_fields import assert_equal_fields

CONFIG = LightFieldConfig(paths=1 << 18, batch=1 << 17, depth=2, resolution=16)
RADIANCE = np.array([3.0, 2.0, 1.0])
BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'


def rectangle(half, height, inside):
    """A horizontal square, centred on the z axis, that faces down."""
    return (
        '<shape type="rectangle"><transform name="to_world">'
        f'<scale x="{half}" y="{half}" z="1"/><rotate x="1" angle="180"/>'
        f'<translate x="0" y="0" z="{height}"/></transform>{inside}</shape>'
    )


@pytest.fixture(scope="module")
def ball(mi, tmp_path_factory):
    """A sphere of radius 0.5, local radius 1, that emits RADIANCE."""
    return lamp_of(tmp_path_factory.mktemp("ball"), sphere("ball", 0.5, (1, 2, 3), inside=AREA))


@pytest.fixture(scope="module")
def field(ball, tmp_path_factory):
    return bake_light_field(ball, CONFIG, tmp_path_factory.mktemp("state"))


def intensities(field):
    """Intensity [C, R², 3], local units."""
    values = field.scale * unpack(field.intensity)
    return np.stack([field.dense(values[:, channel]) for channel in range(3)], axis=-1)


def flux(field):
    """Flux [C, R², 3], local units."""
    return intensities(field) * solid_angles(field.resolution)[:, None]


def own_flux(field):
    """Flux [C, R², 3] of the directions of each bin, if its intensity is even over them."""
    return intensities(field) * bin_solid_angles(field.resolution)[:, None]


def directions(mi, resolution, fine=4):
    """Unit directions [R², fine², 3] in each bin."""
    from lumitree.core.octahedral import direction_in_bin

    places = (np.arange(fine) + 0.5) / fine
    x, y = (np.tile(grid.ravel(), resolution**2) for grid in np.meshgrid(places, places))
    bins = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), fine**2))
    sample = on_device(mi.Point2f, np.stack([x, y], axis=1))
    direction, _ = direction_in_bin(bins, sample, resolution)
    return np.array(direction, np.float64).T.reshape(resolution**2, fine**2, 3)


def test_flux_of_a_sphere(ball, field):
    """A sphere of radius R and radiance L emits 4π² R² L."""
    expected = 4 * np.pi**2 * 0.5**2 * RADIANCE
    found = flux(field).sum(axis=(0, 1)) * ball.frame.scale**2
    assert found == pytest.approx(expected, rel=1e-3)


def test_the_flux_of_the_paths_is_conserved(mi, ball, field):
    """The field has the flux of the traced paths in each bin, up to the packing; none is lost."""
    from lumitree.core.octahedral import bin_of

    expected = np.zeros((3, 256))
    for step in range(2):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(SeedStream(Purpose.LIGHT_FIELD, step).seed(0), CONFIG.batch)
        paths = trace_light(ball, sampler, CONFIG.batch, PATH_DEPTH, all_light=True)
        bins = np.array(bin_of(paths.direction, 16))
        for channel, light in enumerate(np.array(paths.flux, np.float64)):
            expected[channel] += np.bincount(bins, light / 2, 256)
    found = own_flux(field).sum(axis=0).T
    found *= (expected.sum(axis=1) / found.sum(axis=1))[:, None]
    assert (np.abs(found - expected) <= 0.002 * expected.max(axis=0)).all()
    # The errors of bins cancel.
    assert flux(field).sum(axis=(0, 1)) == pytest.approx(expected.sum(axis=1), rel=2e-4)


def test_cells_of_a_sphere_are_those_of_its_surface(field):
    """Cells that the sphere does not cross emit nothing; all others do."""
    side = 2 / (1 << field.depth)
    near = np.maximum(np.maximum(field.cells * side - 1, 1 - (field.cells + 1) * side), 0)
    far = np.maximum(np.abs(field.cells * side - 1), np.abs((field.cells + 1) * side - 1))
    assert (np.linalg.norm(near, axis=1) <= 1).all()
    assert (np.linalg.norm(far, axis=1) >= 1).all()
    # The 8 cells in the middle of 4 x 4 x 4 are not crossed.
    assert len(field.cells) == 56


def test_a_sphere_emits_alike_into_all_directions(mi, field):
    """Its intensity is π R² L, local R = 1; each cell emits along its own normals."""
    found = intensities(field).sum(axis=0)
    expected = np.pi * RADIANCE
    counts = CONFIG.paths * bin_solid_angles(16) / (4 * np.pi)
    scores = (found / expected - 1) * np.sqrt(counts)[:, None]
    assert np.abs(scores).max() < 5
    assert scores[:, 0].std() == pytest.approx(1, abs=5 / np.sqrt(2 * 256))
    centre = (field.cells + 0.5) * 0.5 - 1
    towards = np.einsum("cb,bx->cx", own_flux(field)[..., 0], directions(mi, 16).mean(axis=1))
    cosine = (towards * centre).sum(axis=1)
    cosine /= np.linalg.norm(towards, axis=1) * np.linalg.norm(centre, axis=1)
    assert cosine.min() > 0.9


def test_a_flat_emitter_follows_the_cosine(mi, tmp_path):
    """The intensity of a square of area A is L A cos θ downwards, and 0 upwards."""
    lamp = lamp_of(tmp_path, rectangle(0.1, 0.5, AREA), rectangle(1, 1, BLACK))
    field = bake_light_field(lamp, dataclasses.replace(CONFIG, paths=1 << 19), tmp_path)
    found = intensities(field).sum(axis=0) * lamp.frame.scale**2
    down = -directions(mi, 16)[..., 2]
    expected = 0.2**2 * RADIANCE * np.maximum(down, 0).mean(axis=1)[:, None]
    assert (found[(down < 0).all(axis=1)] == 0).all()
    counts = (1 << 19) * np.maximum(down, 0).mean(axis=1) * bin_solid_angles(16) / np.pi
    error = expected * np.sqrt(1 / np.maximum(counts, 1) + 0.01**2)[:, None]
    lit = (down > 0.1).all(axis=1)
    assert lit.sum() > 80
    assert (np.abs(found - expected)[lit] < 5 * error[lit]).all()
    # All of it starts in the cells about the square, which are in the layer below the plate.
    height = (field.cells[:, 2] + 0.5) * 0.5 - 1
    height = height * lamp.frame.scale + lamp.frame.centre[2]
    assert np.abs(height - 0.5).max() < 0.5 * lamp.frame.scale


def test_an_occluder_in_the_box_leaves_no_light_behind_it(mi, tmp_path):
    """A black plate below a small emitter: bins that see only the plate are dark."""
    plate = cube("plate", (0.5, 0.5, 0.01), (0, 0, -0.01), BLACK)
    lamp = lamp_of(tmp_path, rectangle(0.1, 0.5, AREA), plate)
    config = dataclasses.replace(CONFIG, resolution=32)
    field = bake_light_field(lamp, config, tmp_path)
    found = intensities(field).sum(axis=0) * lamp.frame.scale**2
    towards = directions(mi, 32, fine=8)
    down = np.maximum(-towards[..., 2], 1e-9)
    # How far to the side a ray has gone at the height of the plate, 0.5 below the emitter.
    aside = 0.5 * np.abs(towards[..., :2]).max(axis=2) / down
    behind = ((towards[..., 2] < 0) & (aside < 0.38)).all(axis=1)
    beside = ((towards[..., 2] < -0.2) & (aside > 0.62)).all(axis=1)
    assert behind.sum() > 20
    assert beside.sum() > 20
    assert (found[behind] == 0).all()
    expected = 0.2**2 * RADIANCE[0] * down.mean(axis=1)
    ratio = found[beside, 0].sum() / expected[beside].sum()
    assert ratio == pytest.approx(1, abs=0.02)


def test_light_through_glass_starts_at_the_glass(mi, tmp_path):
    """The cell is the last vertex's, not the emitter's, and all of the light is bent."""
    lamp = lamp_of(tmp_path, sphere("bulb", 0.1, inside=AREA), sphere("shade", 1, inside=GLASS))
    config = dataclasses.replace(CONFIG, depth=3)
    field = bake_light_field(lamp, config, tmp_path)
    assert not np.isin(field.cells, (3, 4)).all(axis=1).any()
    assert np.array_equal(field.bent, field.intensity)
    # The glass reflects 4 % to the bulb, which absorbs it.
    emitted = 4 * np.pi**2 * 0.1**2 * RADIANCE.sum()
    assert flux(field).sum() * lamp.frame.scale**2 == pytest.approx(0.96 * emitted, rel=5e-3)


def content(field, lamp, path):
    save(light_field_asset(field, lamp.frame, lamp.name), path)
    return path.read_bytes()


def test_equal_seeds_give_equal_bytes(ball, field, tmp_path):
    again, other = (bake_light_field(ball, CONFIG, tmp_path, seed=seed) for seed in (0, 1))
    files = [content(each, ball, tmp_path / "x.lumitree") for each in (field, again, other)]
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_seeds_agree_within_their_noise(ball, field, tmp_path):
    """All paths of a bare sphere have the same flux, so that bins hold counts of paths."""
    other = bake_light_field(ball, CONFIG, tmp_path, seed=1)
    assert np.array_equal(field.cells, other.cells)
    each = 4 * np.pi**2 * RADIANCE[0] / CONFIG.paths
    counts = [flux(one)[..., 0].ravel() / each for one in (field, other)]
    assert [one.sum() for one in counts] == pytest.approx([CONFIG.paths] * 2, rel=1e-3)
    total = counts[0] + counts[1]
    enough = total > 20
    assert enough.sum() > 2000
    scores = (counts[0] - counts[1])[enough] / np.sqrt(total[enough])
    assert np.abs(scores).max() < 5.5
    # Bins are chosen by both, so the variance is 1 up to its own noise.
    assert scores.var() == pytest.approx(1, abs=5 * np.sqrt(2 / enough.sum()))
    assert abs(scores.mean()) < 5 / np.sqrt(enough.sum())


@pytest.mark.parametrize("batch", [1 << 15, 1 << 20])
def test_the_flux_does_not_depend_on_the_batches(ball, tmp_path, batch):
    """Also if the paths do not fill the last one."""
    config = LightFieldConfig(paths=(1 << 16) + 1, batch=batch, depth=2, resolution=16)
    found = flux(bake_light_field(ball, config, tmp_path)).sum(axis=(0, 1))
    assert found == pytest.approx(4 * np.pi**2 * RADIANCE, rel=1e-3)


def test_a_luminaire_without_light_is_refused(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("bulb", 0.2, inside=AREA), cube("shell", 1, inside=BLACK))
    message = r"^no light leaves .*lamp: it ends on 'shell' \(diffuse\); leave an opening"
    with pytest.raises(lumitree.LumitreeError, match=message) as caught:
        bake_light_field(lamp, CONFIG, tmp_path)
    assert str(caught.value).isprintable()
    assert not (tmp_path / "light.npz").exists()


@pytest.fixture
def traced(monkeypatch):
    """The number of traced batches so far, in a list."""
    counts = [0]

    class Counted(LampRays):
        def draw(self, *arguments, **options):
            counts[0] += 1
            return super().draw(*arguments, **options)

    monkeypatch.setattr(module, "LampRays", Counted)
    return counts


def test_an_equal_call_returns_the_saved_field(ball, field, tmp_path, traced):
    first = bake_light_field(ball, CONFIG, tmp_path)
    assert traced == [2]
    assert os.listdir(tmp_path) == ["light.npz"]
    assert_equal_fields(first, field)
    assert_equal_fields(bake_light_field(ball, CONFIG, tmp_path), first)
    assert traced == [2]


@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"paths": 1 << 17}, {"depth": 3}, {"resolution": 8}]
)
def test_another_setting_is_traced(ball, tmp_path, traced, change):
    bake_light_field(ball, CONFIG, tmp_path)
    seed = change.pop("seed", 0)
    before, config = traced[0], dataclasses.replace(CONFIG, **change)
    field = bake_light_field(ball, config, tmp_path, seed=seed)
    assert traced[0] > before
    assert (field.depth, field.resolution) == (config.depth, config.resolution)


def test_another_luminaire_is_traced(ball, field, tmp_path, traced):
    bake_light_field(ball, CONFIG, tmp_path)
    brighter = AREA.replace("3,2,1", "6,4,2")
    (tmp_path / "other").mkdir()
    lamp = lamp_of(tmp_path / "other", sphere("ball", 0.5, (1, 2, 3), inside=brighter))
    found = bake_light_field(lamp, CONFIG, tmp_path)
    assert traced == [4]
    assert found.scale == pytest.approx(2 * field.scale, rel=1e-6)


def test_a_damaged_saved_field_is_replaced(ball, field, tmp_path, traced):
    bake_light_field(ball, CONFIG, tmp_path)
    path = tmp_path / "light.npz"
    path.write_bytes(path.read_bytes()[:-1])
    for _ in range(2):
        assert_equal_fields(bake_light_field(ball, CONFIG, tmp_path), field)
        assert traced == [4]


def test_progress_counts_batches(ball, tmp_path, monkeypatch):
    monkeypatch.setattr("lumitree.core.progress._QUIET_SECONDS", 0)
    seen = []
    with reporting(seen.append):
        bake_light_field(ball, dataclasses.replace(CONFIG, batch=1 << 16), tmp_path)
    assert [(entry.done, entry.total) for entry in seen][-1] == (4, 4)
    assert seen[-1].finished


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"paths": 0}, "light paths is 0"),
        ({"paths": 1 << 33}, "light paths is"),
        ({"depth": 0}, "depth of the light field is 0"),
        ({"depth": 8}, "depth of the light field is 8"),
        ({"resolution": 2}, "bins of direction a side is 2"),
        ({"resolution": 256}, "bins of direction a side is 256"),
        ({"resolution": 24}, "bins of direction a side is 24"),
        ({"batch": 0}, "paths at once is 0"),
    ],
)
def test_settings_out_of_range_are_refused(change, message):
    with pytest.raises(lumitree.LumitreeError, match=message):
        dataclasses.replace(CONFIG, **change)


@pytest.mark.slow
def test_batches_of_other_seeds_compile_no_kernels(mi, tmp_path):
    """Each has another number of paths that leave, and of segments that end on the lamp."""
    import drjit as dr

    lamp = lamp_of(
        tmp_path, sphere("ball", 0.2, inside=AREA), cube("shade", (0.5, 0.02, 0.5), (0.3, 0.4, 0))
    )
    new, kernels = [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for seed in range(4):
            # Kernels contain the emitters and BSDFs of all scenes that exist.
            gc.collect()
            dr.kernel_history_clear()
            config = dataclasses.replace(CONFIG, paths=1 << 14, batch=1 << 13)
            (tmp_path / str(seed)).mkdir()
            bake_light_field(lamp, config, tmp_path / str(seed), seed=seed)
            kernels = dr.kernel_history([dr.KernelType.JIT])
            new.append(sum(not kernel["cache_hit"] for kernel in kernels))
    assert len(kernels) > 2
    assert new[1:] == [0, 0, 0]


def test_the_noise_of_a_sphere_is_known(ball, field):
    """Its paths are spread evenly: R² bins of N paths have a relative error of √(R² / N)."""
    spread = 5 / np.sqrt(2 * (CONFIG.paths // CONFIG.batch - 1) * CONFIG.resolution**2)
    expected = np.sqrt(CONFIG.resolution**2 / CONFIG.paths)
    assert field.traced.noise == pytest.approx(expected, rel=spread)


def test_noise_from_one_estimate_or_none_is_not_known():
    assert relative_noise(np.ones((1, 16))) is None
    assert relative_noise(np.zeros((2, 16))) is None
    # The estimates 1, 3 and 5 have Σ (I - Ī)² / (K (K - 1)) = 8 / 6 and Ī = 3.
    estimates = np.array([[1.0], [3.0], [5.0]]).repeat(16, axis=1)
    assert relative_noise(estimates) == pytest.approx((8 / 6) ** 0.5 / 3)
