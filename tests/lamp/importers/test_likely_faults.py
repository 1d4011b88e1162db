"""Faults of exported models are said with a line of TOML, and the line mends them."""

import re
import warnings

import numpy as np
import pytest

from lumitree.asset.materials import ThinDielectric
from lumitree.lamp.materials import glass as glass_surface
from lumitree.lamp.meshes import area_normals
from lumitree.lamp.read_source import read_model
from lumitree.lamp.source import LuminaireSource
from support.gltf_builder import Gltf, sphere

VOLUME = {"KHR_materials_volume": {"thicknessFactor": 0.01}}


def read(path, **options):
    """A model, and what is said of it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read_model(LuminaireSource(str(path), **options))
    return model, [str(each.message) for each in caught if "put first into" in str(each.message)]


def mended(path):
    """The model with all the lines that are said, after which nothing is said any more."""
    toml = path.with_suffix(".toml")
    toml.unlink(missing_ok=True)
    lines = [re.search(r"put first into lamp\.toml: (.*)", each)[1] for each in read(path)[1]]
    toml.write_text("\n".join(lines))
    model, said = read(path)
    assert said == []
    return model


def material(model, title):
    return next(each for each in model.materials if each.title == title)


def light_and_core(strength=2533.0, **fields):
    """Lamp as Blender exports it: a light of 10 W, and a ball of 10 W with a radius of 1 cm."""
    gltf = Gltf()
    core = {"name": "core", "emissiveFactor": [1, 1, 1]} | fields
    core["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    gltf.sphere(gltf.material(**core), radius=0.01)
    gltf.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[0, 1, 0])
    light = {"type": "point", "intensity": 10 / (4 * np.pi) * 683, "name": "Point"}
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    return gltf


def watts(model):
    """Radiant flux of each part that emits."""
    found = {}
    for part in model.parts:
        radiance = next(each.radiance for each in model.materials if each.name == part.material)
        if radiance is not None:
            area = (
                np.linalg.norm(area_normals(part.mesh.vertices, part.mesh.faces), axis=1).sum() / 2
            )
            found[part.material] = np.pi * area * radiance[0]
    return found


def test_emission_beside_lights_in_candela(tmp_path):
    path = light_and_core().save(tmp_path)
    model, said = read(path)
    assert len(said) == 1
    assert "material 'core' emits 2533 cd/m² beside lights in candela" in said[0]
    assert watts(model)["core"] == pytest.approx(10 / 683, rel=0.01)
    assert watts(mended(path)) == pytest.approx({"core": 10, "light_Point": 10}, rel=0.01)


@pytest.mark.parametrize("option", [{"drop": ["light_Point"]}, {"keep": ["light_Point"]}])
def test_lights_or_emission_alone_have_one_unit(tmp_path, option):
    assert read(light_and_core().save(tmp_path), **option)[1] == []


def glass(*balls, rough=0.0, colour=(1, 1, 1), transmission=1.0, volume=False, inside=None):
    """Balls of glass, the second inside out, with a small one of another material."""
    gltf = Gltf()
    extensions = {"KHR_materials_transmission": {"transmissionFactor": transmission}}
    extensions |= {"KHR_materials_ior": {"ior": 1.45}} | (VOLUME if volume else {})
    core = {"roughnessFactor": rough, "metallicFactor": 0, "baseColorFactor": [*colour, 1]}
    index = gltf.material(name="glass", pbrMetallicRoughness=core, extensions=extensions)
    for at, radius in enumerate(balls):
        gltf.sphere(index, radius=radius, segments=16, inside_out=at == 1)
    lit = gltf.material(name="lit", emissiveFactor=[1, 1, 1])
    gltf.sphere(lit, radius=0.01, segments=8, translation=[0 if inside else 9, 0, 0])
    return gltf


def joined(radii):
    """Walls in one primitive."""
    gltf = glass(inside=True)
    meshes = [sphere(radius, 16) for radius in radii]
    count = len(meshes[0].vertices)
    faces = np.concatenate([meshes[0].faces, meshes[1].faces[:, ::-1] + count])
    vertices = np.concatenate([each.vertices for each in meshes])
    gltf.node(gltf.primitive(vertices, faces.astype(np.uint32), material=0))
    return gltf


@pytest.mark.parametrize("gltf", [glass(1), glass(1, 0.9, inside=True), joined([1, 0.9])])
def test_closed_glass_without_a_volume(tmp_path, gltf):
    """Blender exports glass so: drops do not refract, and a wall with both sides counts twice."""
    path = gltf.save(tmp_path)
    model, said = read(path)
    assert len(said) == 1
    assert "material 'glass' is glass without a volume, a thin sheet in glTF" in said[0]
    assert isinstance(material(model, "glass").surface, ThinDielectric)
    assert material(mended(path), "glass").surface == glass_surface(1.45)


@pytest.mark.parametrize(
    "gltf",
    [
        # A bulb that is one sheet around its filament.
        glass(1, inside=True),
        glass(1, volume=True),
        glass(1, 0.9, volume=True, inside=True),
        glass(),
    ],
)
def test_glass_that_is_as_the_file_says(tmp_path, gltf):
    assert read(gltf.save(tmp_path))[1] == []


def test_open_sheets_of_glass_stay_thin(tmp_path):
    gltf = glass()
    gltf.quad(0)
    model, said = read(gltf.save(tmp_path))
    assert said == []
    assert isinstance(material(model, "glass").surface, ThinDielectric)
