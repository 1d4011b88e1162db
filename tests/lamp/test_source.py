"""Every kind of file behind one argument: formats, overrides, selection, fingerprints, light."""

import numpy as np
import pytest
import trimesh

from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.read_source import read_model
from lumitree.lamp.source import LuminaireSource
from support.lamps import AREA, lamp_of, sphere

BALL = trimesh.creation.icosphere(subdivisions=3, radius=5)
STEM = trimesh.creation.box((1, 1, 20)).apply_translation([0, 0, 15])
BULB = '[material."bulb"]\nemitter = { radiance = [6, 4, 2] }\ndiffuse = { reflectance = 0 }\n'


def obj_text(**meshes):
    lines, offset = [], 1
    for name, mesh in meshes.items():
        lines.append(f"usemtl {name}")
        lines += [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in mesh.vertices]
        lines += ["f " + " ".join(str(i + offset) for i in face) for face in mesh.faces]
        offset += len(mesh.vertices)
    return "\n".join(lines) + "\n"


@pytest.fixture
def lamp(mi, tmp_path):
    """An OBJ lamp, a ball on a stem in centimetres, z up, without light of its own."""
    (tmp_path / "lamp.mtl").write_text("newmtl bulb\nKd 1 1 1\nnewmtl stem\nKd 0.5 0.2 0.1\n")
    path = tmp_path / "lamp.obj"
    path.write_text("mtllib lamp.mtl\n" + obj_text(bulb=BALL, stem=STEM))
    return path


def capture(source, folder, **settings):
    from lumitree.trace.cameras import capture as capture_views

    settings = {"views": 2, "resolution": 24, "spp": 16, **settings}
    return list(capture_views(load_luminaire(source), folder, **settings).views())


def test_lumens_come_out_of_a_captured_lamp(mi, tmp_path):
    """Flux is the integral over all directions of radiance times projected area.

    A black cube around nothing is convex, so that every emitted ray gets away. The views are
    Halton directions; for a box the projected area varies little between them.
    """
    ball = trimesh.creation.icosphere(subdivisions=1, radius=3)
    (tmp_path / "lamp.obj").write_text("mtllib lamp.mtl\n" + obj_text(bulb=ball))
    (tmp_path / "lamp.mtl").write_text("newmtl bulb\nKd 0 0 0\n")
    text = (
        'units = "cm"\nup = "z"\n[material.bulb]\nemitter = { lumens = 800, temperature = 2700 }\n'
    )
    (tmp_path / "lamp.toml").write_text(text)
    luminaire = load_luminaire(tmp_path / "lamp.obj")
    views = capture(tmp_path / "lamp.obj", tmp_path / "d", views=24, resolution=64)
    scale = luminaire.frame.world_from_local[0, 0]
    area = (2 * luminaire.bounding_radius * scale) ** 2
    luminance = [683 * view.radiance @ [0.2126, 0.7152, 0.0722] for view in views]
    assert 4 * np.pi * np.mean(luminance) * area == pytest.approx(800, rel=0.01)
    red, _, blue = np.sum([view.radiance.sum(axis=(0, 1)) for view in views], axis=0)
    assert red > 5 * blue


def test_named_overrides_take_the_place_of_those_beside_the_model(lamp, tmp_path):
    lamp.with_suffix(".toml").write_text("nonsense")
    with pytest.raises(LumitreeError, match=r"lamp\.toml is not valid TOML"):
        load_luminaire(lamp)
    (tmp_path / "warm.toml").write_text(BULB)
    source = LuminaireSource(str(lamp), materials=str(tmp_path / "warm.toml"))
    assert read_model(source).materials[0].radiance == (6, 4, 2)
    with pytest.raises(LumitreeError, match=r"cold\.toml does not exist"):
        load_luminaire(LuminaireSource(str(lamp), materials=str(tmp_path / "cold.toml")))


def test_fingerprint_covers_model_materials_and_overrides(lamp):
    def fingerprint(**options):
        return load_luminaire(LuminaireSource(str(lamp), **options)).fingerprint

    lamp.with_suffix(".toml").write_text(BULB)
    prints = [fingerprint()]
    assert fingerprint() == prints[0]
    lamp.with_suffix(".toml").write_text(BULB.replace("6,", "7,"))
    prints.append(fingerprint())
    lamp.with_suffix(".mtl").write_text("newmtl bulb\nnewmtl stem\nKd 0.1 0.1 0.1\n")
    prints.append(fingerprint())
    lamp.write_text("mtllib lamp.mtl\n" + obj_text(bulb=BALL, stem=BALL))
    prints.append(fingerprint())
    prints.append(fingerprint(drop=("stem",)))
    assert len(set(prints)) == len(prints)


@pytest.mark.parametrize("patterns", ["body", [0], [None]])
def test_patterns_are_a_list_of_texts(patterns):
    with pytest.raises(LumitreeError, match=r"drop is .*; expected a list of texts"):
        LuminaireSource("star", drop=patterns)
    with pytest.raises(LumitreeError, match=r"keep is .*; expected a list of texts"):
        load_luminaire("star", keep=patterns)


def test_objects_and_scenes_that_cannot_be_a_lamp_are_told(mi):
    ball = {"type": "sphere", "emitter": {"type": "area"}}
    with pytest.raises(LumitreeError, match="holds objects that are created already"):
        load_luminaire({"type": "scene", "ball": mi.load_dict(ball)})
    beam = {"type": "scene", "face": {"type": "rectangle", "beam": {"type": "directionalarea"}}}
    with pytest.raises(LumitreeError, match="DirectionalArea"):
        load_luminaire(mi.load_dict(beam))
    kind = type("Scene", (), {"__module__": "mitsuba.scalar_rgb"})
    with pytest.raises(
        LumitreeError, match="created in another variant of Mitsuba than llvm_ad_rgb"
    ):
        load_luminaire(kind())


def test_builtins_are_selected_but_not_overridden(mi):
    kept = load_luminaire(LuminaireSource("bulbs", drop=("bulb_glass",)))
    assert kept.name == "bulbs"
    assert not any("glass" in shape.id() for shape in kept.scene.shapes())
    with pytest.raises(LumitreeError, match="takes no --materials"):
        load_luminaire(LuminaireSource("bulbs", materials="x.toml"))


def test_variant_is_for_gltf_alone(lamp):
    lamp.with_suffix(".toml").write_text("variant = 'x'\n" + BULB)
    with pytest.raises(LumitreeError, match=r"lamp\.toml: variant is only for glTF"):
        load_luminaire(lamp)


SHAPE = '<shape type="sphere"{}><point name="center" x="{}" y="0" z="0"/>{}</shape>'
ROOM = (
    '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"/>'
    '<emitter type="constant" id="sky"/><bsdf type="dielectric" id="glass"/>'
    + SHAPE.format(' id="lamp_bulb"', 0, AREA)
    + SHAPE.format(' id="lamp_shade"', 4, '<ref id="glass"/>')
    + SHAPE.format(' id="floor"', 90, '<medium type="homogeneous" name="interior"/>')
    + SHAPE.format("", 50, "")
    + '<shape type="shapegroup" id="beads">'
    + SHAPE.format(' id="bead"', 0, "")
    + '</shape><shape type="instance" id="lamp_beads"><ref id="beads"/>'
    '<transform name="to_world"><translate x="8" y="0" z="0"/></transform></shape></scene>'
)


@pytest.fixture
def room(mi, tmp_path):
    (tmp_path / "room.xml").write_text(ROOM)
    return str(tmp_path / "room.xml")


def test_lamp_is_taken_out_of_a_mitsuba_scene(room):
    luminaire = load_luminaire(LuminaireSource(room, keep=("lamp_*",), drop=("lamp_beads",)))
    scene = luminaire.scene
    assert sorted(shape.id() for shape in scene.shapes()) == ["lamp_bulb", "lamp_shade"]
    assert not scene.sensors()
    assert scene.environment() is None
    assert len(scene.emitters()) == 1
    assert not luminaire.has_media
    assert list(scene.bbox().max) == pytest.approx([5, 1, 1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keep": ("lamp",)}, "--keep 'lamp' matches no shape's id, BSDF's id or number"),
        ({"keep": ("lamp_*",), "drop": ("sky",)}, "--drop 'sky' matches no shape's id"),
        ({"keep": ("lamp_*",), "drop": ("*",)}, "leave nothing"),
        ({"keep": ("lamp_shade",)}, "no emitter"),
        ({"materials": "a.toml"}, "--materials does not apply"),
    ],
)  # fmt: skip
def test_wrong_selections(room, options, message):
    with pytest.raises(LumitreeError) as caught:
        load_luminaire(LuminaireSource(room, **options))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_selection_changes_the_fingerprint_of_a_scene(room):
    first = load_luminaire(LuminaireSource(room, keep=("lamp_*",))).fingerprint
    second = load_luminaire(LuminaireSource(room, keep=("lamp_bulb",))).fingerprint
    assert first != second


def test_unknown_formats_and_names(mi, tmp_path):
    (tmp_path / "lamp.fbx").write_bytes(b"")
    with pytest.raises(LumitreeError, match=r"\.xml .*\.obj, \.gltf, \.glb, or a built-in name"):
        load_luminaire(tmp_path / "lamp.fbx")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(LumitreeError, match="is a folder; expected an OBJ file"):
        load_luminaire(tmp_path / "folder.obj")


@pytest.mark.parametrize("kind", ["point", "spot", "constant", "directional", "area"])
def test_emitters_without_a_shape_are_refused(mi, tmp_path, kind):
    with pytest.raises(LumitreeError, match=rf"\({kind}\)"):
        lamp_of(tmp_path, sphere("bulb", 0.1, inside=AREA), f'<emitter type="{kind}"/>')
