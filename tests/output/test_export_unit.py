"""A lamp in centimetres and the same one in metres are one lamp in other programs."""

import numpy as np
import pytest

import lumitree
from benchmarks.exported_files.gltf import GltfFile
from lumitree.cli import main
from lumitree.rendering.asset_flux import asset_lumens
from support.geometry_assets import small_geometry, with_geometry

pytestmark = pytest.mark.usefixtures("mi")


@pytest.fixture
def lamp():
    shapes = [dict(shape) for shape in small_geometry().shapes]
    shapes[2]["interior"] = [2.0, 20, 70]
    scattering = {"absorption": [1.0, 2, 3], "scattering": [4.0, 5, 6], "anisotropy": 0.5}
    shapes[2]["exterior"] = scattering
    return with_geometry(small_geometry(shapes=tuple(shapes)))


def test_a_factor_there_and_back_changes_nothing(lamp):
    large = lamp.scaled(100)
    assert large.frame.size == pytest.approx(100 * lamp.frame.size)
    assert asset_lumens(large) == pytest.approx(1e4 * asset_lumens(lamp))
    exterior = large.geometry.shapes[2]["exterior"]
    assert exterior["scattering"] == pytest.approx([0.04, 0.05, 0.06])
    assert exterior["anisotropy"] == 0.5
    again = large.scaled(0.01)
    np.testing.assert_allclose(again.frame.world_from_local, lamp.frame.world_from_local)
    np.testing.assert_allclose(again.geometry.vertices, lamp.geometry.vertices, rtol=1e-6)
    assert again.geometry.shapes[2]["interior"] == pytest.approx([2.0, 20, 70])


def test_the_unit_counts_in_exports(lamp, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lumitree.save(lamp.scaled(100), "cm.lumitree")
    assert main(["export", "cm.lumitree", "-o", "cm.glb", "--unit", "cm"]) == 0
    lumitree.export(lamp, "m.glb")
    found, expected = (GltfFile(tmp_path / f"{unit}.glb") for unit in ("cm", "m"))
    for name in ("lights", "surfaces"):
        pairs = zip(*(places(each, name) for each in (found, expected)), strict=True)
        for one, other in pairs:
            assert one == pytest.approx(other, rel=1e-5, abs=1e-6)
    for one, other in zip(found.json["meshes"], expected.json["meshes"], strict=True):
        one, other = (
            file.array(mesh["primitives"][0]["attributes"]["POSITION"])
            for file, mesh in ((found, one), (expected, other))
        )
        np.testing.assert_allclose(one, other, atol=1e-6)
    candela = [
        [each["intensity"] for each in file.json["extensions"]["KHR_lights_punctual"]["lights"]]
        for file in (found, expected)
    ]
    assert candela[0] == pytest.approx(candela[1], rel=1e-4)
    volume, other = (
        file.json["materials"][2]["extensions"]["KHR_materials_volume"]
        for file in (found, expected)
    )
    assert volume["attenuationDistance"] == pytest.approx(other["attenuationDistance"])


def places(file, name):
    """Translations of the nodes below a node."""
    (group,) = (each for each in file.json["nodes"] if each["name"] == name)
    return [file.json["nodes"][each].get("translation", [0, 0, 0]) for each in group["children"]]


def test_other_units_are_refused(lamp, tmp_path):
    with pytest.raises(lumitree.LumitreeError, match="unit is 'yard'; expected m, cm"):
        lumitree.export(lamp, tmp_path / "lamp.rad", unit="yard")
