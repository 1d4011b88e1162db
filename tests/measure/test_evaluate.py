"""How many paths an evaluation traces."""

from types import SimpleNamespace

import pytest

from lumitree.errors import LumitreeError
from lumitree.measure import evaluate

MOST = 1 << 20


@pytest.fixture
def lamp_of_cost(mi, monkeypatch):
    """Function that makes images take 0.3 s, and so many seconds for a sample of every pixel."""
    from lumitree.trace import cameras

    def made(of_sample):
        now = [0.0]

        class Camera:
            def __init__(self, _lamp, _resolution, samples):
                self._samples = samples

            def take(self, *_):
                now[0] += 0.3 + of_sample * self._samples

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
