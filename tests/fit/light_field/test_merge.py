"""Merging: the same as one longer bake, but for the rounding of stored intensities."""

import dataclasses
import json
import os

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import TracedPaths, make_light_field, unpack
from lumitree.cli import main
from lumitree.core.octahedral import intensity_of_histogram, solid_angles
from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.fit.light_field import bake as module
from lumitree.fit.light_field.bake import bake_light_field
from lumitree.fit.light_field.merge import merge_light_fields, relative_noise
from lumitree.lamp.loading import load_luminaire
from lumitree.measure.irradiance import asset_irradiance, irradiance_error
from lumitree.trace.light_field_config import LightFieldFitConfig
from lumitree.trace.light_paths import trace_light
from lumitree.trace.tracing import PATH_DEPTH
from support.fields import random_asset
from support.lamps import AREA, cube, scene, sphere
from support.light_fields import assert_equal_fields, random_light_field

BATCH, RESOLUTION = 1 << 15, 16
CONFIG = LightFieldFitConfig(paths=8 * BATCH, batch=BATCH, depth=2, resolution=RESOLUTION)
# One packed colour is off by at most this part of its largest channel.
ROUNDING = 0.002


@pytest.fixture(scope="module")
def lamp(mi, tmp_path_factory):
    """A sphere beside a diffuse bar, which shades and reflects some of its light."""
    path = tmp_path_factory.mktemp("lamp") / "lamp.xml"
    path.write_text(scene(sphere("ball", 0.5, inside=AREA), cube("bar", (1, 0.1, 0.3), (0, 1, 0))))
    return load_luminaire(path)


@pytest.fixture(scope="module")
def bakes(lamp, tmp_path_factory):
    """Fields by seed; the second of more paths."""
    folder = tmp_path_factory.mktemp("state")
    return {
        seed: bake_light_field(
            lamp, dataclasses.replace(CONFIG, seed=seed, paths=batches * BATCH), folder
        )
        for seed, batches in ((1, 8), (2, 16), (3, 8), (9, 32))
    }


def intensities(field):
    """[C, R², 3] of all bins, local units."""
    colours = field.scale * unpack(field.intensity)
    return np.stack([field.dense(channel) for channel in colours.T], axis=-1)


def by_direction(field):
    """[R²] luminous intensity, summed over cells."""
    return luminance(intensities(field).sum(axis=0))


def names(count):
    return [f"{letter}.lumitree" for letter in "abcd"[:count]]


@pytest.mark.slow
def test_merging_is_one_histogram_of_all_paths(mi, lamp, bakes):
    """The same light paths in one histogram: every bin is the same up to two roundings."""
    histogram = module.Histogram(CONFIG.depth, RESOLUTION)
    for seed, batches in ((1, 8), (2, 16)):
        for step in range(batches):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(SeedStream(Purpose.LIGHT_FIELD, step).seed(seed), BATCH)
            paths = trace_light(lamp, sampler, BATCH, PATH_DEPTH, all_light=True)
            flux = np.array(paths.flux, np.float64).reshape(3, -1)
            histogram.add(paths.origin, paths.direction, flux / 24)
    expected = intensity_of_histogram(histogram.flux)
    longer = make_light_field(histogram.cells, expected, CONFIG.depth)
    merged = merge_light_fields([bakes[1], bakes[2]], names(2))
    assert np.array_equal(merged.cells, longer.cells)
    assert np.array_equal(merged.lit, longer.lit)
    found, expected = intensities(merged), intensities(longer)
    assert (np.abs(found - expected) <= 3 * ROUNDING * expected.max(axis=-1, keepdims=True)).all()
    flux = [(each.sum(axis=0) * solid_angles(RESOLUTION)[:, None]).sum(axis=0) for each in
            (found, expected)]  # fmt: skip
    assert flux[0] == pytest.approx(flux[1], rel=2e-4)


def test_the_order_does_not_matter_but_for_rounding(bakes):
    first = merge_light_fields([bakes[1], bakes[2], bakes[3]], names(3))
    pair = merge_light_fields([bakes[3], bakes[1]], names(2))
    second = merge_light_fields([pair, bakes[2]], names(2))
    assert first.traced.count == second.traced.count == 32 * BATCH
    assert first.traced.seeds == second.traced.seeds == (1, 2, 3)
    assert np.array_equal(first.cells, second.cells)
    one, other = intensities(first), intensities(second)
    assert (np.abs(one - other) <= 4 * ROUNDING * one.max(axis=-1, keepdims=True)).all()


def test_the_merged_field_has_the_statistics_of_a_longer_bake(lamp, bakes):
    """32 batches in three bakes, and as many of another seed in one."""
    merged = merge_light_fields([bakes[1], bakes[2], bakes[3]], names(3))
    longer = bakes[9]
    assert merged.traced.count == longer.traced.count
    one, other = by_direction(merged), by_direction(longer)
    weight = solid_angles(RESOLUTION)
    difference = np.sqrt((weight * (one - other) ** 2).sum() / (weight * other**2).sum())
    expected = np.hypot(merged.traced.noise, longer.traced.noise)
    spread = 5 / np.sqrt(2 * RESOLUTION**2)
    # The noise of three bakes is known from two degrees of freedom a bin, that of 32 batches well.
    assert merged.traced.noise == pytest.approx(longer.traced.noise, rel=spread)
    assert difference == pytest.approx(expected, rel=spread)
    assert longer.traced.noise == pytest.approx(bakes[1].traced.noise / 2, rel=spread)
    # Flux of the whole: the noise of bins averages out.
    flux = (one * weight).sum() / (other * weight).sum()
    assert flux == pytest.approx(1, abs=5 * expected / RESOLUTION)


def test_the_irradiance_is_that_of_a_longer_bake(lamp, bakes):
    merged = merge_light_fields([bakes[1], bakes[2], bakes[3]], names(3))
    one, other = (
        asset_irradiance(light_field_asset(field, lamp.frame, "test"), 1 << 18, seed=seed)
        for seed, field in enumerate((merged, bakes[9]))
    )
    error = irradiance_error(one, other)
    noise = np.hypot(merged.traced.noise, bakes[9].traced.noise) / np.sqrt(RESOLUTION**2 / 6)
    assert (np.abs(error.ratio - 1) < 5 * np.hypot(error.ratio_error, noise)).all()


def test_the_noise_of_a_sphere_is_known(mi, tmp_path):
    """Its paths are spread evenly: R² bins of N paths have a relative error of √(R² / N)."""
    (tmp_path / "lamp.xml").write_text(scene(sphere("ball", 0.5, inside=AREA)))
    field = bake_light_field(load_luminaire(tmp_path / "lamp.xml"), CONFIG, tmp_path)
    assert field.traced.count == CONFIG.paths
    # Seven degrees of freedom a bin.
    spread = 5 / np.sqrt(2 * 7 * RESOLUTION**2)
    assert field.traced.noise == pytest.approx(np.sqrt(RESOLUTION**2 / CONFIG.paths), rel=spread)


def test_noise_from_one_estimate_or_none_is_not_known():
    assert relative_noise(np.ones((1, 16)), [5]) is None
    assert relative_noise(np.zeros((2, 16)), [5, 5]) is None
    # Σ N (I - Ī)² / (N (K - 1)) with Ī = 2.5 is 0.75.
    assert relative_noise([[1.0] * 16, [3.0] * 16], [1, 3]) == pytest.approx(0.75**0.5 / 2.5)


TRACED = TracedPaths(100, (1,), 64 * "a")
OTHER = dataclasses.replace(TRACED, seeds=(2,))


@pytest.fixture
def folder(mi, tmp_path, monkeypatch):
    """Assets a and b, which can be merged, and some that cannot be merged with them."""
    monkeypatch.chdir(tmp_path)
    frame = random_asset(0).frame

    def save(name, **options):
        lumitree.save(
            light_field_asset(random_light_field(3, **options), frame, name), f"{name}.lumitree"
        )

    save("a", traced=TRACED)
    save("b", traced=OTHER)
    save("again", traced=TracedPaths(7, (0, 1), 64 * "a"))
    save("other", traced=dataclasses.replace(OTHER, luminaire=64 * "b"))
    save("coarse", traced=OTHER, depth=1)
    save("fine", traced=OTHER, resolution=8)
    save("unknown")
    lumitree.save(random_asset(0), "field.lumitree")
    field = random_light_field(5, traced=dataclasses.replace(TRACED, seeds=(3,)))
    lumitree.save(dataclasses.replace(random_asset(0), light_field=field), "both.lumitree")
    turned = random_asset(0, world_from_local=np.diag([2.0, 2, 2, 1])).frame
    lumitree.save(
        light_field_asset(random_light_field(3, traced=OTHER), turned, "x"), "large.lumitree"
    )
    return tmp_path


REFUSED = [
    (["a"], "merge takes at least two assets"),
    (["a", "again"], "a.lumitree and again.lumitree have light paths of the same seed 1"),
    (["a", "b", "a"], "a.lumitree and a.lumitree have light paths of the same seed 1"),
    (["a", "other"], "a.lumitree and other.lumitree were baked from different luminaires"),
    (["a", "coarse"], "a.lumitree has 4 cells and 4 bins a side, coarse.lumitree 2 cells and 4"),
    (["a", "fine"], "a.lumitree has 4 cells and 4 bins a side, fine.lumitree 4 cells and 8 bins"),
    (["a", "unknown"], "unknown.lumitree does not state the light paths"),
    (["field", "a"], "field.lumitree has no light field; bake it again with the part"),
    (["a", "large"], "a.lumitree and large.lumitree have different bounding boxes"),
    (["a", "none"], "none.lumitree does not exist"),
]


@pytest.mark.parametrize(("given", "message"), REFUSED)
def test_what_does_not_belong_together_is_refused(folder, capsys, given, message):
    before = sorted(os.listdir())
    files = [f"{name}.lumitree" for name in given]
    with pytest.raises(LumitreeError) as caught:
        lumitree.merge(files, "c.lumitree")
    assert message in str(caught.value)
    assert main(["merge", *files, "-o", "c.lumitree"]) == 2
    assert capsys.readouterr().err == f"lumitree: error: {caught.value}\n"
    assert sorted(os.listdir()) == before


def test_one_path_is_not_a_list_of_assets(folder):
    with pytest.raises(LumitreeError, match="at least two assets"):
        lumitree.merge("a.lumitree")


def test_assets_in_memory(folder):
    a, b = (lumitree.load(f"{name}.lumitree") for name in "ab")
    assert lumitree.merge([a, b]).path is None
    with pytest.raises(LumitreeError, match=r"asset 1 \(a\) and asset 3 \(a\) have light paths"):
        lumitree.merge([a, b, a])


def test_a_command_merges(folder, capsys):
    line = ["merge", "a.lumitree", "b.lumitree", "both.lumitree", "-o", "c.lumitree"]
    assert main([*line, "--json", "report.json"]) == 0
    merged, both = lumitree.load("c.lumitree"), lumitree.load("both.lumitree")
    # Everything but the light field is that of the asset with a field.
    assert np.array_equal(merged.children, both.children)
    assert np.array_equal(merged.coefficients, both.coefficients)
    assert merged.light_field.traced.count == merged.info.light_field_paths == 300
    assert merged.light_field.traced.seeds == (1, 2, 3)
    with open("report.json") as file:
        assert json.load(file)["asset"]["light_field_paths"] == 300
    assert "light_field_paths  300" in capsys.readouterr().out
    again = lumitree.merge([f"{name}.lumitree" for name in ("a", "b", "both")])
    assert_equal_fields(again.asset.light_field, merged.light_field)
