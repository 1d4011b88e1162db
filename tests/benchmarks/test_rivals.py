"""Methods of other renderers: their scenes, their figures, and the harness from end to end."""

import numpy as np
import pytest

from benchmarks.equal_error.batches import MAX_BATCHES, MIN_BATCHES, LongRun
from benchmarks.rival_methods.figures import (
    display_ladder,
    display_times,
    figures,
)
from benchmarks.rival_methods.method import Method, TimedImage, extend, opened_run
from lumitree.asset.materials import (
    Dielectric,
    Diffuse,
    Mask,
    Principled,
    RoughPlastic,
    ThinDielectric,
    TwoSided,
)
from support.lamps import AREA, GLASS, sphere

METAL = (
    '<bsdf type="roughconductor"><string name="material" value="Au"/>'
    '<float name="alpha" value="0.2"/></bsdf>'
)
# Hollow: of what emits in solid glass, Cycles does not divide the radiance by the squared index.
BULB = (
    sphere("bulb", 0.5, inside=GLASS),
    sphere("cavity", 0.45, inside=GLASS, flip=True),
    sphere("wire", 0.1, inside=METAL + AREA),
)


class Noisy:
    """Images of a plain wall, 2 CPU seconds a sample, with independent noise."""

    def __init__(self, deviation, level=1.0, shape=(24, 32)):
        self.deviation, self.level, self.shape, self.calls = deviation, level, shape, []

    def images(self, samples, seeds):
        self.calls.append((samples, len(seeds)))
        for seed in seeds:
            noise = np.random.default_rng(seed).normal(0, self.deviation, (*self.shape, 1))
            image = np.repeat(self.level + noise / samples**0.5, 3, axis=-1)
            yield TimedImage(image.astype(np.float32), {"wall": samples, "cpu": 2.0 * samples})


def run_of(renderer, path, images=24):
    run = LongRun(path, path.name, 4)
    for image in renderer.images(4, run.next_seeds[:images]):
        run.append(image.radiance, image.seconds)
    return run


def test_images_are_made_until_they_have_cost_enough(tmp_path):
    renderer = Noisy(0.1)
    method = Method("noisy", "noisy", renderer)
    run = opened_run(method, tmp_path, {"width": 32})
    extend(run, method, 0)
    assert not renderer.calls
    extend(run, method, 100)
    assert renderer.calls == [(4, MIN_BATCHES), (4, 5)]
    assert run.seconds["cpu"] == 104
    again = opened_run(method, tmp_path, {"width": 32})
    assert len(again.batches) == 13
    extend(again, method, 100)
    assert len(renderer.calls) == 2
    extend(again, method, 400)
    assert again.seconds["cpu"] >= 400
    # Neighbours were averaged on the way, and no image is met twice.
    assert again.samples == 8
    assert len(np.unique(again.batches[:, 0, 0, 0])) == len(again.batches) < MAX_BATCHES
    assert len(opened_run(method, tmp_path, {"width": 64}).batches) == 0


def test_figures_of_known_noise(tmp_path):
    run = run_of(Noisy(0.3, 1.05), tmp_path / "a.npz")
    reference = run_of(Noisy(0.01, 1.0), tmp_path / "b.npz")
    clean, mask = np.ones((24, 32, 3)), np.ones((24, 32), bool)
    found = figures(run, mask, reference, None, clean)
    assert found.milliseconds == pytest.approx(2000)
    assert found.variance == pytest.approx(0.09, rel=0.1)
    assert found.product == pytest.approx(180, rel=0.1)
    assert found.mean.value == pytest.approx(1.05, abs=3 * found.mean.error)
    assert (found.samples, found.images, found.display) == (96, 24, ())
    assert found.verdict == "biased"


def test_display_error_of_noise_falls_as_the_root_of_time(tmp_path):
    """Images of other brightness have the noise's error alone."""
    run = run_of(Noisy(0.05, 1.3), tmp_path / "a.npz")
    seconds, errors = display_ladder(run, np.ones((24, 32, 3)))
    assert len(seconds) == 4
    np.testing.assert_allclose(errors * np.sqrt(seconds), errors[0] * seconds[0] ** 0.5, rtol=0.1)
    # One image: 8 CPU s; its deviation from the mean of 24 has less variance.
    assert seconds[0] == pytest.approx(8 / (1 - 1 / 24))
    kinds = [each.kind for each in display_times(run, np.ones((24, 32, 3)))]
    assert kinds == ["below"] * 3
    # Beyond the images the variance tells the time, however many tones are clipped in them.
    loud = display_times(run_of(Noisy(2.0), tmp_path / "b.npz"), np.ones((24, 32, 3)))
    assert [each.kind for each in loud] == ["extrapolated"] * 3
    for each in loud:
        quiet = errors[0] ** 2 * seconds[0] * (2.0 / 0.05) ** 2 / each.level**2
        assert each.seconds == pytest.approx(quiet, rel=0.15)


def test_denoised_images_have_less_noise(mi, tmp_path):
    pytest.importorskip("mitsuba_oidn")
    from benchmarks.rival_methods.denoising import Guides, denoised_noise

    shape = (48, 64)
    wall = Guides(np.full((*shape, 3), 0.5, np.float32), np.zeros((*shape, 3), np.float32))
    run, clean = run_of(Noisy(0.2, shape=shape), tmp_path / "a.npz"), np.ones((*shape, 3))
    found = denoised_noise(run, wall, np.ones(shape, bool), clean, 30.0)
    # Four images of 8 CPU s, of four samples each: 5 % without the filter.
    assert found["seconds"] == 32
    assert 0 < found["error"] < 0.02


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        (Diffuse(reflectance=0.5), {"type": "matte", "kd": [0.5] * 3}),
        (
            Dielectric(int_ior=1.5, ext_ior=1.0),
            {"type": "glass", "kr": [1.0] * 3, "kt": [1.0] * 3, "interiorior": 1.5},
        ),
        (ThinDielectric(int_ior=1.5, ext_ior=1.0), {"type": "archglass"}),
        (
            Mask(opacity=0.25, nested=(Diffuse(),)),
            {"type": "mix", "amount": 0.25, "material1": "x_clear", "material2": "x_0"},
        ),
        (
            TwoSided(nested=(Diffuse(reflectance=0.5),)),
            {"type": "matte", "kd": [0.5] * 3},
        ),
        (
            RoughPlastic(diffuse_reflectance=0.3, int_ior=1.6, ext_ior=1.0),
            {"type": "glossy2", "kd": [0.3] * 3, "index": 1.6, "uroughness": 0.1},
        ),
        (
            Principled(base_color=(0.2, 0.4, 0.6), roughness=0.5, eta=1.4),
            {"type": "glossy2", "kd": [0.2, 0.4, 0.6], "index": 1.4, "vroughness": 0.25},
        ),
    ],
)  # fmt: skip
def test_luxcore_materials(mi, material, expected):
    from benchmarks.rival_methods.luxcore import material_properties

    found = material_properties("x", material)
    for name, value in expected.items():
        assert found[f"scene.materials.x.{name}"] == pytest.approx(value) or value == found[name]


def test_point_lights_have_the_flux_of_the_light_field(mi):
    from benchmarks.rival_methods.mitsuba_methods import point_lights_asset
    from lumitree.asset.asset import light_field_asset
    from lumitree.core.frames import LocalFrame
    from lumitree.rendering.asset_flux import light_field_watts
    from support.light_fields import random_light_field

    frame = LocalFrame([1, 1, 1], np.eye(4))
    asset = light_field_asset(random_light_field(1, depth=3, count=20), frame, "lamp")
    for count in (1, 16):
        found = point_lights_asset(asset, count).light_field
        assert len(found.cells) == count
        np.testing.assert_allclose(
            light_field_watts(found), light_field_watts(asset.light_field), rtol=5e-3
        )
