"""glTF material extensions, as numbers: every field of the model that they set."""

import numpy as np
import pytest

from lumitree.asset.geometry import Medium
from lumitree.lamp.parts import Diffuse, Glass, MetallicRoughness
from support.gltf_builder import Gltf
from support.gltf_materials import extended, material_of, read_only

WHITE = (1.0, 1.0, 1.0)
CLEAR = {"transmissionFactor": 1}
SMOOTH = {"roughnessFactor": 0}
VOLUME = {
    "thicknessFactor": 0.5,
    "attenuationColor": [0.5, 0.25, 1],
    "attenuationDistance": 2.0,
}
ABSORBING = Medium((np.log(2) / 2, np.log(4) / 2, 0.0))


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        (
            extended(
                SMOOTH | {"baseColorFactor": [1, 0.5, 0.25, 1]},
                transmission=CLEAR,
                ior={"ior": 1.4},
            ),
            Glass(1.4, 0.0, (1.0, 0.5, 0.25), thin=True),
        ),
        (
            extended({"roughnessFactor": 0.3}, transmission=CLEAR),
            MetallicRoughness(WHITE, roughness=0.3, transmission=1.0, thin=True),
        ),
        (
            extended(SMOOTH, transmission={"transmissionFactor": 0.5}),
            MetallicRoughness(WHITE, roughness=0.0, transmission=0.5, thin=True),
        ),
        (
            extended(diffuse_transmission={"diffuseTransmissionFactor": 0.4}),
            MetallicRoughness(WHITE, roughness=1.0, diffuse_transmission=0.8, thin=True),
        ),
    ],
)
def test_surfaces_of_sheets(tmp_path, fields, expected):
    assert material_of(tmp_path, Gltf(), fields).surface == expected


def test_unlit(tmp_path):
    fields = {"pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1]}}
    fields["extensions"] = {"KHR_materials_unlit": {}}
    assert material_of(tmp_path, Gltf(), fields, "unlit").surface == Diffuse((0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("core", "volume", "expected"),
    [
        (
            SMOOTH | {"baseColorFactor": [0.25, 1, 1, 1]},
            VOLUME,
            Glass(tint=(0.5, 1.0, 1.0), medium=ABSORBING),
        ),
        ({"roughnessFactor": 0.4}, {"thicknessFactor": 1}, Glass(1.5, 0.4)),
        # A body without thickness is a thin shell.
        (SMOOTH, VOLUME | {"thicknessFactor": 0}, Glass(thin=True)),
    ],
)
def test_volumes_of_closed_bodies(tmp_path, core, volume, expected):
    gltf = Gltf()
    fields = extended(core, transmission=CLEAR, volume=volume)
    gltf.sphere(gltf.material(**fields), segments=16, scale=[3, 3, 3])
    (material,) = read_only(gltf.save(tmp_path)).materials
    found = material.surface
    if expected.medium is not None:
        assert found.medium.scattering == (0, 0, 0)
        assert found.medium.absorption == pytest.approx(ABSORBING.absorption)
        expected = type(expected)(tint=expected.tint, medium=found.medium)
    assert found == expected


def test_volumes_of_sheets_are_tints(tmp_path):
    fields = extended(SMOOTH, transmission=CLEAR, volume=VOLUME)
    surface = material_of(tmp_path, Gltf(), fields, "attenuation", scale=[3, 3, 3]).surface
    assert (surface.thin, surface.medium) == (True, None)
    np.testing.assert_allclose(surface.tint, np.array([0.5, 0.25, 1]) ** (3 * 0.5 / 2.0))


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


@pytest.mark.parametrize("angle", [0.0, np.pi / 4, np.pi / 2])
def test_anisotropy_is_exact_along_u_and_reported_in_other_directions(tmp_path, angle):
    anisotropy = {"anisotropyStrength": 0.6, "anisotropyRotation": angle}
    fields = extended({"roughnessFactor": 0.5}, anisotropy=anisotropy)
    surface = material_of(tmp_path, Gltf(), fields, "anisotropy" if angle else "").surface
    # Alpha along and across u, by Mitsuba's definition.
    aspect = np.sqrt(1 - 0.9 * surface.anisotropy)
    along, across = surface.roughness**2 / aspect, surface.roughness**2 * aspect
    assert along * across == pytest.approx(0.25 * (0.25 + 0.75 * 0.36))
    assert across == pytest.approx(along if angle else 0.25)


def glossy(tmp_path, gltf, **fields):
    extension = {"extensions": {"KHR_materials_pbrSpecularGlossiness": fields}}
    return material_of(tmp_path, gltf, extension, "specular-glossiness").surface


def test_specular_glossiness(tmp_path):
    plastic = {"diffuseFactor": [0.5, 0.2, 0.1, 1], "specularFactor": [0.04] * 3}
    found = glossy(tmp_path, Gltf(), glossinessFactor=0.7, **plastic)
    assert (found.metallic, found.roughness) == pytest.approx((0, 0.3), abs=1e-6)
    np.testing.assert_allclose(found.base_color, (0.5, 0.2, 0.1), atol=1e-6)
    gold = glossy(tmp_path, Gltf(), diffuseFactor=[0, 0, 0, 1], specularFactor=[1, 0.77, 0.34])
    assert gold.metallic == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(gold.base_color, (1, 0.77, 0.34), atol=1e-6)


def test_specular_glossiness_textures(tmp_path):
    gltf = Gltf()
    pixels = np.array([[(255, 196, 89, 255), (56, 56, 56, 51)]])
    diffuse = np.array([[(0, 0, 0), (188, 99, 20)]])
    textures = {"diffuseTexture": gltf.texture(diffuse)}
    textures["specularGlossinessTexture"] = gltf.texture(pixels)
    surface = glossy(tmp_path, gltf, **textures)
    np.testing.assert_allclose(surface.metallic.pixels[0, :, 0], (255, 0), atol=2)
    np.testing.assert_allclose(surface.roughness.pixels[0, :, 0], (0, 204))
    np.testing.assert_allclose(surface.base_color.pixels[0, 0], pixels[0, 0, :3], atol=1)
    np.testing.assert_allclose(surface.base_color.pixels[0, 1], diffuse[0, 1], atol=2)
