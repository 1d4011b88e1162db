"""glTF material extensions, as numbers: every field of the model that they set."""

import numpy as np
import pytest

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Diffuse, MetallicRoughness, ThinDielectric
from lumitree.lamp.materials import glass
from support.gltf_builder import Gltf
from support.gltf_materials import extended, images_of, material_of, read_only

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
            glass(1.4, 0.0, (1.0, 0.5, 0.25), thin=True),
        ),
        (
            extended({"roughnessFactor": 0.3}, transmission=CLEAR),
            MetallicRoughness(base_color=WHITE, roughness=0.3, spec_trans=1.0, thin=True),
        ),
        (
            extended(SMOOTH, transmission={"transmissionFactor": 0.5}),
            MetallicRoughness(base_color=WHITE, roughness=0.0, spec_trans=0.5, thin=True),
        ),
        (
            extended(diffuse_transmission={"diffuseTransmissionFactor": 0.4}),
            MetallicRoughness(base_color=WHITE, roughness=1.0, diff_trans=0.8, thin=True),
        ),
    ],
)
def test_surfaces_of_sheets(tmp_path, fields, expected):
    assert material_of(tmp_path, Gltf(), fields).surface == expected


def test_unlit(tmp_path):
    fields = {"pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1]}}
    fields["extensions"] = {"KHR_materials_unlit": {}}
    surface = material_of(tmp_path, Gltf(), fields, "unlit").surface
    assert surface == Diffuse(reflectance=(0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("core", "volume", "expected", "medium"),
    [
        (
            SMOOTH | {"baseColorFactor": [0.25, 1, 1, 1]},
            VOLUME,
            glass(tint=(0.5, 1.0, 1.0)),
            ABSORBING,
        ),
        ({"roughnessFactor": 0.4}, {"thicknessFactor": 1}, glass(1.5, 0.4), None),
        # A body without thickness is a thin shell.
        (SMOOTH, VOLUME | {"thicknessFactor": 0}, glass(thin=True), None),
    ],
)
def test_volumes_of_closed_bodies(tmp_path, core, volume, expected, medium):
    gltf = Gltf()
    fields = extended(core, transmission=CLEAR, volume=volume)
    gltf.sphere(gltf.material(**fields), segments=16, scale=[3, 3, 3])
    (material,) = read_only(gltf.save(tmp_path)).materials
    assert material.surface == expected
    assert (material.medium is None) == (medium is None)
    if medium is not None:
        assert material.medium.scattering == (0, 0, 0)
        assert material.medium.absorption == pytest.approx(medium.absorption)


def test_volumes_of_sheets_are_tints(tmp_path):
    fields = extended(SMOOTH, transmission=CLEAR, volume=VOLUME)
    material = material_of(tmp_path, Gltf(), fields, "attenuation", scale=[3, 3, 3])
    assert (type(material.surface), material.medium) == (ThinDielectric, None)
    tint = material.surface.specular_transmittance
    np.testing.assert_allclose(tint, np.array([0.5, 0.25, 1]) ** (3 * 0.5 / 2.0))


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
    found = surface.specular * reflectance(surface.eta)
    assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4, np.pi / 2])
def test_anisotropy_is_exact_along_u_and_reported_in_other_directions(tmp_path, angle):
    anisotropy = {"anisotropyStrength": 0.6, "anisotropyRotation": angle}
    fields = extended({"roughnessFactor": 0.5}, anisotropy=anisotropy)
    surface = material_of(tmp_path, Gltf(), fields, "anisotropy" if angle else "").surface
    # Alpha along and across u, by Mitsuba's definition.
    aspect = np.sqrt(1 - 0.9 * surface.anisotropic)
    along, across = surface.roughness**2 / aspect, surface.roughness**2 * aspect
    assert along * across == pytest.approx(0.25 * (0.25 + 0.75 * 0.36))
    assert across == pytest.approx(along if angle else 0.25)


def glossy(tmp_path, gltf, **fields):
    extension = {"extensions": {"KHR_materials_pbrSpecularGlossiness": fields}}
    material, pixels = images_of(tmp_path, gltf, extension, "specular-glossiness")
    return material.surface, pixels


def test_specular_glossiness(tmp_path):
    plastic = {"diffuseFactor": [0.5, 0.2, 0.1, 1], "specularFactor": [0.04] * 3}
    found, _ = glossy(tmp_path, Gltf(), glossinessFactor=0.7, **plastic)
    assert (found.metallic, found.roughness) == pytest.approx((0, 0.3), abs=1e-6)
    np.testing.assert_allclose(found.base_color, (0.5, 0.2, 0.1), atol=1e-6)
    gold, _ = glossy(tmp_path, Gltf(), diffuseFactor=[0, 0, 0, 1], specularFactor=[1, 0.77, 0.34])
    assert gold.metallic == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(gold.base_color, (1, 0.77, 0.34), atol=1e-6)


def test_specular_glossiness_textures(tmp_path):
    gltf = Gltf()
    pixels = np.array([[(255, 196, 89, 255), (56, 56, 56, 51)]])
    diffuse = np.array([[(0, 0, 0), (188, 99, 20)]])
    textures = {"diffuseTexture": gltf.texture(diffuse)}
    textures["specularGlossinessTexture"] = gltf.texture(pixels)
    surface, image = glossy(tmp_path, gltf, **textures)
    np.testing.assert_allclose(image(surface.metallic)[0, :, 0], (255, 0), atol=2)
    np.testing.assert_allclose(image(surface.roughness)[0, :, 0], (0, 204))
    np.testing.assert_allclose(image(surface.base_color)[0, 0], pixels[0, 0, :3], atol=1)
    np.testing.assert_allclose(image(surface.base_color)[0, 1], diffuse[0, 1], atol=2)
