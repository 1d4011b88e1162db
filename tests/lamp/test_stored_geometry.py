"""The geometry of an asset: it renders as the luminaire that it was made from, or is refused."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from lumitree.asset.asset import UNIT_FACTORS
from lumitree.asset.file import load, save
from lumitree.asset.geometry import MeshShape
from lumitree.asset.materials import Texture
from lumitree.core.device import on_device
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.errors import LumitreeError
from lumitree.lamp.media import stored_medium
from lumitree.lamp.stored_geometry import stored_geometry
from support.geometry_assets import with_geometry
from support.lamps import AREA, GLASS, cube, lamp_of, sphere

ID = '<transform name="to_world"><rotate y="1" angle="30"/><translate x="2"/></transform>'
TEXTURE = (
    '<texture type="bitmap" name="reflectance"><string name="filename" value="image.png"/>'
    '<string name="wrap_mode" value="clamp"/><string name="filter_type" value="nearest"/></texture>'
)
RAW = (
    '<texture type="bitmap" name="opacity"><string name="filename" value="grey.exr"/>'
    '<boolean name="raw" value="true"/></texture>'
)
WIDE = RAW.replace("grey.exr", "wide.png")
FLIP = '<boolean name="flip_normals" value="true"/>'
SURFACES = {
    "texture": f'<bsdf type="diffuse">{TEXTURE}</bsdf>',
    "mask": f'<bsdf type="mask">{RAW}<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
    "wide": f'<bsdf type="mask">{WIDE}<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>',
    "glass": GLASS,
    "metal": '<bsdf type="roughconductor"><string name="material" value="Au"/>'
    '<float name="alpha" value="0.2"/><rgb name="specular_reflectance" value="1,0.5,0.2"/></bsdf>',
    "eta": '<bsdf type="conductor"><rgb name="eta" value="1.6,0.9,0.5"/>'
    '<rgb name="k" value="9,6,5"/></bsdf>',
    "plastic": '<bsdf type="twosided"><bsdf type="roughplastic"><float name="alpha" value="0.3"/>'
    '<rgb name="diffuse_reflectance" value="0.1,0.2,0.3"/></bsdf></bsdf>',
    "frosted": '<bsdf type="roughdielectric"><string name="int_ior" value="bk7"/>'
    '<float name="alpha" value="0.3"/></bsdf>',
    "principled": '<bsdf type="principled"><rgb name="base_color" value="0.8,0.2,0.1"/>'
    '<float name="metallic" value="0.4"/><float name="roughness" value="0.3"/></bsdf>',
    "metallic roughness": '<bsdf type="lumitree_metallic_roughness"><rgb name="base_color" '
    'value="0.8,0.2,0.1"/><float name="spec_trans" value="0.4"/><float name="clearcoat" '
    'value="0.3"/></bsdf>',
    "blend": '<bsdf type="blendbsdf"><float name="weight" value="0.3"/><bsdf type="diffuse"/>'
    '<bsdf type="principledthin"><float name="diff_trans" value="0.7"/></bsdf></bsdf>',
    "default": "",
    "stretched": '<bsdf type="roughconductor"><float name="alpha_u" value="0.1"/>'
    '<float name="alpha_v" value="0.4"/></bsdf>',
    "bumps": '<bsdf type="bumpmap"><texture type="bitmap" name="any">'
    '<string name="filename" value="grey.exr"/></texture><bsdf type="diffuse"/></bsdf>',
}
SHAPES = {
    "sphere": lambda inside: sphere("other", 0.4, (2, 0.1, 0), inside),
    "inside out": lambda inside: sphere("other", 0.4, (2, 0.1, 0), inside, flip=True),
    "cube": lambda inside: cube("other", (0.4, 0.2, 0.3), (2, 0, 0), inside),
    "disk": lambda inside: f'<shape type="disk" id="other">{ID}{inside}</shape>',
    "cylinder": lambda inside: f'<shape type="cylinder" id="other">{ID}{inside}</shape>',
    "rectangle": lambda inside: f'<shape type="rectangle" id="other">{ID}{inside}</shape>',
}
for name in ("disk", "cylinder", "rectangle"):
    SHAPES[f"{name}, turned"] = lambda inside, made=SHAPES[name]: made(FLIP + inside)


@pytest.fixture
def luminaire(mi, tmp_path):
    """A function: the luminaire of an emissive ball and another shape."""
    random = np.random.default_rng(0)
    mi.Bitmap(random.integers(0, 256, (5, 3, 3), np.uint8)).write(str(tmp_path / "image.png"))
    grey = random.random((4, 4, 1)).astype(np.float32)
    mi.Bitmap(grey).write(str(tmp_path / "grey.exr"))
    wide = random.integers(0, 1 << 16, (4, 4, 1), np.uint16)
    mi.Bitmap(wide).write(str(tmp_path / "wide.png"))

    def made(*shapes):
        return lamp_of(tmp_path, sphere("ball", 0.5, inside=AREA), *shapes)

    return made


def rows(mi, values):
    return [on_device(mi.Float, row) for row in values]


def seen(mi, loaded):
    """Places, normals and scattered light at the hits of rays from all sides."""
    random = np.random.default_rng(1)
    count = 4096
    origin = random.normal(size=(3, count)) * 3 + [[1], [0], [0]]
    direction = np.array([[1.0], [0], [0]]) + random.uniform(-1.2, 1.2, (3, count)) - origin
    direction /= np.linalg.norm(direction, axis=0)
    ray = mi.Ray3f(mi.Point3f(*rows(mi, origin)), mi.Vector3f(*rows(mi, direction)))
    si = loaded.ray_intersect(ray)
    bsdf = si.bsdf()
    out = random.normal(size=(3, count))
    wo = si.to_local(mi.Vector3f(*rows(mi, out / np.linalg.norm(out, axis=0))))
    context = mi.BSDFContext()
    valid = si.is_valid()
    value = bsdf.eval(context, si, wo, valid)
    sample, weight = bsdf.sample(context, si, mi.Float(0.7), mi.Point2f(0.3, 0.6), valid)
    values = (si.t, si.n, si.sh_frame.n, value, weight, sample.wo, sample.eta)
    return [np.nan_to_num(np.array(each, np.float64), posinf=0) for each in values]


def placed_shapes(mi, geometry, scale=1.0):
    """The shapes of geometry in a scene, where it is `scale` times as large."""
    from lumitree.rendering.geometry import Surfaces, geometry_shapes

    device = SimpleNamespace(
        surfaces=Surfaces(geometry),
        straight=SimpleNamespace(densities=itertools.repeat(1.0)),
        traces_straight_light=True,
    )
    lamp = SimpleNamespace(
        asset=SimpleNamespace(geometry=geometry, light_factors=UNIT_FACTORS),
        device=device,
        numbers=[scale],
        gain=mi.Color3f(1),
        traces_straight_light=True,
    )
    return geometry_shapes(np.diag([scale, scale, scale, 1]), lamp)


@pytest.mark.parametrize(
    ("shape", "surface"),
    [*(("cube", name) for name in SURFACES), *((name, "plastic") for name in SHAPES)],
)
def test_it_is_the_luminaire(mi, luminaire, tmp_path, shape, surface):
    lamp = luminaire(SHAPES[shape](SURFACES[surface]))
    save(with_geometry(stored_geometry(lamp), lamp.frame), tmp_path / "lamp.lumitree")
    shapes = placed_shapes(mi, load(tmp_path / "lamp.lumitree").geometry)
    background = {"type": "scene", "light": {"type": "constant"}}
    names = {f"s{index}": each for index, each in enumerate(shapes)}
    again = mi.load_dict(background | names)
    for first, second in zip(seen(mi, lamp.scene), seen(mi, again), strict=True):
        assert np.abs(first - second).max() <= 2e-3 * max(np.abs(first).max(), 1)
        # A few rays pass edges on the other side.
        assert np.mean(np.abs(first - second) > 2e-4 * (1 + np.abs(first))) < 0.01


def test_radiance_is_stored(luminaire):
    texture = TEXTURE.replace("reflectance", "radiance")
    image = AREA.replace('<rgb name="radiance" value="3,2,1"/>', texture)
    geometry = stored_geometry(luminaire(cube("other", 0.2, (2, 0, 0), image)))
    assert {type(shape.radiance) for shape in geometry.shapes} == {tuple, Texture}
    assert geometry.images[0].shape == (5, 3, 3)
    assert geometry.images[0].dtype == np.uint8


def test_meshes_of_one_material_are_joined(luminaire):
    metal, other = SURFACES["metal"], SURFACES["eta"]
    lamp = luminaire(
        cube("a", 0.1, (1, 0, 0), metal),
        cube("b", 0.1, (2, 0, 0), other),
        cube("c", 0.1, (3, 0, 0), metal),
    )
    geometry = stored_geometry(lamp)
    assert [shape.faces for shape in geometry.shapes[:2]] == [24, 12]
    assert [shape.type for shape in geometry.shapes[2:]] == ["sphere"]
    assert geometry.num_triangles == 36


MEDIUM = (
    '<medium type="homogeneous" name="{}"><rgb name="sigma_t" value="0.5,1,0.25"/>'
    '<float name="scale" value="{}"/><float name="albedo" value="{}"/></medium>'
)


END = "</medium>"
FORWARDS = f'<phase type="hg"><float name="g" value="0.6"/></phase>{END}'
RAYLEIGH = f'<phase type="rayleigh"/>{END}'
NARROW = FORWARDS.replace("0.6", "0.9999")


def test_media_that_scatter_are_stored(mi, luminaire, tmp_path):
    """As those that absorb; their phase function does not depend on the size."""
    isotropic = MEDIUM.format("interior", 4, 0.25)
    forwards = isotropic.replace(END, FORWARDS)
    lamp = luminaire(
        cube("a", 0.1, (1, 0, 0), GLASS + isotropic),
        sphere("b", 0.1, (2, 0, 0), GLASS + forwards),
        sphere("c", 0.1, (3, 0, 0), GLASS + forwards, flip=True),
    )
    save(with_geometry(stored_geometry(lamp), lamp.frame), tmp_path / "lamp.lumitree")
    geometry = load(tmp_path / "lamp.lumitree").geometry
    even, narrow, again = (shape.interior for shape in geometry.shapes if shape.interior)
    assert even.absorption == pytest.approx([1.5, 3, 0.75], rel=1e-6)
    assert even.scattering == pytest.approx([0.5, 1, 0.25], rel=1e-6)
    assert (even.anisotropy, narrow.anisotropy) == (0, pytest.approx(0.6))
    assert again == narrow
    shapes = placed_shapes(mi, geometry, 0.5)
    first, *others = (s.interior_medium() for s in shapes if s.interior_medium() is not None)
    assert others[0] is others[1]
    for medium, g in ((first, 0), (others[0], 0.6)):
        stored = stored_medium(medium)
        assert stored.absorption == pytest.approx([3, 6, 1.5], rel=1e-6)
        assert stored.scattering == pytest.approx([1, 2, 0.5], rel=1e-6)
        assert stored.anisotropy == pytest.approx(g)


SCATTERING = GLASS + MEDIUM.format("interior", 1, 0.5)
COLOURED = (
    '<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance">'
    '<string name="name" value="vertex_color"/>{}</texture></bsdf>'
)
# Materials of a cube, and why each is not stored.
REFUSED = {
    SCATTERING.replace(END, RAYLEIGH): "a medium with a RayleighPhaseFunction is not stored; exp",
    SCATTERING.replace(END, NARROW): "a medium has g of 0.9999, which is not stored; expected -0.",
    '<bsdf type="hair"/>': ".*hair",
    '<bsdf type="plastic"><float name="int_ior" value="1.2"/>'
    '<float name="ext_ior" value="1.5"/></bsdf>': "plastic has int_ior 1.2.* and ext_ior 1.5; exp",
    COLOURED.format(
        '<float name="scale" value="0.5"/>'
    ): "a mesh_attribute has a parameter 'scale'",
    COLOURED.format(""): "it has no colours of vertices",
    '<bsdf type="twosided">' * 8 + '<bsdf type="diffuse"/>' + "</bsdf>" * 8: (
        "materials are nested more than 8 deep"
    ),
    '<bsdf type="principled"><float name="main_specular_sampling_rate" value="2"/></bsdf>': (
        ".*principled has a parameter 'main_specular_sampling_rate'"
    ),
    '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf>': (
        ".*checkerboard"
    ),
}


@pytest.mark.parametrize(("material", "reason"), REFUSED.items())
def test_materials_that_cannot_be_stored_are_refused_in_a_line(luminaire, material, reason):
    with pytest.raises(LumitreeError, match=f"shape 'a': {reason}") as caught:
        stored_geometry(luminaire(cube("a", 0.2, (2, 0, 0), material)))
    assert str(caught.value).isprintable()


def test_stretched_instances_of_a_sphere_are_refused(luminaire):
    lamp = luminaire(
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape><shape type="instance">'
        '<ref id="g"/><transform name="to_world"><scale y="2"/></transform></shape>'
    )
    with pytest.raises(LumitreeError, match="a sphere is scaled non-uniformly"):
        stored_geometry(lamp)


@pytest.mark.parametrize("normals", [False, True])
def test_mirrored_instances_keep_their_outside(mi, luminaire, tmp_path, normals):
    """Mitsuba turns the normals of mirrored meshes, but not of mirrored instances."""
    arrays = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    mesh = make_mesh("triangle", arrays | {"normals": [[0, 0, 1]] * 3 if normals else None})
    mesh.write_ply(str(tmp_path / "triangle.ply"))
    file = f'<string name="filename" value="{tmp_path}/triangle.ply"/>{GLASS}'
    lamp = luminaire(
        f'<shape type="shapegroup" id="group"><shape type="ply">{file}</shape></shape>',
        '<shape type="instance"><ref id="group"/><transform name="to_world"><scale x="-1"/>'
        "</transform></shape>",
    )
    found = stored_geometry(lamp)
    (index,) = (i for i, each in enumerate(found.shapes) if isinstance(each, MeshShape))
    mesh = found.meshes()[index]
    a, b, c = mesh["vertices"][mesh["faces"][0]]
    assert np.cross(b - a, c - a) == pytest.approx([0, 0, 1])
    if len(mesh["normals"]):
        assert mesh["normals"] == pytest.approx(np.tile([0, 0, 1], (3, 1)))


def test_instances_are_stored_as_copies(luminaire, monkeypatch):
    """A group has a box and a ball, each with its transform."""
    places = [
        '<scale value="0.5"/><rotate y="1" angle="30"/><translate x="2"/>',
        '<scale value="0.3"/><translate x="-2" y="1"/>',
    ]
    move = '<translate z="0.7"/>'

    def box(more=""):
        place = f'<transform name="to_world"><scale x="2"/>{move}{more}</transform>'
        return f'<shape type="cube">{place}<bsdf type="diffuse"/></shape>'

    def ball(more=""):
        place = f'<transform name="to_world">{more}</transform>'
        return f'<shape type="sphere"><float name="radius" value="0.4"/>{place}{GLASS}</shape>'

    instances = [
        '<shape type="instance"><ref id="group"/>'
        f'<transform name="to_world">{place}</transform></shape>'
        for place in places
    ]
    group = f'<shape type="shapegroup" id="group">{box()}{ball()}</shape>'
    lamp = luminaire(group, *instances)
    found = stored_geometry(lamp)
    copies = [shape(place) for place in places for shape in (box, ball)]
    expected = stored_geometry(luminaire(*copies))
    assert found.shapes == expected.shapes
    for name in ("vertices", "faces"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-6)
    # The luminaire's own file keeps its instances.
    assert [shape.class_name() for shape in lamp.scene.shapes()].count("Instance") == 2
    monkeypatch.setattr("lumitree.lamp.stored_geometry._MAX_PRIMITIVES", 10)
    with pytest.raises(LumitreeError, match="its instances have 27 triangles, expected at most 10"):
        stored_geometry(lamp)
