"""Geometry of an asset in the page, which draws its surfaces without noise."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.geometry import AssetGeometry, Medium, UnitShape
from lumitree.asset.materials import (
    Conductor,
    Dielectric,
    Diffuse,
    Material,
    MetallicRoughness,
    Principled,
    RoughConductor,
    RoughDielectric,
    ThinDielectric,
    TwoSided,
)
from lumitree.core.frames import LocalFrame, rows_of
from support.geometry_assets import (
    IDENTITY,
    NOTHING,
    TEXTURE,
    small_geometry,
    with_geometry,
)

pytestmark = pytest.mark.usefixtures("mi")


LINEAR = dataclasses.replace(TEXTURE, image=0, raw=True)


def surface(material, radiance=None, scale=1.0, **media):
    from lumitree.viewer.surfaces import page_surface

    shape = UnitShape(type="sphere", to_world=IDENTITY, material=0, radiance=radiance, **media)
    image = np.ones((2, 2, 1), np.float32)
    members = {**NOTHING, "images": (image,)}
    geometry = AssetGeometry(**members, shapes=(shape,), materials=(material,))
    return page_surface(geometry, shape, scale)


@pytest.mark.parametrize(
    ("material", "kind"),
    [
        (Dielectric(int_ior=1.5, ext_ior=1.0), "GLASS"),
        (RoughDielectric(int_ior=1.5, ext_ior=1.0, alpha=0.2), "GLASS"),
        (ThinDielectric(int_ior=1.5, ext_ior=1.0), "THIN_GLASS"),
        (Conductor(material="Cu"), "METAL"),
        (RoughConductor(material="Cu"), "METAL"),
        (RoughConductor(material="Cu", alpha_u=0.1, alpha_v=0.3), "BAKED"),
        (RoughConductor(material="Cu", alpha=LINEAR), "BAKED"),
        (Diffuse(reflectance=0.5), "BAKED"),
        (Principled(metallic=1.0), "BAKED"),
        (MetallicRoughness(metallic=1.0), "METAL"),
        (MetallicRoughness(spec_trans=1.0, eta=1.4), "GLASS"),
        (MetallicRoughness(metallic=0.5), "BAKED"),
        (MetallicRoughness(metallic=1.0, roughness=LINEAR), "BAKED"),
    ],
)
def test_rays_are_followed_through_glass_and_from_metals(material, kind):
    found = surface(material)
    assert found.kind.name == kind
    assert len(found.numbers()) == 20
    assert found.has_back == (kind in ("GLASS", "THIN_GLASS"))
    # Emitters end rays, and so does glass around a medium that scatters.
    emitting = surface(material, radiance=(1.0, 2, 3))
    assert (emitting.kind.name, emitting.emits, found.emits) == ("BAKED", True, False)
    opal = Medium((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert surface(material, interior=opal).kind.name == "BAKED"


def test_numbers_are_those_of_the_material():
    metal = surface(
        TwoSided(
            nested=(
                RoughConductor(alpha=0.3, material="none", specular_reflectance=(0.2, 0.4, 0.6)),
            )
        )
    )
    assert (metal.has_back, metal.alpha) == (True, pytest.approx(0.3))
    np.testing.assert_allclose(metal.reflected, [0.2, 0.4, 0.6], rtol=1e-6)
    rough = MetallicRoughness(base_color=0.25, roughness=0.6)
    frosted = surface(dataclasses.replace(rough, spec_trans=1.0, eta=1.4))
    assert (frosted.index, frosted.alpha, frosted.ggx) == (1.4, pytest.approx(0.36), True)
    assert frosted.transmitted == (0.5, 0.5, 0.5)
    assert surface(dataclasses.replace(rough, metallic=1.0)).reflected == (0.25, 0.25, 0.25)
    glass = surface(
        Dielectric(int_ior=1.5, ext_ior=1.2, specular_transmittance=0.9),
        scale=2.0, interior=Medium((0.1, 0.2, 0.3)),
    )  # fmt: skip
    assert glass.index == pytest.approx(1.25)
    assert glass.transmitted == pytest.approx((0.9, 0.9, 0.9))
    assert glass.between_media
    # Per local unit, of which each has two units of the file.
    np.testing.assert_allclose(glass.inside, [0.2, 0.4, 0.6])
    np.testing.assert_allclose(glass.outside, 0)
    assert not surface(Dielectric()).between_media


@pytest.mark.slow
def test_codes_are_those_of_the_triangles():
    from lumitree.exports.surfaces import geometry_meshes, meshed
    from lumitree.viewer.model import page_model

    geometry = small_geometry()
    asset = with_geometry(geometry, LocalFrame(np.ones(3), np.eye(4)))
    model = page_model(asset)
    triangles, surfaces = model.arrays["triangles"], model.arrays["surfaces"]
    rows = np.reshape(model.description["surfaces"], (-1, 20))
    count, normal_count, a_stop, zero, place_count = model.description["codes"]
    positions = 2 * model.arrays["positions"] / (count - 1) - 1
    assert model.description["triangles"] == len(triangles) == len(surfaces)
    # Divided triangles have the area of the meshes, on the plane of each.
    corners = positions[triangles]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    meshes = geometry_meshes(meshed(geometry), np.eye(4))
    # Each shape of this geometry has a surface of its own.
    for shape, mesh in enumerate(meshes):
        whole = mesh["vertices"][mesh["faces"]].astype(np.float64)
        expected = np.linalg.norm(
            np.cross(whole[:, 1] - whole[:, 0], whole[:, 2] - whole[:, 0]), axis=1
        ).sum()
        assert area[surfaces == shape].sum() == pytest.approx(expected, rel=1e-3)
    ends = rows[surfaces, 0] == 0
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert sides[ends].max() < 1 / 16 + 1e-3
    light = model.arrays["light"].astype(np.float64).reshape(-1, 2, 3)
    light[..., ::2] += light[..., 1:2]
    radiance = np.where(light > 0, 2 ** ((light - zero) / a_stop), 0)
    radiance *= model.description["max_radiance"]
    assert radiance.max() == pytest.approx(model.description["max_radiance"])
    # The second mesh emits, and its metal reflects the sphere, too.
    assert np.array_equal(rows[:, 1].astype(int) & 8 != 0, [False, True, True])
    emitting = np.unique(triangles[surfaces == 1])
    assert (radiance[emitting, 0] > np.array([3, 2, 1]) * 0.95).all()
    assert not radiance[emitting, 1].any()
    assert normal_count > 255
    # The first mesh has an image, of its colour, and the coordinates of its corners on it.
    assert np.array_equal(rows[:, 7], [1, 0, 0])
    places = model.arrays["places"][: len(meshes[0]["vertices"])] / place_count
    np.testing.assert_allclose(places, meshes[0]["texcoords"], atol=1 / place_count)
    assert not model.arrays["places"][emitting].any()


def test_a_pattern_is_the_image_relative_to_its_largest_value():
    import base64
    import io

    from PIL import Image

    from lumitree.asset.materials import places_on_image
    from lumitree.viewer.surfaces import SIDE, Patterns

    geometry = small_geometry()
    shape = geometry.shapes[0]
    patterns = Patterns(geometry)
    assert patterns.of(geometry.shapes[1]) is None
    found = patterns.of(shape)
    assert found is not None
    assert (found[0], found[1].image) == (0, 1)
    assert patterns.of(shape) == found
    # An emitter with an image has the image as its pattern, a uniform emitter has no pattern.
    found = patterns.of(dataclasses.replace(shape, radiance=LINEAR))
    assert found is not None
    assert found[0] == 1
    assert patterns.of(dataclasses.replace(shape, radiance=(1.0, 1, 1))) is None
    image = geometry.images[1].astype(np.float64)
    shown = Image.open(io.BytesIO(base64.b64decode(patterns.encoded()[0])))
    assert shown.size == (SIDE, SIDE)
    # In the middles of pixels, which cubic interpolation of sRGB leaves as they are.
    rows, columns = image.shape[:2]
    v, u = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
    places = np.stack([u / columns, v / rows], axis=-1).reshape(-1, 2)
    from lumitree.core.images import linear_from_srgb

    expected = linear_from_srgb(image / 255).reshape(-1, 3)
    expected /= expected.max()
    found = patterns.values(0, places + np.array([1, -2]))
    np.testing.assert_allclose(found, np.maximum(expected, 0.02), atol=0.03)
    for wrap, shifted in (("mirror", places * [1, -1] + 2), ("clamp", places)):
        found = patterns.values(0, shifted, wrap)
        np.testing.assert_allclose(found, np.maximum(expected, 0.02), atol=0.03)
    edge = patterns.values(0, np.array([[1.2, 0.3], [-3, 0.3]]), "clamp")
    np.testing.assert_array_equal(edge, patterns.values(0, np.array([[0.9999, 0.3], [0, 0.3]])))
    turned = places_on_image(rows_of([[0, 2, 0, 0.5], [1, 0, 0, 0], *IDENTITY[2:]]), places)
    np.testing.assert_allclose(turned, np.stack([2 * places[:, 1] + 0.5, places[:, 0]], axis=1))


PLASTIC = {
    "type": "roughplastic", "alpha": 0.05, "distribution": "ggx", "int_ior": 1.5, "ext_ior": 1.0,
    "nonlinear": True, "diffuse_reflectance": [0.029, 0.029, 0.029],
}  # fmt: skip
HEIGHT, SIDE, RADIUS, RADIANCE = 0.9, 0.3, 0.03, 100.0


def plate_below_a_bulb():
    """A plate of black plastic at y = -0.5, 0.9 below an emissive sphere."""
    bulb = np.diag([RADIUS, RADIUS, RADIUS, 1.0])
    bulb[1, 3] = HEIGHT - 0.5
    plate = np.array([[SIDE, 0, 0, 0], [0, 0, 1, -0.5], [0, -SIDE, 0, 0], [0, 0, 0, 1]])
    shapes = (
        UnitShape(type="sphere", to_world=rows_of(bulb), material=1, radiance=RADIANCE),
        UnitShape(type="rectangle", to_world=rows_of(plate), material=0),
    )
    materials = (Material.of_table(PLASTIC, "plastic"), Diffuse(reflectance=0.0))
    geometry = small_geometry(shapes=shapes, materials=materials, **NOTHING)
    return with_geometry(geometry, LocalFrame(np.ones(3), np.eye(4)))


def sent_out(model):
    """Radiance [V] of the green channel of fronts."""
    codes = model.arrays["light"].astype(np.float64)[:, 1]
    a_stop, zero = model.description["codes"][2:4]
    return (
        np.where(codes > 0, 2 ** ((codes - zero) / a_stop), 0) * model.description["max_radiance"]
    )


def albedo(mi, cosine):
    """Part of the light from a direction that the plastic reflects: mean of its samples."""
    import drjit as dr

    count = 1 << 18
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0, float(cosine))
    bsdf = mi.load_dict({**PLASTIC, "diffuse_reflectance": {"type": "rgb", "value": 0.029}})
    return float(
        dr.mean(bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())[1].y)[0]
    )


@pytest.mark.slow
def test_black_plastic_is_smooth(mi):
    from lumitree.viewer.model import page_model

    model = page_model(plate_below_a_bulb())
    positions = 2 * model.arrays["positions"] / (model.description["codes"][0] - 1) - 1
    triangles, light = model.arrays["triangles"], sent_out(model)
    corners = positions[triangles]
    plate = triangles[np.abs(corners[..., 1] + 0.5).max(axis=1) < 1e-3]
    sides = np.concatenate([plate[:, :2], plate[:, 1:], plate[:, [2, 0]]])
    differences = np.abs(np.diff(light[sides], axis=1)[:, 0]) / light[sides].mean(axis=1)
    vertices = np.unique(plate)
    # Irradiance of a sphere above the horizon: pi L (r / d)² cos θ.
    distance = np.linalg.norm(positions[vertices] - [0, HEIGHT - 0.5, 0], axis=1)
    cosine = HEIGHT / distance
    table = np.linspace(0.8, 1, 9)
    reflected = np.interp(cosine, table, [albedo(mi, each) for each in table])
    expected = reflected * RADIANCE * (RADIUS / distance) ** 2 * cosine
    # The irradiance itself differs by up to 2 % from vertex to vertex.
    assert differences.mean() < 0.03
    assert differences.max() < 0.15
    assert light[vertices].mean() == pytest.approx(expected.mean(), rel=0.03)


def test_light_stays_on_connected_vertices(mi):
    """Noise of a few vertices spreads, a step between parts that are not connected stays."""
    from lumitree.viewer.triangles import smoothed

    count = 20
    place = np.linspace(-0.5, 0.5, count + 1)
    vertices = np.stack(np.meshgrid(place, [0.0], place), axis=-1).reshape(-1, 3)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = np.stack([corner, corner + 1, corner + count + 2], axis=1)
    faces = np.concatenate(
        [faces, np.stack([corner, corner + count + 2, corner + count + 1], axis=1)]
    )
    above = np.array([0, 0.01, 0])
    both = np.concatenate([vertices, vertices + above])
    faces = np.concatenate([faces, faces + len(vertices)])
    random = np.random.default_rng(0)
    paths = np.full(len(both), 8.0)
    level = np.repeat([1.0, 5.0], len(vertices))
    spread = 4.0
    values = level[:, None] * random.gamma(8 / spread, spread / 8, (len(both), 3))
    variance = (spread * level**2).astype(np.float32)
    found = smoothed(values.astype(np.float32), variance, paths, both, faces)
    for part in (slice(0, len(vertices)), slice(len(vertices), None)):
        error = found[part] / level[part, None] - 1
        noise = values[part] / level[part, None] - 1
        assert np.sqrt((error**2).mean()) < 0.4 * np.sqrt((noise**2).mean())
        weight = np.bincount(faces.ravel(), np.ones(faces.size), len(both))[part]
        kept = np.average(found[part], axis=0, weights=weight)
        np.testing.assert_allclose(
            kept, np.average(values[part], axis=0, weights=weight), rtol=0.01
        )
    # Exact values are left as they are.
    exact = np.tile(np.sin(9 * both[:, :1]) + 2, (1, 3)).astype(np.float32)
    same = smoothed(exact, np.zeros(len(both), np.float32), paths, both, faces)
    np.testing.assert_allclose(same, exact, rtol=1e-4)


def test_triangles_are_divided_as_trimesh_divides_them():
    from trimesh.remesh import subdivide

    from lumitree.viewer.triangles import quartered

    rng = np.random.default_rng(0)
    vertices, faces = (
        rng.normal(size=(30, 3)),
        np.array([rng.permutation(30)[:3] for _ in "x" * 40]),
    )
    middles, quarters = quartered(faces, len(vertices))
    found = np.concatenate([vertices, vertices[middles].mean(axis=1)])
    expected, triangles = subdivide(vertices, faces)[:2]
    assert found.shape == expected.shape
    np.testing.assert_allclose(found[quarters], expected[triangles])
