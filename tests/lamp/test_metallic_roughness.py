"""Surfaces of models: no light is lost or created, and the BSDF is what glTF specifies."""

import functools
import itertools

import numpy as np
import pytest

import lumitree
from lumitree.asset.materials import MetallicRoughness
from lumitree.core.device import on_device
from lumitree.lamp.meshes import lathe
from lumitree.lamp.scene_file import register_metallic_roughness
from lumitree.rendering.geometry import Materials
from support.gltf_builder import Gltf

COSINES = (0.1, 0.35, 0.7, 1.0)
COLOUR = (1.0, 0.6, 0.1)
# Samples for each angle.
COUNT = 1 << 15
# Reflectance at normal incidence of appendix B of the glTF specification.
F0 = 0.04
SURFACES = {
    "plastic": {"roughness": 0.4},
    "coated": {"roughness": 0.5, "clearcoat": 1.0, "clearcoat_roughness": 0.3, "sheen": 0.5},
    "metal": {"metallic": 1.0, "roughness": 0.6, "anisotropic": 0.5},
    "mixed": {"metallic": 0.4, "roughness": 0.7, "specular": 0.5},
    "sheet": {"thin": True, "spec_trans": 0.5, "diff_trans": 0.8, "roughness": 0.5},
    "frosted": {"spec_trans": 1.0, "roughness": 0.6, "eta": 1.4},
    "cloudy": {"spec_trans": 0.5, "metallic": 0.2, "roughness": 0.5},
}


@pytest.fixture(scope="module")
def made(mi):
    """A function: the BSDF of some parameters."""
    register_metallic_roughness()
    materials = Materials(())

    def bsdf(base_color=COLOUR, **parameters):
        return materials.bsdf(MetallicRoughness(base_color=base_color, **parameters))

    return bsdf


def seen_at(mi, cosines, **fields):
    """Points of a surface that are seen at these angles to the normal, in several directions."""
    import drjit as dr

    cosines = np.asarray(cosines, np.float64)
    azimuth, sine = np.arange(len(cosines)), np.sqrt(1 - cosines**2)
    wi = [sine * np.cos(azimuth), sine * np.sin(azimuth), cosines]
    si = dr.zeros(mi.SurfaceInteraction3f, len(cosines))
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.wi = mi.Vector3f(*(on_device(mi.Float, each) for each in wi))
    return si


def albedo(mi, bsdf, cosines, count=COUNT, importance=True):
    """Reflected and transmitted part [C, 3] of light from each angle, and errors of the sum."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count * len(cosines))
    mode = mi.TransportMode.Importance if importance else mi.TransportMode.Radiance
    si = seen_at(mi, np.repeat(cosines, count))
    bs, weight = bsdf.sample(mi.BSDFContext(mode), si, sampler.next_1d(), sampler.next_2d())
    weight = np.array(weight, np.float64).reshape(3, len(cosines), count)
    same = (np.array(bs.wo.z) * np.array(si.wi.z) > 0).reshape(len(cosines), count)
    parts = [np.where(mask, weight, 0) for mask in (same, ~same)]
    error = weight.std(axis=2) / count**0.5
    return *(part.mean(axis=2).T for part in parts), error.T


@functools.cache
def single_scattering(roughness, cosine, f0):
    """Albedo of `specular_brdf` with Schlick's factor: integral over the normals of microfacets."""
    alpha = roughness**2
    # Normals distributed as D times the cosine; the tangent is alpha times √(u / (1 - u)).
    u, azimuth = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(120) + 0.5) * np.pi / 120)
    normal = 1 / np.sqrt(1 + alpha**2 * u / (1 - u))
    facing = cosine * normal + np.sqrt((1 - cosine**2) * (1 - normal**2)) * np.cos(azimuth)
    out = 2 * facing * normal - cosine

    def unmasked(mu):
        return 2 * mu / (mu + np.sqrt(alpha**2 + (1 - alpha**2) * mu**2))

    visible = (facing > 0) & (out > 0)
    weight = unmasked(cosine) * unmasked(np.maximum(out, 1e-9)) * facing / (cosine * normal)
    grazing = (1 - np.clip(facing, 0, 1)) ** 5
    return float(np.where(visible, weight * (f0 + (1 - f0) * grazing), 0).mean())


def expected(base, metallic, roughness, transmission, cosine):
    """Reflected and transmitted part by appendix B, coupled as Kulla and Conty (2017) do it."""
    points, weights = np.polynomial.legendre.leggauss(16)
    angles = (points + 1) / 2
    found = [single_scattering(roughness, angle, 1.0) for angle in angles]
    mean = (np.array(found) * angles * weights).sum()
    white, layer = (single_scattering(roughness, cosine, f0) for f0 in (1.0, F0))
    average = base + (1 - base) / 21
    rebound = average**2 * mean / (1 - average * (1 - mean)) * (1 - white)
    metal = single_scattering(roughness, cosine, base) + rebound
    opaque = layer + base * (1 - layer)
    stays = F0 + (1 - F0) / 21
    mirrored = layer + stays * (1 - white)
    crossed = base * (white - layer + (1 - stays) * (1 - white))
    dielectric = (1 - transmission) * opaque + transmission * mirrored
    part = (1 - metallic) * transmission
    return metallic * metal + (1 - metallic) * dielectric, part * crossed


@pytest.mark.parametrize("roughness", [0.15, 1.0])
def test_the_albedo_is_that_of_the_specification(mi, made, roughness):
    for metallic, transmission in itertools.product((0.0, 0.5, 1.0), (0.0, 0.5, 1.0)):
        surface = {"metallic": metallic, "spec_trans": transmission, "thin": True}
        found = albedo(mi, made(roughness=roughness, **surface), COSINES)
        reflected, transmitted, error = found
        assert (reflected + transmitted <= 1.002 + 4 * error).all()
        for index, cosine in enumerate(COSINES):
            for channel, base in enumerate(COLOUR):
                right = expected(base, metallic, roughness, transmission, cosine)
                place = index, channel
                values = reflected[place], transmitted[place]
                # A sample is reflected or transmitted, so the parts vary more than their sum.
                slack = 4 * (error[place] + 0.5 / COUNT**0.5 * (transmission > 0)) + 0.002
                assert values == pytest.approx(right, rel=0.01, abs=slack), (surface, cosine, base)


@pytest.mark.parametrize("roughness", [0.0, 0.6])
@pytest.mark.parametrize(
    "surface",
    [
        {},
        {"metallic": 1.0},
        {"metallic": 0.5, "specular": 0.3},
        {"thin": True, "diff_trans": 0.7, "spec_trans": 0.4},
        {"spec_trans": 1.0},
        {"spec_trans": 1.0, "eta": 1.2},
    ],
    ids=str,
)
def test_a_white_surface_loses_nothing_and_gains_nothing(mi, made, surface, roughness):
    cosines = (*COSINES, *(-each for each in COSINES if surface.get("spec_trans")))
    parts = albedo(mi, made((1, 1, 1), roughness=roughness, **surface), cosines)
    reflected, transmitted, error = parts
    off = np.abs(reflected + transmitted - 1)
    assert (off <= 0.003 + 4 * error).all(), off.max()


@pytest.mark.parametrize("name", SURFACES)
def test_it_is_reciprocal(mi, made, name):
    """Light paths, which have the mode for importance, find what camera paths find."""
    bsdf, random = made(**SURFACES[name]), np.random.default_rng(0)
    first, second = random.uniform(-1, 1, (2, 4000))
    here, there = seen_at(mi, first), seen_at(mi, second)
    there.wi = mi.Frame3f(mi.Vector3f(0, 0, 1)).to_local(there.wi)
    camera = bsdf.eval(mi.BSDFContext(), here, there.wi)
    light = bsdf.eval(mi.BSDFContext(mi.TransportMode.Importance), there, here.wi)
    found = np.array(camera) / np.abs(second), np.array(light) / np.abs(first)
    assert found[0] == pytest.approx(found[1], rel=2e-3, abs=1e-5)
    assert (found[0] > 0).any()


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("cosine", [0.8, -0.5])
def test_directions_are_sampled_with_their_density(mi, made, name, cosine):
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    surface = SURFACES[name]
    if cosine < 0 and "spec_trans" not in surface:
        pytest.skip("an opaque surface has no back")
    bsdf, context = made(**surface), mi.BSDFContext()
    sine = (1 - cosine**2) ** 0.5

    def point(count):
        import drjit as dr

        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
        si.wi = mi.Vector3f(sine, 0, cosine)
        return si

    def sample(samples):
        import drjit as dr

        si = point(dr.width(samples))
        bs, _ = bsdf.sample(context, si, samples.z, mi.Point2f(samples.x, samples.y))
        return bs.wo, dr.select(bs.pdf > 0, mi.Float(1), 0)

    def density(direction):
        import drjit as dr

        return bsdf.pdf(context, point(dr.width(direction)), direction)

    test = ChiSquareTest(SphericalDomain(), sample, density, 3, 1 << 19, res=61, ires=8)
    assert test.run(significance_level=0.0025), test.messages


@pytest.mark.parametrize("name", SURFACES)
def test_values_are_the_weights_times_the_density(mi, made, name):
    bsdf, context = made(**SURFACES[name]), mi.BSDFContext()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(2, 4096)
    si = seen_at(mi, np.linspace(-0.99, 0.99, 4096))
    bs, weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d())
    valid = np.array(bs.pdf) > 0
    value, pdf = (np.array(each) for each in bsdf.eval_pdf(context, si, bs.wo))
    # Rounding of the direction matters on smooth surfaces.
    assert np.array(bs.pdf)[valid] == pytest.approx(pdf[valid], rel=5e-3)
    assert (np.array(weight) * pdf)[:, valid] == pytest.approx(value[:, valid], rel=5e-3, abs=1e-6)
    assert np.isfinite(np.array(weight)).all()
    assert (np.array(weight) >= 0).all()


def test_all_light_leaves_a_white_cavity(tmp_path):
    """With nothing that absorbs, all light of a ball in a white sphere leaves by its hole."""
    gltf, core = Gltf(), {"metallicFactor": 0, "roughnessFactor": 0.5}
    angles = np.radians(np.linspace(0, 130, 40))
    # From the top of the hole down: the normals point to the axis.
    shell = lathe(np.stack([np.sin(angles), -np.cos(angles)], axis=1)[::-1], 48)
    white = gltf.material(pbrMetallicRoughness=core, doubleSided=True)
    primitive = gltf.primitive(
        shell.vertices,
        shell.faces.astype(np.uint32),
        material=white,
        NORMAL=shell.normals.astype(np.float32),
    )
    gltf.node(primitive)
    emissive = {"pbrMetallicRoughness": core, "emissiveFactor": [1, 1, 1]}
    gltf.sphere(gltf.material(**emissive), radius=0.3)
    found = lumitree.photometry(gltf.save(tmp_path), paths=1 << 17, progress=None)
    ratio = found.light_output_ratio
    assert ratio.value == pytest.approx(1, abs=0.003 + 4 * ratio.error)
