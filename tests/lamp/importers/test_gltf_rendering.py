"""Imported materials as Mitsuba sees them, after Khronos' conformance scenes."""

import numpy as np
import pytest

from lumitree.core.images import linear_from_srgb
from lumitree.core.photometry import luminance
from lumitree.lamp.importers.gltf import read_gltf
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_writer import write_scene
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf, box


def imported(mi, gltf, folder):
    written = write_scene(read_gltf(gltf.save(folder)), folder / "scene")
    return SceneFile(str(written)).instantiate()


def photographed(mi, scene, spp=64, integrator="volpath", background=1.0, origin=(0, 0, 5)):
    """Mean radiance of the square |x|, |y| < 0.5 seen from the front, before a background."""
    sensor = {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f().look_at(list(origin), [0, 0, 0], [0, 1, 0])
        @ mi.ScalarTransform4f().scale([0.5, 0.5, 1]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
    }
    shapes = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes())}
    world = {"type": "scene", "sensor": sensor, **shapes}
    world["integrator"] = {"type": integrator, "max_depth": 100, "rr_depth": 100}
    if background:
        world["light"] = {"type": "constant", "radiance": background}
    return np.array(mi.render(mi.load_dict(world), spp=spp))[..., :3].mean(axis=(0, 1))


def looked_up(mi, scene, x, y):
    """Diffuse reflectance where rays from +z meet the scene at (x, y)."""
    rays = mi.Ray3f(mi.Point3f(x, y, [5.0] * len(x)), mi.Vector3f(0, 0, -1))
    si = scene.ray_intersect(rays)
    return np.array(si.bsdf().eval_diffuse_reflectance(si)).T


def transparent(core=None, **extensions):
    core = {"metallicFactor": 0, "roughnessFactor": 0, **(core or {})}
    extensions = {"transmission": {"transmissionFactor": 1}, **extensions}
    found = {f"KHR_materials_{name}": value for name, value in extensions.items()}
    return {"pbrMetallicRoughness": core, "extensions": found}


# Transmission through a sheet of index 1.5 with all reflections within it.
SHEET = 2 * 1.5 / (1.5**2 + 1)


def test_emissive_textures_keep_their_values(mi, tmp_path):
    gltf = Gltf()
    pixels = np.full((16, 16, 3), (188, 99, 255))
    # Outside of the view, so that the texture is one.
    pixels[0, 0] = 0
    fields = {"emissiveFactor": [1, 1, 1], "emissiveTexture": gltf.texture(pixels)}
    fields["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 10}}
    gltf.quad(gltf.material(**fields))
    seen = photographed(mi, imported(mi, gltf, tmp_path), 4, "path", background=0)
    expected = 10 * linear_from_srgb(np.array([188, 99, 255]) / 255) / 683
    np.testing.assert_allclose(seen, expected, rtol=1e-3)


def test_transmission_of_a_sheet_tints_what_is_behind_it(mi, tmp_path):
    gltf = Gltf()
    gltf.quad(gltf.material(**transparent({"baseColorFactor": [1, 0.5, 0.25, 1]})))
    seen = photographed(mi, imported(mi, gltf, tmp_path), 256)
    # The background is behind and before it: what is not transmitted is reflected.
    expected = SHEET * np.array([1, 0.5, 0.25]) + (1 - SHEET)
    np.testing.assert_allclose(seen, expected, atol=0.01)


def test_attenuation_of_a_slab(mi, tmp_path):
    """After attenuationDistance, light has attenuationColor (AttenuationTest)."""
    colour = np.array([0.8, 0.4, 0.1])
    for thickness in (1.0, 0.5):
        gltf = Gltf()
        volume = {
            "thicknessFactor": 1,
            "attenuationColor": colour.tolist(),
            "attenuationDistance": 1.0,
        }
        vertices, faces = box((-4, -4, -thickness), (4, 4, 0))
        wears = gltf.material(**transparent(volume=volume, ior={"ior": 1.0}))
        gltf.node(gltf.primitive(vertices, faces, material=wears))
        seen = photographed(mi, imported(mi, gltf, tmp_path), 256)
        np.testing.assert_allclose(seen, colour**thickness, atol=0.008)


def test_attenuation_follows_the_size_of_a_body(mi, tmp_path):
    colour = np.array([0.8, 0.4, 1.0])
    volume = {"thicknessFactor": 1, "attenuationColor": colour.tolist(), "attenuationDistance": 1.0}
    gltf = Gltf()
    vertices, faces = box((-4, -4, -0.5), (4, 4, 0))
    wears = gltf.material(**transparent(volume=volume, ior={"ior": 1.0}))
    gltf.node(gltf.primitive(vertices, faces, material=wears), scale=[3, 3, 3])
    seen = photographed(mi, imported(mi, gltf, tmp_path), 256)
    np.testing.assert_allclose(seen, colour**1.5, atol=0.008)


@pytest.mark.parametrize(("inside_out", "roughness"), [(False, 0.2), (True, 0)])
def test_clear_glass_disappears_in_a_furnace(mi, tmp_path, inside_out, roughness):
    gltf = Gltf()
    fields = transparent({"roughnessFactor": roughness}, volume={"thicknessFactor": 1})
    gltf.sphere(gltf.material(**fields), segments=64, inside_out=inside_out)
    seen = photographed(mi, imported(mi, gltf, tmp_path), 256)
    # A rough interface loses what would bounce more than once within its microstructure.
    np.testing.assert_allclose(seen, 1, atol=0.005 if roughness == 0 else 0.05)


def test_textures_lie_the_right_way(mi, tmp_path):
    """The image's first row is at the top of a square with glTF's texture coordinates."""
    gltf = Gltf()
    pixels = np.zeros((2, 2, 3))
    pixels[0, 0], pixels[0, 1], pixels[1, 0] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    info = gltf.texture(pixels, magFilter=9728)
    core = {"baseColorTexture": info, "metallicFactor": 0}
    gltf.quad(gltf.material(pbrMetallicRoughness=core))
    found = looked_up(
        mi, imported(mi, gltf, tmp_path), [-0.5, 0.5, -0.5, 0.5], [0.5, 0.5, -0.5, -0.5]
    )
    colours = found / np.maximum(found.max(axis=1, keepdims=True), 1e-3)
    np.testing.assert_allclose(colours, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], atol=1e-3)


def test_texture_transforms_by_evaluation(mi, tmp_path):
    """T · R · S on the mesh's coordinates, looked up in the image by hand."""
    generator = np.random.default_rng(3)
    pixels = generator.integers(0, 255, (16, 16, 3))
    transform = {"offset": [0.3, -0.2], "rotation": 0.6, "scale": [0.7, 1.4]}
    gltf = Gltf()
    info = gltf.texture(pixels, magFilter=9728)
    info["extensions"] = {"KHR_texture_transform": transform}
    core = {"baseColorTexture": info, "metallicFactor": 0, "roughnessFactor": 1}
    gltf.quad(gltf.material(pbrMetallicRoughness=core))
    x, y = generator.uniform(-1, 1, (2, 200))
    found = looked_up(mi, imported(mi, gltf, tmp_path), x, y)
    u, v = (x + 1) / 2 * 0.7, (1 - y) / 2 * 1.4
    cos, sin = np.cos(0.6), np.sin(0.6)
    u, v = cos * u + sin * v + 0.3, -sin * u + cos * v - 0.2
    code = pixels[(v % 1 * 16).astype(int), (u % 1 * 16).astype(int)] / 255
    expected = linear_from_srgb(code)
    near_edge = (np.minimum(u * 16 % 1, 1 - u * 16 % 1) < 0.02) | (
        np.minimum(v * 16 % 1, 1 - v * 16 % 1) < 0.02
    )
    assert (~near_edge).sum() > 150
    np.testing.assert_allclose(found[~near_edge], expected[~near_edge], atol=2e-3)


@pytest.mark.parametrize(
    ("mirrored", "rotation", "axis"), [(False, 0.0, 0), (True, 0.7, 1), (True, np.pi / 2, 0)]
)
def test_normal_maps_lean_the_right_way(mi, tmp_path, mirrored, rotation, axis):
    """A normal that leans to the right, or up, in the image does so on the surface.

    A direction in the image is carried to the surface by the texture coordinates alone.
    """
    lean = np.array([0.6, 0.0]) if axis == 0 else np.array([0.0, 0.6])
    pixels = np.full((4, 4, 3), np.round((np.array([*lean, 0.8]) / 2 + 0.5) * 255))
    gltf = Gltf()
    info = gltf.texture(pixels)
    info["extensions"] = {"KHR_texture_transform": {"rotation": rotation}}
    uv = (QUAD_UV * (-1, 1) if mirrored else QUAD_UV).astype(np.float32)
    core = {"metallicFactor": 0, "roughnessFactor": 1, "baseColorFactor": [0.5, 0.5, 0.5, 1]}
    wears = gltf.material(pbrMetallicRoughness=core, normalTexture=info)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, material=wears, TEXCOORD_0=uv))
    scene = imported(mi, gltf, tmp_path)

    # Moving by (x, y) on the square moves the mesh's (u, v) by `along`, the image's by `turned`.
    along = np.array([[-0.5 if mirrored else 0.5, 0], [0, -0.5]])
    cos, sin = np.cos(rotation), np.sin(rotation)
    turned = np.array([[cos, sin], [-sin, cos]]) @ along
    direction = np.linalg.solve(turned, lean * (1, -1))
    expected = np.array([*(0.6 * direction / np.linalg.norm(direction)), 0.8])

    si = scene.ray_intersect(mi.Ray3f(mi.Point3f([0.1], [0.2], [5]), mi.Vector3f(0, 0, -1)))
    bsdf, context = si.bsdf(), mi.BSDFContext()

    def lit_from(side):
        wo = si.to_local(mi.Vector3f(*(float(entry) for entry in side)))
        return np.array(bsdf.eval(context, si, wo)).ravel()[0]

    # Light from the leaning side is brighter than from the other, and than from across.
    flat = 0.5 * expected[:2] / np.linalg.norm(expected[:2])
    height = np.sqrt(0.75)
    across = np.array([-flat[1], flat[0]])
    towards = lit_from([*flat, height])
    assert towards > 1.5 * lit_from([*-flat, height])
    assert lit_from([*across, height]) == pytest.approx(lit_from([*-across, height]), rel=0.05)


def unit_radiance():
    """Fields of a material that emits 1 W/(m² sr), 683 cd/m²."""
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 683}}
    return {"emissiveFactor": [1, 1, 1], "extensions": strength}


def test_copies_and_mirrors_stand_where_the_file_puts_them(mi, tmp_path):
    gltf = Gltf()
    lit = gltf.material(**unit_radiance())
    gltf.quad(lit, scale=[0.25, 0.25, 1], translation=[-0.25, 0, 0])
    gltf.node(mesh=0, scale=[-0.25, 0.25, 1], translation=[0.25, 0, 0])
    # Seen from the front both emit, each over a quarter of the view.
    seen = photographed(mi, imported(mi, gltf, tmp_path), 64, background=0)
    np.testing.assert_allclose(seen, 0.5, atol=0.01)
    behind = photographed(mi, imported(mi, gltf, tmp_path), 16, background=0, origin=(0, 0, -5))
    np.testing.assert_allclose(behind, 0, atol=1e-6)


def test_point_lights_have_their_intensity(mi, tmp_path):
    """Illuminance I / r² on a white diffuser, whose luminance is that over π."""
    gltf = Gltf()
    core = {"metallicFactor": 0, "baseColorFactor": [1, 1, 1, 1]}
    wears = gltf.material(pbrMetallicRoughness=core, extensions={"KHR_materials_unlit": {}})
    gltf.quad(wears)
    gltf.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 50}]}
    }
    gltf.node(translation=[0, 0, 10], extensions={"KHR_lights_punctual": {"light": 0}})
    with pytest.warns(match="unlit"):
        scene = imported(mi, gltf, tmp_path)
    seen = photographed(mi, scene, 64, background=0)
    np.testing.assert_allclose(luminance(seen), 50 / 10**2 / np.pi, rtol=0.02)
