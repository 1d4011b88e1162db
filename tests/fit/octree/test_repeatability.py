"""The random numbers of a bake: none is used twice, and equal seeds give equal assets."""

import pytest
from test_bake import small_config

from lumitree.asset.file import save
from lumitree.core.seeds import Purpose, SeedStream
from support import tiny_bakes
from support.lamps import AREA, GLASS, cube, sphere


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


@pytest.fixture
def small():
    """Settings of a bake of all stages that takes seconds."""
    return small_config(tree_depth=5, rays=1 << 16)


@pytest.mark.slow
def test_no_random_numbers_are_used_twice(bulb, small, tmp_path, seeds):
    """Not by the estimate and the descent, nor by the score, nor by a bake and its refinement."""
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.fit.octree.bake import bake, refine

    bake_light_field(bulb, tiny_bakes.LIGHT_FIELD, tmp_path / "light")
    asset = bake(bulb, small, tmp_path / "bake").asset
    refine(asset, bulb, small, tmp_path / "refine")
    purposes = {stream.purpose for (_, stream, _), _ in seeds}
    assert purposes == set(Purpose) - {
        Purpose.ASSET_FLUX,
        Purpose.CAPTURE,
        Purpose.CELLS,
        Purpose.DESIGN,
        Purpose.EXPORT,
        Purpose.FIELD_RAYS,
        Purpose.PREVIEW,
        Purpose.ILLUMINANCE,
        Purpose.IRRADIANCE,
        Purpose.LINES,
        Purpose.LONG_PATHS,
        Purpose.PHOTOMETRY,
        Purpose.RECEIVED,
        Purpose.RENDER,
        Purpose.SPECTRUM,
        Purpose.SURFACES,
    }
    keys, values = zip(*seeds, strict=True)
    assert len(set(keys)) == len(keys)
    assert len(set(values)) == len(values)


@pytest.mark.slow
def test_equal_seeds_give_equal_assets_with_any_number_of_threads(bulb, small, tmp_path):
    import drjit as dr

    from lumitree.fit.octree.bake import bake

    threads = dr.thread_count()
    contents = []
    try:
        for number, count in enumerate((1, 2 * threads)):
            dr.set_thread_count(count)
            asset = bake(bulb, small, tmp_path / f"{number}").asset
            save(asset, tmp_path / f"{number}.lumitree")
            contents.append((tmp_path / f"{number}.lumitree").read_bytes())
    finally:
        dr.set_thread_count(threads)
    assert contents[0] == contents[1]
    save(bake(bulb, small, tmp_path / "other", seed=1).asset, tmp_path / "other.lumitree")
    assert (tmp_path / "other.lumitree").read_bytes() != contents[0]
