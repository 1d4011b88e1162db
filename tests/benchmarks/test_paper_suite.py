"""The whole benchmark `paper` at its smallest scale: structure and orders of magnitude."""

import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.__main__ import main
from benchmarks.paper_tables.page import all_cells
from benchmarks.paper_tables.scales import SCALES

# A floor and a wall where the pair of `neoclassical` has its room.
ROOM = (
    '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="50"/>'
    '<transform name="to_world"><lookat origin="0,5,9" target="0,4.5,-1" up="0,1,0"/></transform>'
    '<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>'
    '<rfilter type="box"/></film></sensor><integrator type="path"/>'
    '<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>'
    '<scale value="8"/></transform></shape>'
    '<shape type="rectangle"><transform name="to_world"><scale value="8"/>'
    '<translate z="-5"/></transform></shape></scene>'
)


@pytest.mark.slow
def test_the_whole_suite_in_minutes(network_packages, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Cells are processes of their own, and many compile the same programs.
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "jax"))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    for room in ("living_room", "veach_bidir", "modern_hall"):
        (tmp_path / "rooms" / room).mkdir(parents=True)
        (tmp_path / "rooms" / room / "room_night.xml").write_text(ROOM)
    argv = ["paper", "--scale", "test", "-o", "out"]
    assert main(argv) == 0
    scale = SCALES["test"]
    folder = tmp_path / "out" / "paper" / "test"
    records = {path.stem: json.loads(path.read_text()) for path in folder.glob("*.json")}
    assert set(records) == {cell.name for cell in all_cells(scale)}
    values = {name: record["values"] for name, record in records.items()}
    assert all(record["seconds"] > 0 for record in records.values())
    assert all(record["peak_memory_bytes"] > 1e8 for record in records.values())

    (lamp,) = scale.lamps
    network, direct = values[f"1-{lamp}-network"], values[f"1-{lamp}-direct"]
    for metrics in (network["network"], network["octree"], direct["direct"]):
        assert 20 < metrics["psnr_linear"] < 60
        assert 0 < metrics["opacity_rmse"] < 0.6
        assert metrics["psnr_linear_black"] == network["network"]["psnr_linear_black"]
    # The octree is the network's: its errors are similar.
    for name, tolerance in (("psnr_linear", 3), ("opacity_rmse", 0.1)):
        assert abs(network["octree"][name] - network["network"][name]) < tolerance
    # Without the term of the opacity, the opacity is worse.
    assert (
        values["2-opacity"]["metrics"]["opacity_rmse"]
        < 0.9 * values["2-mse"]["metrics"]["opacity_rmse"]
    )
    # Bytes of a leaf: 27 coefficients of 2 bytes, or 3.
    low, high = (values[f"3-{l_max}-direct"] for l_max in scale.bands)
    assert low["bytes"] / low["leaves"] < 0.6 * high["bytes"] / high["leaves"]
    assert set(values["4-neoclassical-query"]["nanoseconds"]) == {"exponential", "linear"}
    for law in ("exponential", "linear", "literal"):
        assert 20 < values[f"4-neoclassical-{law}-0"]["network"]["psnr_linear"] < 60
    equal = values["5-neoclassical"]
    for parts in (equal["parts"][name] for name in ("explicit", "divided")):
        assert set(parts) == {"whole", "beside"}
    assert all(0 < pace < 100 for pace in equal["seconds_per_sample"].values())

    text = (folder / "page.md").read_text()
    assert text.count("Measured by") == 5
    for path in (folder / "paper" / "images").iterdir():
        assert np.ptp(np.array(Image.open(path))) > 50
    # The same command again measures nothing.
    changed = {path: path.stat().st_mtime_ns for path in folder.glob("*.json")}
    assert main(argv) == 0
    assert changed == {path: path.stat().st_mtime_ns for path in folder.glob("*.json")}
