"""Which rays a bake sees: none twice, and the same again for the same seed."""

import pytest
from test_bake import config

from lamps import AREA, GLASS, cube, sphere
from lumitree.core.seeds import Purpose, SeedStream


@pytest.fixture
def seeds(monkeypatch):
    """Records every seed that is used: (root, stream, part) and its value."""
    used = []
    seed = SeedStream.seed

    def record(self, root, part=0):
        used.append(((root, self, part), seed(self, root, part)))
        return used[-1][1]

    monkeypatch.setattr(SeedStream, "seed", record)
    return used


@pytest.fixture
def bulb(lamp):
    return lamp(
        sphere("glass", 1, (0, 0, 0), GLASS),
        sphere("lamp", 0.2, (0.3, 0, 0), AREA),
        cube("foot", 0.3, (0, -0.9, 0)),
    )


def test_no_random_numbers_are_used_twice(bulb, tmp_path, seeds, monkeypatch):
    """Not by the estimate and the descent, nor by the score, nor by a bake and its refinement."""
    from lumitree.direct.bake import bake, refine

    few = {
        "bake._ESTIMATE_DEPTH": 4,
        "estimate._START_LEVEL": 3,
        "estimate._BATCH": 1 << 15,
        "balance._LINES": 1 << 12,
        "balance._TOTAL_LINES": 1 << 12,
        "heldout._NUM_LINES": 1 << 12,
        "refine._BLAME_LINES": 1 << 12,
    }
    for name, value in few.items():
        monkeypatch.setattr(f"lumitree.direct.{name}", value)
    settings = config(tree_depth=5, estimate_lines=1 << 17, rays=1 << 16, refine={"lines": 1 << 11})
    asset = bake(bulb, settings, tmp_path / "bake").asset
    refine(asset, bulb, settings, tmp_path / "refine")
    purposes = {stream.purpose for (_, stream, _), _ in seeds}
    assert purposes == set(Purpose) - {
        Purpose.CAPTURE,
        Purpose.PREVIEW,
        Purpose.FLUX,
        Purpose.LONG_PATHS,
        Purpose.RENDER,
    }
    keys, values = zip(*seeds, strict=True)
    assert len(set(keys)) == len(keys)
    assert len(set(values)) == len(values)
