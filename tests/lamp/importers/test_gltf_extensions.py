"""glTF material extensions, as numbers: every field of the model that they set."""

import numpy as np
import pytest

from lumitree.lamp.parts import Diffuse, Glass, Principled
from support.gltf_builder import Gltf
from support.gltf_materials import extended, material_of, read_only


def test_transmission_of_a_sheet_is_thin_glass(tmp_path):
    core = {"roughnessFactor": 0, "baseColorFactor": [1, 0.5, 0.25, 1]}
    fields = extended(core, transmission={"transmissionFactor": 1}, ior={"ior": 1.4})
    surface = material_of(tmp_path, Gltf(), fields).surface
    assert surface == Glass(1.4, 0.0, (1.0, 0.5, 0.25), thin=True)


@pytest.mark.parametrize(
    ("core", "transmission"),
    [
        ({"roughnessFactor": 0.3}, {"transmissionFactor": 1}),
        ({"roughnessFactor": 0}, {"transmissionFactor": 0.5}),
    ],
)
def test_other_transmitting_sheets_are_thin_and_principled(tmp_path, core, transmission):
    fields = extended(core, transmission=transmission)
    surface = material_of(tmp_path, Gltf(), fields).surface
    factor = transmission["transmissionFactor"]
    expected = Principled((1.0, 1.0, 1.0), roughness=core["roughnessFactor"])
    assert surface == type(surface)(**vars(expected) | {"transmission": factor, "thin": True})


def body_of(tmp_path, fields, notes="", **node):
    gltf = Gltf()
    gltf.sphere(gltf.material(**fields), segments=16, **node)
    (material,) = read_only(gltf.save(tmp_path), notes).materials
    return material.surface


VOLUME = {"thicknessFactor": 0.5, "attenuationColor": [0.5, 0.25, 1], "attenuationDistance": 2.0}


def test_volumes_fill_closed_bodies(tmp_path):
    core = {"roughnessFactor": 0, "baseColorFactor": [0.25, 1, 1, 1]}
    fields = extended(core, transmission={"transmissionFactor": 1}, volume=VOLUME)
    surface = body_of(tmp_path, fields, scale=[3, 3, 3])
    assert surface.tint == (0.5, 1, 1)
    assert not surface.thin
    left = np.exp(-2.0 * np.array(surface.medium.absorption))
    np.testing.assert_allclose(left, (0.5, 0.25, 1))
    assert surface.medium.scattering == (0, 0, 0)
    rough = extended({"roughnessFactor": 0.4}, transmission={"transmissionFactor": 1},
                     volume={"thicknessFactor": 1})  # fmt: skip
    assert body_of(tmp_path, rough) == Glass(1.5, 0.4)


def test_volumes_of_sheets_are_tints(tmp_path):
    fields = extended({"roughnessFactor": 0}, transmission={"transmissionFactor": 1}, volume=VOLUME)
    surface = material_of(tmp_path, Gltf(), fields, "attenuation", scale=[3, 3, 3]).surface
    assert surface.thin
    assert surface.medium is None
    np.testing.assert_allclose(surface.tint, np.array([0.5, 0.25, 1]) ** (3 * 0.5 / 2.0))


def test_without_thickness_a_body_is_a_thin_shell(tmp_path):
    volume = VOLUME | {"thicknessFactor": 0}
    fields = extended({"roughnessFactor": 0}, transmission={"transmissionFactor": 1}, volume=volume)
    assert body_of(tmp_path, fields) == Glass(thin=True)


def reflectance(ior):
    return ((ior - 1) / (ior + 1)) ** 2


@pytest.mark.parametrize(
    ("extensions", "expected", "notes"),
    [
        ({"ior": {"ior": 1.8}}, reflectance(1.8), ""),
        ({"specular": {"specularFactor": 0.5}}, 0.02, ""),
        ({"specular": {"specularFactor": 0}}, 0, ""),
        ({"specular": {"specularColorFactor": [2, 2, 2]}}, 0.08, ""),
        ({"specular": {"specularColorFactor": [3, 1, 2]}}, 0.08, "specular colour"),
        ({"ior": {"ior": 0}, "specular": {"specularFactor": 0.3}}, 0.3, ""),
    ],
)
def test_reflectance_at_normal_incidence(tmp_path, extensions, expected, notes):
    surface = material_of(tmp_path, Gltf(), extended(**extensions), notes).surface
    found = surface.specular * reflectance(surface.ior)
    assert found == pytest.approx(expected, abs=1e-6)


def alphas(surface):
    """Alpha along and across u, by Mitsuba's definition."""
    aspect = np.sqrt(1 - 0.9 * surface.anisotropy)
    return surface.roughness**2 / aspect, surface.roughness**2 * aspect


def test_anisotropy_along_u_is_exact(tmp_path):
    fields = extended({"roughnessFactor": 0.5}, anisotropy={"anisotropyStrength": 0.6})
    along, across = alphas(material_of(tmp_path, Gltf(), fields).surface)
    assert across == pytest.approx(0.25)
    assert along == pytest.approx(0.25 + 0.75 * 0.36)


def test_anisotropy_in_other_directions_is_reported(tmp_path):
    for angle in (np.pi / 4, np.pi / 2):
        anisotropy = {"anisotropyStrength": 0.6, "anisotropyRotation": angle}
        fields = extended({"roughnessFactor": 0.5}, anisotropy=anisotropy)
        surface = material_of(tmp_path, Gltf(), fields, "anisotropy").surface
        along, across = alphas(surface)
        assert along == pytest.approx(across)
        assert along * across == pytest.approx(0.25 * (0.25 + 0.75 * 0.36))


def test_diffuse_transmission_of_a_shade(tmp_path):
    extension = {"diffuse_transmission": {"diffuseTransmissionFactor": 0.4}}
    surface = material_of(tmp_path, Gltf(), extended(**extension)).surface
    assert (surface.thin, surface.diffuse_transmission) == (True, 0.8)


def test_unlit(tmp_path):
    fields = {"pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1]}}
    fields["extensions"] = {"KHR_materials_unlit": {}}
    assert material_of(tmp_path, Gltf(), fields, "unlit").surface == Diffuse((0.1, 0.2, 0.3))


def glossy(tmp_path, gltf=None, **fields):
    extension = {"extensions": {"KHR_materials_pbrSpecularGlossiness": fields}}
    return material_of(tmp_path, gltf or Gltf(), extension, "specular-glossiness").surface


def test_specular_glossiness(tmp_path):
    plastic = glossy(tmp_path, diffuseFactor=[0.5, 0.2, 0.1, 1], specularFactor=[0.04] * 3,
                     glossinessFactor=0.7)  # fmt: skip
    assert plastic.metallic == pytest.approx(0, abs=1e-6)
    assert plastic.roughness == pytest.approx(0.3)
    np.testing.assert_allclose(plastic.base_color, (0.5, 0.2, 0.1), atol=1e-6)
    gold = glossy(tmp_path, diffuseFactor=[0, 0, 0, 1], specularFactor=[1, 0.77, 0.34])
    assert gold.metallic == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(gold.base_color, (1, 0.77, 0.34), atol=1e-6)


def test_specular_glossiness_textures(tmp_path):
    gltf = Gltf()
    pixels = np.array([[(255, 196, 89, 255), (56, 56, 56, 51)]])
    diffuse = np.array([[(0, 0, 0), (188, 99, 20)]])
    surface = glossy(
        tmp_path,
        gltf,
        diffuseTexture=gltf.texture(diffuse),
        specularGlossinessTexture=gltf.texture(pixels),
    )
    np.testing.assert_allclose(surface.metallic.pixels[0, :, 0], (255, 0), atol=2)
    np.testing.assert_allclose(surface.roughness.pixels[0, :, 0], (0, 204))
    np.testing.assert_allclose(surface.base_color.pixels[0, 0], pixels[0, 0, :3], atol=1)
    np.testing.assert_allclose(surface.base_color.pixels[0, 1], diffuse[0, 1], atol=2)
