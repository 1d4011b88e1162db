"""GLDF and L3D files as lamps, against closed forms and the intensities of their photometries."""

import os
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation
from lumitree.core.octahedral import middle_directions
from lumitree.core.photometry import flux_from_radiance, luminance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats import l3d as l3d_module
from lumitree.formats import light_sources
from lumitree.formats.ies import write_ies
from lumitree.formats.l3d import read_l3d, zxy
from lumitree.formats.ldt import write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.reading import Archive
from lumitree.formats.type_c import Grid, IntensityDistribution
from lumitree.lamp.source import LuminaireSource, gldf_variant, source_kind
from lumitree.rendering.asset_cache import asset_report
from lumitree.rendering.asset_flux import asset_lumens
from support.gldf_files import (
    FACES,
    FILES,
    emitter,
    in_model,
    joint,
    l3d,
    light,
    obj,
    part,
    product,
    structure,
    surface,
    variant,
    zipped,
)

PEAK = 200.0
OLD = "<Header><FormatVersion>0.9</FormatVersion></Header>"


def lobe(power=1.0, tilt=0.0, peak=PEAK):
    """peak · cosⁿ γ downwards, with a part that depends on C."""
    grid = Grid(2.5)
    c, gamma = np.meshgrid(np.deg2rad(grid.c), np.deg2rad(grid.gamma), indexing="ij")
    values = peak * np.maximum(np.cos(gamma), 0) ** power
    values *= 1 + tilt * np.sin(gamma) * np.cos(c - 0.7)
    return IntensityDistribution("lobe", grid.c, grid.gamma, values, Opening((0.3, 0, 0.2)), 700.0)


@pytest.fixture
def quick(monkeypatch):
    """Coarse intensities, whose flux is exact nevertheless."""
    monkeypatch.setattr(light_sources, "_COARSE", 8)
    monkeypatch.setattr(light_sources, "MAX_BINS", 1 << 18)


@pytest.fixture
def made(quick, files):
    """As `files`, for tests that do not depend on how exact intensities are."""
    return files


@pytest.fixture
def files(mi, tmp_path, monkeypatch):
    """Function that writes a GLDF file, by default of the box with a light of `lobe`."""
    monkeypatch.chdir(tmp_path)
    write_ldt("lamp.ldt", lobe())

    def write(xml=None, model=None, name="lamp.gldf", **others):
        files = {"product.xml": product() if xml is None else xml}
        files["ldc/lamp.ldt"] = Path("lamp.ldt").read_bytes()
        files["geo/lamp.l3d"] = l3d() if model is None else model
        Path(name).write_bytes(zipped(files | others))
        return name

    return write


def starts(asset):
    """Mean place [R², 3] in the lamp's file from which each bin's light starts, and its flux."""
    field = asset.light_field
    from lumitree.asset.light_field import unpack
    from lumitree.octree.build import grid_boxes_inside

    flux = field.dense(luminance(unpack(field.intensity))) * field.scale
    lower, upper = grid_boxes_inside(asset.frame.half_extents, field.cells, field.depth)
    middle = (lower + upper) / 2 * asset.frame.scale + asset.frame.centre
    total = flux.sum(axis=0)
    mean = np.divide(flux.T @ middle, total[:, None], out=np.zeros((len(total), 3)),
                     where=total[:, None] > 0)  # fmt: skip
    return mean, total * asset.frame.scale**2


def test_the_light_is_that_of_the_file_and_starts_on_the_object(files):
    write_ldt("lamp.ldt", lobe(3.0, 0.5))
    asset = lumitree.load(files())
    assert asset.parts == ("light", "geometry")
    assert asset_lumens(asset) == pytest.approx(lobe(3.0, 0.5).lumens, rel=5e-3)
    # The box of the model, y up.
    assert asset.frame.size == pytest.approx([0.5, 0.1, 0.25], rel=1e-5)
    assert asset.frame.centre == pytest.approx([0, 0.05, 0], abs=1e-6)
    mean, candela = starts(asset)
    directions = middle_directions(asset.light_field.resolution)
    exact = lobe(3.0, 0.5).at(directions)
    assert candela == pytest.approx(exact, abs=0.02 * PEAK)
    # On average light passes through the middle of the lower face, whatever its direction.
    down = directions[:, 1] < -0.5
    passed = mean[down] - directions[down] * (mean[down, 1] / directions[down, 1])[:, None]
    # In a cell of 16 mm: directions of a coarse bin share their starts.
    assert np.abs(passed).max() < 5e-3


@pytest.mark.parametrize(
    ("units", "metres"),
    [("m", 1), ("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("inch", 0.0254), ("foot", 0.3048)],
)
def test_units(made, units, metres):
    model = l3d(structure(units=units), box_obj=obj(metres))
    asset = lumitree.load(made(model=model))
    assert asset.frame.size == pytest.approx([0.5, 0.1, 0.25], rel=1e-5)
    assert asset.geometry.vertices.max(axis=0) == pytest.approx([0.25, 0.1, 0.125], rel=1e-5)


def read(model):
    return read_l3d(Archive(model, "model", "an L3D model"))


def test_rotations_are_about_z_then_x_then_y():
    """As in example_002 of the L3D repository, whose luminous face looks along -y."""
    found = read(l3d(structure(part(light(turn=(90, 0, 180))))))
    assert -found.objects[0].place[:3, 2] == pytest.approx([0, -1, 0], abs=1e-12)
    # And in example_006, whose face looks along x.
    found = read(l3d(structure(part(light(turn=(0, -90, 0))))))
    assert -found.objects[0].place[:3, 2] == pytest.approx([1, 0, 0], abs=1e-12)
    turn = zxy(20, 30, 40)
    z, x, y = rotation((0, 0, 1), 40), rotation((1, 0, 0), 20), rotation((0, 1, 0), 30)
    assert turn == pytest.approx(z @ x @ y)


def test_joints_move_what_is_joined():
    inner = part(light(at=(0.1, 0, 0)), at=(0, 0, 0.5))
    outer = part(joints=joint(inner, at=(1, 0, 0), turn=(0, 0, 90), default=(90, 0, 0)))
    found = read(l3d(structure(outer)))
    # The inner part is 0.5 along z, which the default rotation about x turns to -y; that about z
    # turns it to x. The object is 0.1 along x, which becomes y.
    assert found.objects[0].place[:3, 3] == pytest.approx([1.5, 0.1, 0])
    assert len(found.parts) == 2


def test_each_object_has_its_photometry_place_and_rotation(files):
    """One light down at the left, one with another photometry up at the right."""
    write_ies("up.ies", lobe(4.0, 0.0, 50.0))
    lights = light("left", at=(-0.2, 0, 0), shape='<Circle diameter="0.02"/>') + light(
        "right", at=(0.2, 0.1, 0.1), turn=(180, 0, 0), shape='<Circle diameter="0.02"/>'
    )
    named = FILES + '<File id="up" contentType="ldc/ies" type="localFileName">up.ies</File>'
    other = '<Photometry id="other"><PhotometryFileReference fileId="up"/></Photometry>'
    xml = product(
        variant(in_model({"left": "e", "right": "f"})),
        emitter() + emitter("f", "other"),
        named,
        other,
    )
    path = files(xml, l3d(structure(part(lights))), **{"ldc/up.ies": Path("up.ies").read_bytes()})
    asset = lumitree.load(path)
    mean, candela = starts(asset)
    directions = middle_directions(asset.light_field.resolution)
    down, up = directions[:, 1] < -0.6, directions[:, 1] > 0.6
    assert candela[down] == pytest.approx(lobe().at(directions[down]), abs=0.02 * PEAK)
    assert candela[up] == pytest.approx(lobe(4.0, 0.0, 50.0).at(-directions[up]), abs=0.02 * PEAK)
    assert asset_lumens(asset) == pytest.approx(lobe().lumens + lobe(4.0, 0, 50.0).lumens, rel=5e-3)
    # In the lamp's file z of L3D is y, and y is -z. Rays pass through the objects.
    for chosen, place in ((down, [-0.2, 0, 0]), (up, [0.2, 0.1, -0.1])):
        offset = mean[chosen] - place
        along = directions[chosen]
        missed = offset - (offset * along).sum(axis=1, keepdims=True) * along
        assert np.linalg.norm(missed, axis=1).max() < 4e-3


def test_luminous_faces_emit_the_flux(made):
    """Luminous faces of the second group; a face of half the weight has half the radiance."""
    text = obj(head="g first", faces=[*FACES[:2], "\ng second", *FACES[2:]])
    text = text.replace("f \ng second\n", "g second\n")
    # The lower face is face 1 of the second group, the next one is its right side.
    group = 'groupIndex="1"'
    lights = surface(faces=(1, 1), group=group) + surface(
        faces=(2, 2), group=group, intensity='intensity="0.5"'
    )
    model = l3d(structure(part(light(), lights)), box_obj=text)
    geometry = lumitree.load(made(model=model)).geometry
    lit = [(shape, mesh) for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True)
           if shape.radiance is not None]  # fmt: skip
    assert len(lit) == 2
    found = {}
    for shape, mesh in lit:
        corners = mesh["vertices"][mesh["faces"]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        axis = tuple(np.round(normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0))).tolist())
        found[axis] = (np.linalg.norm(normals, axis=1).sum(), shape.radiance)
    down, right = found[0, -1, 0], found[1, 0, 0]
    assert down[0] == pytest.approx(0.125, rel=1e-5)
    assert right[0] == pytest.approx(0.025, rel=1e-5)
    assert np.array(right[1]) == pytest.approx(0.5 * np.array(down[1]))
    lumens = sum(flux_from_radiance(radiance, area) for area, radiance in found.values())
    assert lumens == pytest.approx(lobe().lumens, rel=5e-3)


def test_an_object_without_luminous_faces_emits_itself(made):
    circle = light(at=(0, 0, -0.01), shape='<Circle diameter="0.1"/>')
    geometry = lumitree.load(made(model=l3d(structure(part(circle))))).geometry
    lit = [mesh for shape, mesh in zip(geometry.shapes, geometry.meshes(), strict=True)
           if shape.radiance is not None]  # fmt: skip
    assert len(lit) == 1
    # 0.2 % of its diameter in front of it.
    assert lit[0]["vertices"][:, 1] == pytest.approx(-0.0102)
    assert np.ptp(lit[0]["vertices"], axis=0)[[0, 2]] == pytest.approx(0.1, rel=1e-2)
    a, b, c = np.moveaxis(lit[0]["vertices"][lit[0]["faces"]], 1, 0)
    assert (np.cross(b - a, c - a)[:, 1] < 0).all()


def test_variants(made):
    variants = variant(name="a") + variant(name="b", attributes='sortOrder="1"')
    path = made(product(variants))
    with pytest.warns(LumitreeWarning, match="2 variants is read, 'b'.*lamp.gldf#ID.*: a"):
        assert lumitree.load(path).luminaire == "lamp name of b"
    assert lumitree.load(path + "#a").luminaire == "lamp name of a"
    assert lumitree.load(path + "#a") is lumitree.load(path + "#a")
    assert lumitree.bake(path + "#name of a").asset.luminaire == "lamp name of a"
    assert asset_report(lumitree.load(path + "#a"), path + "#a")["file_bytes"] == os.path.getsize(
        path
    )
    with pytest.raises(LumitreeError, match="no variant 'c'; it has b, a"):
        lumitree.load(path + "#c")
    with pytest.raises(LumitreeError, match="does not exist"):
        lumitree.load("none.gldf#a")
    Path(path).rename("x.GLDF#y.gldf")
    assert gldf_variant("x.GLDF#y.gldf") == ("x.GLDF#y.gldf", None)


def test_a_variant_in_a_scene(mi, made):
    """Whose file names it by a path from its own folder."""
    lumitree.register()
    Path("sub").mkdir()
    made(product(variant(name="a") + variant(name="b")), name="sub/lamp.gldf")
    shape = '<shape type="lumitree_proxy"><string name="filename" value="lamp.gldf#b"/></shape>'
    Path("sub/room.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    shapes = lumitree.load("sub/lamp.gldf#b").geometry.shapes
    assert len(mi.load_file("sub/room.xml").shapes()) == 1 + len(shapes)
    Path("room.toml").write_text('[lamps.x]\nasset = "sub/lamp.gldf#b"')
    assert lumitree.read_placements("room.toml")[0].is_baked


def test_sources():
    for name in ("a.gldf", "A.GLDF", "a.gldf#b", "a.gldf#v1.2", LuminaireSource("a.gldf#x/y")):
        assert source_kind(name) == "photometric"
    assert gldf_variant("d#e/a.gldf#v.gldf#2") == ("d#e/a.gldf#v.gldf", "2")


def test_the_product_states_the_flux(made):
    # The photometry is for 700 lm of lamps.
    with pytest.warns(LumitreeWarning, match="states 350 lm where lamp.ldt is for 700 lm"):
        asset = lumitree.load(made(product(emitters=emitter(lumens="350"))))
    assert asset_lumens(asset) == pytest.approx(lobe().lumens / 2, rel=5e-3)
    assert asset_lumens(lumitree.load(made(product(emitters=emitter(lumens="700"))))) == (
        pytest.approx(lobe().lumens, rel=5e-3)
    )


def test_emergency_operation_is_not_read(made):
    only = emitter("f", attributes='emergencyBehaviour="EmergencyOnly"')
    xml = product(variant(in_model({"leo": "e", "other": "f"})), emitter() + only)
    model = l3d(structure(part(light() + light("other"))))
    with pytest.warns(LumitreeWarning, match="emergency operation are not read"):
        assert asset_lumens(lumitree.load(made(xml, model))) == pytest.approx(
            lobe().lumens, rel=5e-3
        )
    xml = product(variant(in_model({"leo": "f"})), only)
    with pytest.raises(LumitreeError, match="no emitter that lights in normal operation"):
        lumitree.load(made(xml, name="b.gldf"))


def test_nothing_is_downloaded(made):
    address = "https://example.org/lamp.ldt"
    files = FILES.replace('localFileName">lamp.ldt', f'url">{address}')
    with pytest.raises(LumitreeError, match=f"names {address}, .*; nothing is downloaded"):
        lumitree.load(made(product(files=files)))
    files = FILES.replace('localFileName">lamp.l3d', 'url">https://example.org/lamp.l3d')
    with pytest.warns(LumitreeWarning, match="on the internet.* is not read"):
        asset = lumitree.load(made(product(files=files), name="b.gldf"))
    assert asset.parts == ("light",)
    assert asset_lumens(asset) == pytest.approx(lobe().lumens, rel=5e-3)


def test_names_that_lead_out_of_a_folder_are_read_and_never_written(made, monkeypatch):
    path = Path(made()).absolute()
    xml = structure(file="../../../out.obj")
    made(model=l3d(xml, **{"../../../out_obj": obj(), "../x_png": b"x", "/x_png": b"x"}))
    written = []
    with monkeypatch.context() as patch:
        patch.setattr(l3d_module, "write_bytes", lambda name, _: written.append(str(name)))
        with pytest.warns(LumitreeWarning, match="without its 3D model"):
            lumitree.load(path)
    assert [name.rpartition("lamp.gldf")[2] for name in written] == [
        "/box-0/lumitree-lights.mtl",
        "/box-0/out.obj",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04", "damaged, or no zip archive"),
        (zipped({}), "product.xml in .* is missing"),
        (zipped({"product.xml": "<Root/>"}), "it has no variants"),
        (zipped({"product.xml": "<Other/>"}), "begins with <Other>"),
        (zipped({"product.xml": product()}), "geo/lamp.l3d.* not in the archive"),
        (zipped({"product.xml": product(variant(""), emitters=" ")}), "no emitter that lights"),
        (zipped({"product.xml": product(variant(""))}), "lamp.ldt, which is not in"),
        (
            zipped({"product.xml": product(head=OLD).replace("FixedLight", "Light")}),
            "no emitter that lights .*; it is of version 0.9, where 1.0 is read",
        ),
        (zipped({"product.xml": product(), "geo/lamp.l3d": l3d("<Luminaire/>")}), "no light em"),
        (zipped({"product.xml": product(), "geo/lamp.l3d": l3d()}), "ldc/lamp.ldt.* not in the"),
        (
            zipped({"product.xml": product(), "geo/lamp.l3d": l3d(), "ldc/lamp.ldt": "no"}),
            "ldc/lamp.ldt in .*gldf is not a usable EULUMDAT file",
        ),
    ],
)  # fmt: skip
def test_refusals(mi, tmp_path, content, message):
    path = tmp_path / "lamp.gldf"
    path.write_bytes(content)
    with pytest.raises(LumitreeError, match=message) as found:
        lumitree.load(path)
    assert "\n" not in str(found.value)


def test_an_object_that_is_missing(made):
    with pytest.raises(LumitreeError, match="no light emitting object 'x'; it has leo"):
        lumitree.load(made(product(variant(in_model({"x": "e"})))))
