"""The harness from end to end, on a lamp and a room of a few shapes."""

import argparse
import json

import numpy as np
import pytest
from PIL import Image

import lumitree
from benchmarks.common.results import Results
from benchmarks.equal_error.pairs import Pair, read_pairs
from benchmarks.equal_error.readings import display_levels, display_rows
from benchmarks.equal_quality import measure, write
from lumitree.core.device import on_device
from support.fields import random_asset
from support.lamps import AREA, cube, scene, sphere

ROOM = (
    '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="60"/>'
    '<transform name="to_world"><lookat origin="0,1.5,5" target="0,0.5,0" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>'
    '<rfilter type="box"/></film></sensor>'
    '<integrator type="path"/><shape type="rectangle"><transform name="to_world">'
    '<rotate x="1" angle="-90"/><scale value="4"/></transform></shape></scene>'
)


@pytest.fixture
def pair(mi, tmp_path):
    lamp, room = tmp_path / "lantern", tmp_path / "cellar"
    lamp.mkdir()
    room.mkdir()
    (lamp / "luminaire.xml").write_text(scene(sphere("bulb", 0.5, inside=AREA)))
    (room / "room_night.xml").write_text(ROOM)
    lumitree.save(random_asset(3, density_scale=4.0), lamp / "lantern.lumitree")
    return Pair(
        luminaire=str(lamp / "luminaire.xml"),
        asset=str(lamp / "lantern.lumitree"),
        room=str(room / "room_night.xml"),
        at=(0.0, 1.2, 0.0),
        size=1.0,
        bake_seconds=10.0,
    )


@pytest.fixture
def options(tmp_path):
    return argparse.Namespace(
        time=0.0,
        width=16,
        path_depth=6,
        explicit="lumitree_path",
        clock="cpu",
        cache=tmp_path / "cache",
        output=tmp_path / "results",
        benchmark="equal_quality",
        command="python -m benchmarks equal_quality",
    )


@pytest.mark.slow
def test_a_pair_from_end_to_end(pair, options):
    row = measure(pair, options)
    assert (row["luminaire"], row["room"]) == ("lantern", "cellar")
    assert row["integrators"] == ["lumitree_path", "lumitree_path"]
    assert row["resolution"] == [16, 12]
    assert row["at_paper_samples"]["baked_spp"] == 32
    # The asset is another lamp altogether, and the bake's error says so.
    assert row["bake"]["mse"] > 5 * row["bake"]["mse_error"] > 0
    assert row["bake"]["rmse"] > row["reference"]["rmse"] > 0
    assert row["speedup"] > 0
    assert 0.3 < row["lit_share"] < 0.95
    assert row["speedup_lit"] > 0
    assert row["speedup_lit_robust"] > 0
    for name in row["pictures"]:
        assert np.ptp(np.array(Image.open(options.output / name))) > 100
    # Once more: the ladders are kept, and so the times are the very same.
    again = measure(pair, options)
    assert again["ladders"]["baked"][-1]["seconds"] == row["ladders"]["baked"][-1]["seconds"]

    write([row | {"luminaire": "other"}], Results(options))
    write([row], Results(options))
    write([again], Results(options, clock="cpu"))
    found = json.loads((options.output / "equal_quality.json").read_text())["pairs"]
    assert [each["luminaire"] for each in found] == ["other", "lantern"]
    text = (options.output / "equal_quality.md").read_text()
    assert "| lantern | cellar | 32 |" in text
    assert "* clock: cpu" in text


def test_heights_become_sizes(mi, tmp_path, pair):
    (tmp_path / "pairs.toml").write_text(
        '[[pair]]\nluminaire = "lantern/flat.xml"\nasset = "a.lumitree"\nroom = "cellar"\n'
        "at = [1, 2, 3]\nheight = 0.5\n"
    )
    flat = scene(cube("panel", (3, 1, 1), inside=AREA))
    (tmp_path / "lantern" / "flat.xml").write_text(flat)
    (found,) = read_pairs(tmp_path / "pairs.toml", tmp_path, tmp_path / "assets", tmp_path)
    assert found.name == "lantern-flat-cellar"
    assert found.room == pair.room
    assert found.size == pytest.approx(1.5)
    assert found.asset == str(tmp_path / "assets" / "a.lumitree")


@pytest.mark.parametrize("reference", ["explicit", "baked"])
def test_display_levels_subtract_the_noise_of_the_reference(reference):
    """Two methods of equal bias 0 and known noise: times in proportion to their variances."""
    random = np.random.default_rng(3)
    clean = np.full((40, 40, 3), 0.5)

    def noisy(count, deviation):
        return clean + random.normal(0, deviation, (count, 40, 40, 3))

    def rungs(deviation):
        return [
            {"samples": n, "images": noisy(1, deviation / n**0.5), "seconds": {"cpu": [float(n)]}}
            for n in (1, 4, 16, 64)
        ]

    runs = {
        "explicit": (rungs(0.4), noisy(16, 0.4 / 16), 16 * 256.0),
        "baked": (rungs(0.1), noisy(16, 0.1 / 16), 16 * 256.0),
    }
    rows, own = display_rows(runs, "cpu", reference=reference)
    assert own == pytest.approx(rows[reference][-1]["rmse"] / 2**0.5, rel=1e-6)
    for level in display_levels(rows, own):
        assert level["speedup"] == pytest.approx(16, rel=0.25)
    assert display_levels(rows, 6.0)[1]["speedup"] is None


def test_kept_images_depend_on_all_code_that_renders(monkeypatch):
    from benchmarks.equal_error import method

    files = []
    monkeypatch.setattr(method, "digest", lambda *paths: files.extend(paths))
    method.code_digest()
    folders = {path.parent.name for path in files}
    assert {"rendering", "plugins", "sampling", "octree", "asset", "core"} <= folders


def test_thresholds_reach_the_fields_of_placed_lamps(mi):
    """Rays to the lamp have the radiance of a field with the thresholds."""
    from benchmarks.equal_error.method import Way, set_thresholds
    from lumitree.octree.field import Field
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    asset = random_asset(7)
    empty = mi.load_dict({"type": "scene"})
    scene = place_luminaires(empty, [PlacedLuminaire(Placement(asset))], sampling="uniform")
    direction = np.random.default_rng(7).normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    o, d = on_device(mi.Point3f, -3 * direction), on_device(mi.Vector3f, direction)
    si = scene.ray_intersect(mi.Ray3f(o, d))
    exact = np.array(si.emitter(scene).eval(si))
    set_thresholds(scene, Way("uniform", 0.1, 0.9))
    (emitter,) = scene.emitters()
    line, enters = emitter.placed.entering_line(si, si.is_valid())
    radiance, through = (np.array(each) for each in Field(asset, 0.1, 0.9).emission(*line, enters))
    assert np.array(emitter.eval(si)) == pytest.approx(radiance, rel=1e-5)
    assert exact != pytest.approx(radiance, rel=1e-2)
    transmittance = np.array(si.bsdf().eval_null_transmission(si))
    assert transmittance == pytest.approx(np.broadcast_to(through, (3, 500)), abs=1e-5)
