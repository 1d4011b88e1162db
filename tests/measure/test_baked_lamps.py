"""Built-in lamps, baked in seconds, light a room and look as they should."""

import pytest

import lumitree
from lumitree.lamp.luminaire import load_luminaire
from lumitree.measure.irradiance import evaluate_irradiance
from support import tiny_bakes
from support.tiny_bakes import standard

PATHS = 1 << 20
# Gains over black in dB, linear and mu-law, that a bake of seconds must have, some 2 dB below what
# it has; and bounds on the irradiance of a face, relative to that of the explicit lamp: its mean,
# and its RMS difference. Harmonics of band 2 are too smooth for light from panes of `portica`.
FLOORS = {
    "arc": (1.2, 0.4, 0.10, 0.10),
    "bulbs": (9.5, 2.0, 0.06, 0.08),
    "cluster": (5.0, 0.6, 0.30, 0.35),
    "dallas": (7.5, 2.7, 0.06, 0.09),
    "neoclassical": (2.5, -3.4, 0.16, 0.25),
    "portica": (0.5, -2.8, 0.40, 0.45),
    "star": (8.0, 9.0, 0.04, 0.06),
}


@pytest.fixture
def bake(mi, monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setattr, tree_depth=6, l_max=2)
    return lambda name: lumitree.bake(name, config=standard(parts=["field"]), progress=None).asset


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bulbs", "dallas"])
def test_a_room_receives_the_light_of_the_explicit_lamp(bake, name):
    """What the method is for: the same irradiance on all sides, and on a table below."""
    error = evaluate_irradiance(bake(name), load_luminaire(name), PATHS).error
    # Half a million light paths set the flux of these short bakes, to about 1 %.
    assert error.total_ratio == pytest.approx(1, abs=0.03)
    assert error.ratio == pytest.approx(1, abs=FLOORS[name][2])
    assert (error.rms < FLOORS[name][3]).all()
    # The comparison is sharp enough to say so.
    assert (error.ratio_error < 0.01).all()
    assert (error.rms_error < 0.04).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", FLOORS)
def test_no_built_in_lamp_falls_below_its_floor(bake, name):
    assert set(FLOORS) == set(lumitree.builtin_luminaires())
    asset = bake(name)
    linear, mu_law, ratio, rms = FLOORS[name]
    report = lumitree.evaluate(asset, name, views=3, resolution=64, spp=128, progress=None)
    metrics = report.metrics
    for face in report.irradiance["faces"].values():
        assert face["ratio"] == pytest.approx(1, abs=ratio)
        assert face["rms"] < rms
    assert metrics["psnr_linear"] - metrics["psnr_linear_black"] > linear
    assert metrics["psnr_mulaw"] - metrics["psnr_mulaw_black"] > mu_law
    assert metrics["opacity_rmse"] < 0.15
