"""Plugins that Mitsuba creates but cannot evaluate are refused; the message names the shape."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import load_luminaire
from support.lamps import AREA, cube, lamp_of, scene, sphere

CHECKER = '<texture type="checkerboard" name="{}"/>'
GREY = (
    '<texture type="bitmap" name="{}"><string name="filename" value="grey.png"/>'
    '<boolean name="raw" value="true"/></texture>'
)
CURVE = '<shape type="{}" id="wire"><string name="filename" value="curve.txt"/>' + AREA + "</shape>"
BULB = sphere("bulb", 0.1, inside=AREA)


def emits(texture):
    return f'<emitter type="area">{texture}</emitter>'


def coated(plugin, texture):
    return f'<bsdf type="{plugin}">{texture}<bsdf type="roughplastic"/></bsdf>'


FAULTY = {
    "curve": ([CURVE.format("bsplinecurve")], "emitter of shape 'wire', area, "),
    "straight curve": ([CURVE.format("linearcurve")], "emitter of shape 'wire', area, "),
    "procedural bumps": (
        [BULB, sphere("shade", 1, inside=coated("bumpmap", CHECKER.format("b")))],
        "BSDF of shape 'shade', bumpmap with checkerboard",
    ),
    "grey normals": (
        [BULB, sphere("shade", 1, inside=coated("normalmap", GREY.format("normalmap")))],
        "BSDF of shape 'shade', normalmap with bitmap",
    ),
    "no id": (
        [BULB, sphere("", 1, inside=coated("bumpmap", CHECKER.format("b")))],
        r"BSDF of shape #1 \(sphere\), bumpmap",
    ),
    "a spectrum as a reflectance": (
        [
            BULB,
            sphere(
                "shade",
                1,
                inside='<bsdf type="diffuse"><spectrum type="blackbody" name="reflectance">'
                '<float name="temperature" value="3000"/></spectrum></bsdf>',
            ),
        ],
        "BSDF of shape 'shade', diffuse with blackbody",
    ),
}


@pytest.fixture
def folder(mi, tmp_path):
    mi.Bitmap(np.full((4, 4), 128, np.uint8)).write(str(tmp_path / "grey.png"))
    (tmp_path / "curve.txt").write_text("0 0 0 .1\n1 0 0 .1\n2 1 0 .1\n3 1 0 .1\n")
    return tmp_path


@pytest.mark.parametrize("name", FAULTY)
def test_what_cannot_be_evaluated_is_named_in_a_line(folder, name):
    shapes, expected = FAULTY[name]
    with pytest.raises(LumitreeError, match=f"lamp: the {expected}") as caught:
        lamp_of(folder, *shapes)
    assert "Mitsuba" in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 700


def test_what_can_be_evaluated_is_accepted(folder):
    lamp = lamp_of(
        folder,
        cube("box", 1, inside=emits(GREY.format("radiance"))),
        sphere("shade", 1, inside=coated("bumpmap", GREY.format("any"))),
        sphere("globe", 1, inside=f'<bsdf type="diffuse">{CHECKER.format("reflectance")}</bsdf>'),
        sphere("fibre", 1, inside='<bsdf type="hair"/>'),
        sphere("pattern", 1, inside=emits(CHECKER.format("radiance"))),
    )
    names = ["box", "shade", "globe", "fibre", "pattern"]
    assert [shape.name for shape in lamp.shapes] == names


def test_scenes_and_dictionaries_are_tried_too(mi):
    bumps = {"type": "bumpmap", "t": {"type": "checkerboard"}, "b": {"type": "plastic"}}
    faulty = {"type": "sphere", "id": "globe", "bsdf": bumps, "emitter": {"type": "area"}}
    with pytest.raises(LumitreeError, match="'globe', bumpmap with checkerboard"):
        load_luminaire({"type": "scene", "globe": faulty})
    pattern = {"type": "area", "radiance": {"type": "checkerboard"}}
    made = mi.load_dict(
        {"type": "scene", "globe": {**faulty, "bsdf": {"type": "diffuse"}, "emitter": pattern}}
    )
    with pytest.raises(LumitreeError, match="scene: the emitter of shape 'globe', AreaLight"):
        load_luminaire(made)


@pytest.mark.parametrize(
    ("element", "expected"),
    [
        (sphere("ball", 1, inside=coated("bumpmap", CHECKER.format("b"))), "shape 'ball', bumpmap"),
        ('<shape type="linearcurve" id="wire"><string name="filename" value="curve.txt"/>'
         f"{AREA}</shape>", "shape 'wire', area"),
        ('<emitter type="envmap" id="sky"><string name="filename" value="none.exr"/></emitter>',
         "cannot be loaded"),
    ],
)  # fmt: skip
def test_rooms_are_tried_too(folder, element, expected):
    from lumitree.rendering.scene import load_scene

    (folder / "room.xml").write_text(scene('<sensor type="perspective"/>', BULB, element))
    with pytest.raises(LumitreeError, match=expected):
        load_scene(str(folder / "room.xml"))


def test_emitters_without_a_shape_are_refused(folder):
    for kind in ("point", "spot", "constant", "directional", "area"):
        with pytest.raises(LumitreeError, match=rf"\({kind}\)"):
            lamp_of(folder, BULB, f'<emitter type="{kind}"/>')
