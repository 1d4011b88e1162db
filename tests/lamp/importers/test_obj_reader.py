"""OBJ models as a whole: parts, materials, textures, and files that reach out of their folder."""

import dataclasses

import numpy as np
import pytest
import trimesh
from PIL import Image

from lumitree.asset.materials import (
    Dielectric,
    Diffuse,
    MetallicRoughness,
    Texture,
    ThinDielectric,
    VertexColours,
    places_on_image,
)
from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers.obj import read_obj
from lumitree.lamp.importers.topology import count_solids
from lumitree.lamp.materials import metal

QUAD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def obj_text(mesh, material, offset=0, flip=False):
    lines = [f"usemtl {material}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    faces = mesh.faces[:, ::-1] if flip else mesh.faces
    lines += ["f " + " ".join(str(i + 1 + offset) for i in face) for face in faces]
    return "\n".join(lines) + "\n"


@pytest.fixture
def model(tmp_path):
    """Function of the OBJ's and the MTL's text."""

    def read(obj, mtl=None):
        if mtl is not None:
            (tmp_path / "lamp.mtl").write_text(mtl)
            obj = "mtllib lamp.mtl\n" + obj
        (tmp_path / "lamp.obj").write_text(obj)
        return read_obj(tmp_path / "lamp.obj")

    return read


@pytest.fixture
def quad(model):
    """Function of the lines of a quad's MTL block: its material."""

    def read(lines):
        return model(QUAD + "usemtl a\nf 1/1 2/2 3/3 4/4", "newmtl a\n" + lines).materials[0]

    return read


@pytest.fixture
def textured(model):
    """Function of the lines of a quad's MTL block: its material, and the pixels of a texture."""

    def read(lines):
        found = model(QUAD + "usemtl a\nf 1/1 2/2 3/3 4/4", "newmtl a\n" + lines)
        return found.materials[0], lambda texture: found.images[texture.image]

    return read


@pytest.fixture
def ball(model):
    def read(lines):
        text = obj_text(trimesh.creation.icosphere(subdivisions=1), "a")
        return model(text, "newmtl a\n" + lines).materials[0]

    return read


def image(path, pixels):
    Image.fromarray(np.asarray(pixels, np.uint8)).save(path)


def test_one_part_for_each_material_however_it_is_spread(model):
    box = trimesh.creation.box()
    text = "g first\n" + obj_text(box, "brass") + "g second\n"
    text += obj_text(trimesh.creation.box().apply_translation([3, 0, 0]), "Mat.001", 8)
    text += obj_text(trimesh.creation.box().apply_translation([6, 0, 0]), "brass", 16)
    lamp = model(text, "newmtl brass\nKd 1 0 0\nnewmtl Mat.001\nKd 0 1 0\n")
    assert [(part.name, part.material) for part in lamp.parts] == [
        ("brass", "brass"), ("Mat_001", "Mat.001"),
    ]  # fmt: skip
    assert [len(part.mesh.faces) for part in lamp.parts] == [24, 12]
    assert count_solids(lamp.parts[0].mesh) == (2, 2)


def test_part_names_are_fit_for_files_and_distinct(model):
    text = QUAD + "".join(
        f"usemtl {name}\nf 1 2 3\n" for name in ("a/b", "a b", "../../x", "A_B", "ä", ".")
    )
    with pytest.warns(LumitreeWarning, match="no MTL file describes"):
        lamp = model(text)
    names = [part.name for part in lamp.parts]
    assert names == ["a_b", "a_b-2", "x", "A_B-3", "default", "default-2"]
    assert [material.name for material in lamp.materials][2] == "../../x"


def test_repeated_faces_go_and_pieces_face_outwards(model):
    ball = trimesh.creation.icosphere(subdivisions=2)
    text = "s 1\n" + obj_text(ball, "a", flip=True) + obj_text(ball, "a", len(ball.vertices))
    with pytest.warns(LumitreeWarning, match=r"lamp.obj: 320 faces repeat others of the same mat"):
        mesh = model(text, "newmtl a\nKd 1 1 1").parts[0].mesh
    assert len(mesh.faces) == len(ball.faces)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume > 4
    np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=0.02)


def test_normals_are_smooth_where_the_file_asks_for_it(model):
    """In a file without smoothing groups they are the faces' normals, as the format says."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    text = obj_text(ball, "a")
    mesh = model(text, "newmtl a").parts[0].mesh
    np.testing.assert_allclose(mesh.normals[mesh.faces[:, 0]], ball.face_normals, atol=1e-6)
    np.testing.assert_allclose(mesh.normals[mesh.faces[:, 1]], ball.face_normals, atol=1e-6)
    smooth = model("s on\n" + text, "newmtl a").parts[0].mesh
    np.testing.assert_allclose(smooth.normals, smooth.vertices, atol=0.02)
    # Faces of one plane share their vertices.
    plane = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3\nf 1 3 4"
    assert len(model(plane, "newmtl a").parts[0].mesh.vertices) == 4


@pytest.mark.filterwarnings("ignore:.* faces repeat others")
def test_a_face_in_both_windings_emits_to_both_sides_if_it_will_emit(model, tmp_path):
    """As where a file of overrides makes it emit."""
    model(QUAD + "usemtl a\nf 1 2 3 4\nf 4 3 2 1", "newmtl a\nKd 1 1 1")
    parts = [read_obj(tmp_path / "lamp.obj", names).parts[0] for names in ([], ["a"])]
    assert [len(part.mesh.faces) for part in parts] == [2, 4]


PAINTED = "v -1 -1 0 1 0 0\nv 1 -1 0 1 0 0\nv 1 1 0 0 0 1\nv -1 1 0 0 0 1\nvt 0 0\n"


def test_vertex_colours_times_kd(model, tmp_path):
    text = PAINTED + "usemtl a\nf 1/1 2/1 3/1 4/1"
    lamp = model(text, "newmtl a\nKd 0.5 0.5 0.25\nKe 1 2 3")
    assert lamp.materials[0].surface == Diffuse(reflectance=VertexColours())
    assert lamp.materials[0].radiance == (1, 2, 3)
    mesh = lamp.parts[0].mesh
    np.testing.assert_allclose(mesh.colours[mesh.vertices[:, 1] < 0], [[0.5, 0, 0]] * 2)
    np.testing.assert_allclose(mesh.colours[mesh.vertices[:, 1] > 0], [[0, 0, 0.25]] * 2)
    # Without Kd the colours are the vertices' own.
    assert model(text, "newmtl a").parts[0].mesh.colours.max() == 1
    glossy = model(text, "newmtl a\nKs 0.5 0.5 0.5").materials[0].surface
    assert glossy.base_color == VertexColours()
    with pytest.warns(LumitreeWarning, match="or to have the colours of its vertices"):
        assert model(text).materials[0].surface == Diffuse(reflectance=VertexColours())


def test_vertex_colours_that_are_not_used(model, tmp_path):
    image(tmp_path / "a.png", np.zeros((2, 2, 3)))
    text = PAINTED + "usemtl a\nf 1/1 2/1 3/1 4/1"
    for lines in ("map_Kd a.png", "illum 4", "illum 3\nKd 0 0 0\nKs 1 1 1"):
        with pytest.warns(LumitreeWarning, match="not used: vertex colours"):
            assert model(text, "newmtl a\n" + lines).parts[0].mesh.colours is None
    white = PAINTED.replace("1 0 0\n", "1 1 1\n").replace("0 0 1\n", "1 1 1\n")
    assert model(white + "usemtl a\nf 1 2 3", "newmtl a").parts[0].mesh.colours is None


def test_given_normals_are_kept_and_turned_with_their_faces(model):
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in ball.vertices)
    normals = "".join(f"vn {2 * x} {2 * y} {2 * z}\n" for x, y, z in ball.vertices)
    inwards = "".join(f"vn {-x} {-y} {-z}\n" for x, y, z in ball.vertices)

    def faces(order):
        rows = (ball.faces + 1)[:, ::order]
        return "".join("f " + " ".join(f"{i}//{i}" for i in row) + "\n" for row in rows)

    for text in (normals + faces(1), normals + faces(-1), inwards + faces(-1)):
        mesh = model("usemtl a\n" + vertices + text, "newmtl a").parts[0].mesh
        assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume > 3
        np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=1e-6)


def test_open_sheets_are_wound_as_their_normals_point(model):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 -1\nusemtl a\nf 1//1 2//1 3//1"
    mesh = model(text, "newmtl a").parts[0].mesh
    a, b, c = mesh.vertices[mesh.faces[0]]
    assert np.cross(b - a, c - a)[2] < 0
    np.testing.assert_array_equal(mesh.normals, [[0, 0, -1]] * 3)


def test_model_without_materials_is_grey(model):
    lamp = model(QUAD + "f 1 2 3 4")
    assert lamp.materials[0].surface == Diffuse(reflectance=(0.5, 0.5, 0.5))
    with pytest.warns(LumitreeWarning, match=r"'lamp.mtl', which is not there"):
        assert model("mtllib lamp.mtl\n" + QUAD + "f 1 2 3").materials[0].radiance is None


def test_faces_without_area_leave_no_part(model):
    with pytest.warns(LumitreeWarning, match="no face has any area"):
        assert model(QUAD + "usemtl a\nf 1 1 2", "newmtl a").parts == ()


@pytest.mark.parametrize("lines", ["illum 4", "illum 6", "illum 7", "illum 9", "d 0.5\nNi 1.45"])
def test_glass_is_thin_where_it_is_open_and_solid_where_it_is_closed(quad, ball, lines):
    thin, solid = quad(lines + "\nTf 0.25 1 1"), ball(lines + "\nTf 0.25 1 1")
    assert isinstance(thin.surface, ThinDielectric)
    assert isinstance(solid.surface, Dielectric)
    assert thin.opacity == solid.opacity == 1
    assert thin.surface.int_ior == (1.45 if "Ni" in lines else 1.5)
    # Light crosses a sheet once and a solid's surface twice.
    assert thin.surface.specular_transmittance == (0.25, 1, 1)
    assert solid.surface.specular_transmittance == (0.5, 1, 1)
    assert thin.bsdf == thin.surface


def test_partly_closed_glass_is_reported(model):
    ball = trimesh.creation.icosphere(subdivisions=1)
    text = obj_text(ball, "a") + "v 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    with pytest.warns(LumitreeWarning, match="'a': 1 of 2 pieces are closed"):
        surface = model(text, "newmtl a\nillum 7").materials[0].surface
    assert isinstance(surface, ThinDielectric)


def test_other_surfaces(quad):
    assert quad("Kd 0.2 0.3 0.4").surface == Diffuse(reflectance=(0.2, 0.3, 0.4))
    assert quad("Kd 0.2 0.3 0.4\nKs 1 1 1\nillum 1").surface == Diffuse(reflectance=(0.2, 0.3, 0.4))
    mirror = quad("Kd 0 0 0\nKs 0.9 0.8 0.7\nNs 198\nillum 3").surface
    assert mirror == dataclasses.replace(
        metal((0.9, 0.8, 0.7), 0.3), roughness=pytest.approx(0.01**0.25)
    )
    glossy = quad("Kd 0.2 0.3 0.4\nKs 0.5 0.5 0.5\nNs 198\nNi 1.33").surface
    assert glossy == MetallicRoughness(
        base_color=(0.2, 0.3, 0.4), roughness=pytest.approx(0.01**0.25), eta=1.33
    )
    physical = quad("Kd 1 0 0\nPr 0.3\nPm 1\nPs 0.1\nPc 0.5\nPcr 0.2\naniso 0.4").surface
    assert physical == MetallicRoughness(
        base_color=(1, 0, 0), metallic=1, roughness=0.3, anisotropic=0.4, sheen=0.1,
        clearcoat=0.5, clearcoat_roughness=0.2,
    )  # fmt: skip


def test_opacity_and_emission(quad):
    assert quad("d 0.25").opacity == 0.25
    assert quad("Tr 0.25").opacity == 0.75
    assert quad("d 0.5\nTr 0.9").opacity == 0.5
    assert quad("Ke 40 30 16").radiance == (40, 30, 16)
    assert quad("Ke 0 0 0").radiance is None
    assert quad("Ke 0 -1 0").radiance is None
    assert quad("Kd 1 1 1").two_sided


def test_textures(textured, tmp_path):
    pixels = np.zeros((4, 2, 4), np.uint8)
    pixels[:2] = [255, 0, 0, 255]
    pixels[2:] = [0, 128, 0, 51]
    image(tmp_path / "a.png", pixels)
    lines = "map_Kd -s 2 3 -o 0.25 0.5 -clamp on a.png\nmap_d a.png\nmap_Ke a.png\nKe 7 7 7"
    found, image_of = textured(lines)
    base = found.surface.reflectance
    assert not base.raw
    assert base.wrap_mode == "clamp"
    np.testing.assert_array_equal(image_of(base), pixels[..., :3])
    # v = 0.25 from the bottom is 3 * 0.25 + 0.5 = 1.25 in the file's image, -0.25 from its top.
    place = places_on_image(base.to_uv, np.array([[0.5, 0.75]]))
    np.testing.assert_allclose(place, [[1.25, -0.25]])
    np.testing.assert_array_equal(image_of(found.opacity), pixels[..., 3:])
    assert found.opacity.raw
    np.testing.assert_allclose(image_of(found.radiance)[0, 0], [7, 0, 0])
    assert image_of(found.radiance)[3, 0, 1] == pytest.approx(7 * 0.2158605, rel=1e-4)


@pytest.mark.parametrize("signs", [(1,), (-1,), (1, -1)], ids=str)
def test_normal_maps_are_turned_round_on_mirrored_coordinates(model, tmp_path, signs):
    """Mitsuba's second axis is the normal times the first one, whatever the coordinates are."""
    image(tmp_path / "n.png", np.full((2, 2, 3), np.round((np.array([0, 0.6, 0.8]) + 1) * 127.5)))
    text = "usemtl a\n"
    for index, sign in enumerate(signs):
        corners = [(index, 0), (index + 1, 0), (index + 1, 1), (index, 1)]
        text += "".join(f"v {x} {y} 0\nvt {sign * (x - index)} {y}\n" for x, y in corners)
        first = 4 * index + 1
        text += "f " + " ".join(f"{i}/{i}" for i in range(first, first + 4)) + "\n"
    found = model(text, "newmtl a\nnorm n.png\n")
    assert [part.name for part in found.parts] == (["a", "a-2"] if len(signs) == 2 else ["a"])
    material = {each.name: each for each in found.materials}
    assert {each.title for each in found.materials} == {"a"}
    for part, sign in zip(found.parts, signs, strict=True):
        assert len(part.mesh.faces) == 2
        assert (material[part.material].name == "a") == (sign > 0)
        green = found.images[material[part.material].normal_map.image][..., 1]
        assert (green == (204 if sign > 0 else 51)).all()


def test_normal_maps_and_height_maps(quad, textured, tmp_path):
    tilted = np.array([0.6, 0.0, 0.8])
    image(tmp_path / "n.png", np.full((4, 4, 3), np.round((tilted + 1) * 127.5)))
    image(tmp_path / "grey.png", np.full((4, 4, 3), 90))
    assert isinstance(quad("norm n.png").normal_map, Texture)
    scaled, image_of = textured("map_Bump -bm 0.5 n.png")
    halved = image_of(scaled.normal_map)[0, 0] / 127.5 - 1
    assert halved[0] / halved[2] == pytest.approx(0.375, abs=0.02)
    with pytest.warns(LumitreeWarning, match=r"'a': not used: bump \(a height map"):
        assert quad("map_Bump grey.png").normal_map is None


def test_what_is_left_out_is_reported_in_one_warning(quad, tmp_path):
    image(tmp_path / "a.png", np.zeros((2, 2, 3)))
    with pytest.warns(LumitreeWarning) as caught:
        quad("map_Kd -mm 0.5 2 -imfchan r a.png\nmap_Ns a.png\ndecal a.png")
    assert [str(item.message) for item in caught] == [
        "material 'a': not used: map_Ns, decal, map_Kd -mm, map_Kd -imfchan r"
    ]


def test_v_of_the_mesh_counts_from_the_first_row(model):
    mesh = model(QUAD + "usemtl a\nf 1/1 2/2 3/3 4/4", "newmtl a").parts[0].mesh
    by_place = {tuple(place): tuple(uv) for place, uv in zip(mesh.vertices, mesh.uv, strict=True)}
    assert by_place[(-1, -1, 0)] == (0, 1)
    assert by_place[(1, 1, 0)] == (1, 0)


@pytest.mark.parametrize("where", ["mtllib", "map_Kd", "map_Bump"])
def test_files_outside_the_folder_are_ignored_unless_they_are_beside_the_model(
    model, tmp_path, where
):
    (tmp_path.parent / "outside.mtl").write_text("newmtl a\nKd 1 0 0\n")
    obj, mtl = QUAD + "usemtl a\nf 1 2 3", f"newmtl a\n{where} ../outside.mtl"
    if where == "mtllib":
        obj, mtl = "mtllib ../outside.mtl\n" + obj, None
    with pytest.warns(LumitreeWarning, match="is not there|no MTL file"):
        assert model(obj, mtl).materials[0].surface == Diffuse(reflectance=(0.5, 0.5, 0.5))
    if where == "mtllib":
        (tmp_path / "outside.mtl").write_text("newmtl a\nKd 1 0 0\n")
        with pytest.warns(LumitreeWarning, match="'outside.mtl' in the model's folder") as caught:
            assert model(obj).materials[0].surface == Diffuse(reflectance=(1, 0, 0))
        assert len(caught) == 1
    quoted = model('mtllib "lamp.mtl"\n' + QUAD + "usemtl a\nf 1 2 3", "newmtl a\nKd 1 0 0")
    assert quoted.materials[0].surface == Diffuse(reflectance=(1, 0, 0))
