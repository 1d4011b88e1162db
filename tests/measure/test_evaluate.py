"""Evaluations: how many paths they trace, views of geometry, and built-in lamps."""

from types import SimpleNamespace

import pytest

import lumitree
from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import load_luminaire
from lumitree.measure import evaluate
from lumitree.measure.evaluate import evaluate_views
from lumitree.measure.irradiance import evaluate_irradiance
from lumitree.trace.cameras import capture
from support import tiny_bakes
from support.lamps import AREA, lamp_of, sphere
from support.tiny_bakes import bake_config, standard

MOST = 1 << 20


@pytest.fixture
def lamp_of_cost(mi, monkeypatch):
    """Function that makes images take 0.01 s, and so many seconds for a sample of every pixel."""
    from lumitree.trace import cameras

    def made(of_sample):
        now = [0.0]

        class Camera:
            def __init__(self, _lamp, _resolution, samples):
                self._samples = samples

            def take(self, *_):
                now[0] += 0.01 + of_sample * self._samples

        clock = SimpleNamespace(monotonic=lambda: now[0], process_time=lambda: now[0])
        monkeypatch.setattr(evaluate, "clocks", clock)
        monkeypatch.setattr(cameras, "Camera", Camera)
        return SimpleNamespace(bounding_radius=1.0)

    return made


@pytest.mark.parametrize(
    ("time", "of_sample", "expected"),
    [
        # 8 images of 16² pixels: 0.08 s for a sample, 8 s of processor time.
        (None, 0.01, 64),
        (None, 0.04, 16),
        (None, 1e-9, 256),
        (None, 100.0, 1),
        (100.0, 0.01, 1024),
        (1.0, 0.01, 8),
        (1e6, 1e-9, MOST),
    ],
)
def test_samples_that_a_time_allows(lamp_of_cost, time, of_sample, expected):
    lamp = lamp_of_cost(of_sample)
    assert evaluate._samples_in(time, lamp, 16, 8 * 16**2) == expected


def test_a_time_is_checked():
    with pytest.raises(LumitreeError, match=r"time is 0; expected 0\.001 to"):
        evaluate.evaluate("a.lumitree", "lamp.xml", time=0)


@pytest.mark.slow
def test_geometry_is_compared_where_there_is_no_field(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("ball", 0.5, inside=AREA), sphere("other", 0.2, (0.9, 0, 0)))
    views = capture(lamp, tmp_path / "views", views=2, resolution=32, spp=64)
    parts = {"both": ("light", "geometry"), "light": ("light",)}
    assets = {
        name: lumitree.bake(lamp, config=bake_config(parts=each)).asset
        for name, each in parts.items()
    }
    found = {name: evaluate_views(asset, views).metrics for name, asset in assets.items()}
    # Silhouettes are anti-aliased by random samples.
    assert found["both"]["opacity_rmse"] < 0.03 < found["light"]["opacity_rmse"]
    assert found["both"]["psnr_linear"] > 30
    assert found["both"]["psnr_linear"] > found["light"]["psnr_linear"] + 5


IRRADIANCE_PATHS = 1 << 20
# Gains over black in dB, linear and mu-law, that a bake of seconds must have, some 2 dB below what
# it has; and bounds on the irradiance of a face, relative to the explicit lamp's: its mean,
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
    """The purpose of the method: the same irradiance on all sides, and on a table below."""
    error = evaluate_irradiance(bake(name), load_luminaire(name), IRRADIANCE_PATHS).error
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
