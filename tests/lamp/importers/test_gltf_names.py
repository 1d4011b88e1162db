"""Names of materials and objects of glTF files, by which files of overrides and options choose."""

import numpy as np
import pytest

from lumitree.core.photometry import flux_from_radiance
from lumitree.errors import LumitreeError
from lumitree.lamp.importers.overrides import emitting_area
from lumitree.lamp.read_source import read_model
from lumitree.lamp.source import LuminaireSource
from support.gltf_builder import Gltf

# Light from the front only.
pytestmark = pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")

LIGHT = {"emissiveFactor": [1, 1, 1], "doubleSided": True}


def model_of(folder, gltf, overrides="", **selection):
    path = gltf.save(folder)
    if overrides:
        (folder / "lamp.toml").write_text(overrides, encoding="utf-8")
    return read_model(LuminaireSource(str(path), **selection))


@pytest.mark.parametrize("key", ["bulb glass", "bulb_glass"])
def test_an_override_reaches_all_surfaces_of_a_material(tmp_path, key):
    """A closed and an open mesh, for which the material is converted in two ways."""
    gltf = Gltf()
    material = gltf.material(name="bulb glass", **LIGHT)
    gltf.sphere(material, segments=16)
    gltf.quad(material, translation=[3, 0, 0])
    model = model_of(tmp_path, gltf, f'[material."{key}"]\nemitter = {{ lumens = 1600 }}')
    assert [item.title for item in model.materials] == ["bulb glass"] * 2
    assert model.materials[0].radiance == model.materials[1].radiance
    area = emitting_area(model, "bulb glass")
    assert area == pytest.approx(4 * np.pi + 4, rel=0.05)
    assert flux_from_radiance(model.materials[0].radiance, area) == pytest.approx(1600)


def test_names_of_any_alphabet_are_those_of_the_file(tmp_path):
    gltf = Gltf()
    for name, x in (("灯泡", 0), ("灯罩", 3)):
        gltf.quad(gltf.material(name=name), translation=[x, 0, 0])
    model = model_of(tmp_path, gltf, '[material."灯罩"]\nemitter = { radiance = 2 }')
    assert [item.radiance for item in model.materials] == [None, (2.0, 2.0, 2.0)]
    with pytest.raises(LumitreeError, match="no material is called '灯'; the model has 灯泡, 灯罩"):
        model_of(tmp_path, gltf, '[material."灯"]\nemitter = { radiance = 2 }')


def places_of(model):
    return sorted(round(float(place[0, 3])) for part in model.parts for place in part.places)


def test_objects_that_share_a_mesh_are_chosen_apart(tmp_path):
    gltf = Gltf()
    gltf.quad(gltf.material(name="glow", **LIGHT), name="Lamp A")
    for name, x in (("Lamp B", 5), ("Lamp.B.001", 6)):
        index = gltf.add("nodes", name=name, mesh=0, translation=[x, 0, 0])
        gltf.json["scenes"][0]["nodes"].append(index)
    assert places_of(model_of(tmp_path, gltf)) == [0, 5, 6]
    assert places_of(model_of(tmp_path, gltf, keep=["Lamp A"])) == [0]
    assert places_of(model_of(tmp_path, gltf, keep=["Lamp?B*"])) == [5, 6]
    assert places_of(model_of(tmp_path, gltf, drop=["Lamp B"])) == [0, 6]
    assert places_of(model_of(tmp_path, gltf, keep=["glow"])) == [0, 5, 6]
