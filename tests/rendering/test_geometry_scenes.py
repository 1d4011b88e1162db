"""How the geometry of an asset comes into an asset, and from there into scenes."""

import dataclasses
import json

import numpy as np
import pytest

import lumitree
from lumitree.asset.file import save
from lumitree.cli import main
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.stored_geometry import stored_geometry
from support import tiny_bakes
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.lamps import AREA, GLASS, cube, scene, sphere
from support.tiny_bakes import standard

FEW = {"estimate": {"rays": 1 << 17, "growth_rays": 1 << 16}, "rays": 1 << 14}
LAMP = scene(sphere("ball", 0.5, inside=AREA), cube("bar", (1, 0.1, 0.1)))
MEDIUM = (
    '<medium type="homogeneous" name="interior"><float name="albedo" value="0.5"/>'
    '<phase type="rayleigh"/></medium>'
)
HAZE = scene(sphere("ball", 0.2, inside=AREA), cube("bar", (0.5, 0.5, 0.5), inside=GLASS + MEDIUM))
ROOM = """<scene version="3.0.0"><integrator type="{integrator}"/>
<sensor type="perspective"><transform name="to_world">
<lookat origin="0,0,6" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
</sensor><shape type="rectangle"><transform name="to_world"><translate z="-3"/></transform></shape>
{lamp}</scene>"""
GEOMETRY = '<shape type="lumitree_proxy"><string name="filename" value="lamp.lumitree"/>{}</shape>'


@pytest.fixture(autouse=True)
def folder(mi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tiny_bakes.set_qualities(monkeypatch.setattr, tree_depth=4, **FEW)
    (tmp_path / "lamp.xml").write_text(LAMP)
    (tmp_path / "haze.xml").write_text(HAZE)
    return tmp_path


def test_a_scene_file_names_a_lamp_with_geometry_beside_a_textured_emitter(mi, tmp_path):
    """Its emitters are complete when they are created, unlike those with textures of the file."""
    lumitree.save(with_geometry(small_geometry()), tmp_path / "lamp.lumitree")
    mi.Bitmap(np.ones((2, 2, 3), np.float32)).write(str(tmp_path / "white.exr"))
    path = tmp_path / "room.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="lumitree_path"/><sensor type="perspective">'
        '<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>'
        '</film></sensor><shape type="lumitree_proxy"><string name="filename" '
        'value="lamp.lumitree"/></shape><shape type="rectangle"><emitter type="area">'
        '<texture type="bitmap" name="radiance"><string name="filename" value="white.exr"/>'
        "</texture></emitter></shape></scene>"
    )
    image = lumitree.render(path, spp=4, progress=None)
    assert np.isfinite(image.pixels).all()
    assert image.pixels.max() > 0


def bar(frame=None):
    """An asset with the geometry of the lamp and some light."""
    lamp = load_luminaire("lamp.xml")
    return with_geometry(stored_geometry(lamp), lamp.frame)


@pytest.mark.slow
def test_parts_of_a_bake(capsys):
    baked = lumitree.bake("lamp.xml", "lamp.lumitree", standard(parts=["light", "geometry"]))
    assert baked.asset.parts == ("light", "geometry")
    assert baked.asset.geometry.num_triangles == 12
    assert main(["info", "lamp.lumitree"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "light, geometry" in shown
    assert main(["bake", "lamp.xml", "-o", "all.lumitree", "--parts", "light,field,geometry"]) == 0
    every = lumitree.load("all.lumitree")
    assert every.parts == ("light", "field", "geometry")
    assert lumitree.bake("lamp.xml").asset.info.appearance == "geometry"
    refined = lumitree.refine(every, "lamp.xml", rays=1 << 14)
    assert refined.asset.geometry is every.geometry


def test_images_show_the_geometry_by_default():
    baked = lumitree.bake("lamp.xml", config=standard(parts=None, irradiance_paths=0))
    assert baked.asset.parts == ("light", "geometry")


@pytest.mark.slow
def test_a_luminaire_that_cannot_be_stored_gets_a_field():
    with pytest.warns(LumitreeWarning, match=r"no geometry: .*RayleighPhaseFunction is not"):
        baked = lumitree.bake("haze.xml", config=standard(parts=None, irradiance_paths=0))
    assert baked.asset.parts == ("light", "field")
    with pytest.raises(LumitreeError, match=r"part geometry cannot be made: .*Rayleigh"):
        lumitree.bake("haze.xml", config=standard(parts=["light", "geometry"]))


def test_geometry_alone_is_refused_before_any_work():
    with pytest.raises(LumitreeError, match="parts are geometry; expected light, field or both"):
        lumitree.bake("lamp.xml", config=standard(parts=["geometry"]))


def test_one_dictionary_and_one_element_expand_into_all_shapes(mi):
    asset = bar()
    # By default what the asset shows.
    for options, count in (({}, 3), ({"appearance": "geometry"}, 3), ({"appearance": "field"}, 1)):
        described = lumitree.shape(asset, **options)
        loaded = mi.load_dict({"type": "scene", "lamp": described})
        assert len(loaded.shapes()) == count
    save(asset, "lamp.lumitree")
    appearance = '<string name="appearance" value="field"/>'
    for lamp, count in ((GEOMETRY.format(""), 3), (GEOMETRY.format(appearance), 1)):
        loaded = mi.load_string(f'<scene version="3.0.0"><path value="."/>{lamp}</scene>')
        assert len(loaded.shapes()) == count
    with pytest.raises(LumitreeError, match="appearance is 'x'; expected field, geometry"):
        lumitree.shape(asset, appearance="x")


def test_an_asset_without_geometry_shows_its_field(mi):
    for options in ({}, {"appearance": "geometry"}):
        described = lumitree.shape(random_asset(0), **options)
        assert len(mi.load_dict({"type": "scene", "lamp": described}).shapes()) == 1


def test_every_kind_of_shape_and_material_can_be_placed(mi):
    asset = with_geometry(small_geometry(), LocalFrame(np.ones(3), np.eye(4)))
    loaded = mi.load_dict({"type": "scene", "lamp": lumitree.shape(asset, appearance="geometry")})
    sensor = {"type": "perspective", "to_world": mi.ScalarTransform4f().translate([0, 0, -4])}
    sensor["film"] = {"type": "hdrfilm", "width": 16, "height": 16}
    integrator = mi.load_dict({"type": "lumitree_path"})
    image = np.array(mi.render(loaded, sensor=mi.load_dict(sensor), integrator=integrator, spp=16))
    assert np.isfinite(image).all()
    assert image.max() > 0


@pytest.mark.parametrize(
    ("integrator", "shows"), [("path", True), ("lumitree_path", True), ("volpath", False)]
)
def test_render_shows_the_geometry_where_the_integrator_can(monkeypatch, integrator, shows):
    from lumitree.rendering import scene as scenes

    placed = []
    place = scenes.place_luminaires

    def watched(*args, **options):
        placed.append(place(*args, **options))
        return placed[0]

    monkeypatch.setattr(scenes, "place_luminaires", watched)
    save(bar(), "lamp.lumitree")
    with open("room.xml", "w") as file:
        file.write(ROOM.format(integrator=integrator, lamp=""))
    call = ["render", "room.xml", "-o", "image.exr", "--spp", "4", "--place", "lamp.lumitree"]
    assert main([*call, "--json", "report.json"]) == 0
    assert len(placed[0].shapes()) == (4 if shows else 2)
    with open("report.json") as file:
        assert json.load(file)["mean_radiance"] > 0


def test_a_camera_inside_a_lamp_is_no_fault(mi, recwarn):
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    film = {"type": "hdrfilm", "width": 4, "height": 4}
    room = mi.load_dict({"type": "scene", "sensor": {"type": "perspective", "film": film}})
    for appearance in ("geometry", "field"):
        place_luminaires(room, [PlacedLuminaire(Placement(bar()))], appearance=appearance)
    assert not [each for each in recwarn if issubclass(each.category, LumitreeWarning)]


def test_parts_are_plain_data():
    assert dataclasses.asdict(bar().info)["parts"] == ("light", "geometry")
