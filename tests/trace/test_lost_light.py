"""Luminaires that no light leaves, or more than they emit: the message names the cause."""

import re
import warnings

import numpy as np
import pytest
import trimesh

from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.luminaire import load_luminaire
from lumitree.trace.flux import check_output
from lumitree.trace.light_paths import LampRays
from support.lamps import AREA, GLASS, cube, lamp_of, sphere

RAYS = 1 << 16
DARK = '<bsdf type="diffuse" id="paint"><rgb name="reflectance" value="0.2"/></bsdf>'
BULB = sphere("bulb", 0.1, inside=AREA)
# Glass as Blender writes it into an MTL file.
MTL = """newmtl bulb
Ke 3 3 3
newmtl white glass
Ns 1000
Kd 0.8 0.8 0.8
Ks 0.5 0.5 0.5
Ni 1.45
d 1
illum 2
"""


def masked(opacity):
    return f'<bsdf type="mask"><float name="opacity" value="{opacity}"/>{DARK}</bsdf>'


def measured(lamp):
    """Flux that leaves a lamp, and the warnings of `check_output`."""
    flux = [LampRays(lamp).draw(RAYS, seed).arrays()[2].sum(axis=0) for seed in (1, 2)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_output(lamp, luminance(np.array(flux)), 0)
    watts = np.mean(flux, axis=0) * lamp.frame.scale**2
    return watts, [str(each.message) for each in caught if each.category is LumitreeWarning]


@pytest.mark.parametrize(
    ("around", "named"),
    [
        ([cube("box", 1, inside=DARK)], r"'box' \(diffuse 'paint'\)"),
        # Shapes behind it, and shapes that let light through, do not enclose.
        (
            [
                sphere("clear", 0.2, inside='<bsdf type="thindielectric"/>'),
                cube("inner", 0.5, inside=DARK),
                cube("outer", 1, inside=DARK.replace("paint", "other")),
            ],
            r"'inner' \(diffuse 'paint'\)",
        ),
        # Glass and a mirror that give most of the light back to the black bulb.
        (
            [
                sphere("clear", 0.2, inside=GLASS),
                sphere("clear side", 0.15, inside=GLASS, flip=True),
                sphere("mirror", 0.3, inside='<bsdf type="conductor"/>'),
            ],
            r"'mirror' \(conductor\)",
        ),
        ([], None),
    ],
)
def test_what_encloses_the_emitters_is_named(mi, tmp_path, around, named):
    lamp = lamp_of(tmp_path, BULB, *around)
    if named is None:
        assert measured(lamp)[1] == []
        return
    match = rf"^no light leaves .*lamp: it ends on {named}; leave an opening, or give it a BSDF"
    with pytest.raises(LumitreeError, match=match):
        measured(lamp)


@pytest.mark.parametrize(("opacity", "share"), [(0.9995, 0.05), (0.99, None)])
def test_less_than_a_thousandth_of_the_light_is_warned_of(mi, tmp_path, opacity, share):
    lamp = lamp_of(tmp_path, BULB, cube("box", 1, inside=masked(opacity)))
    watts, said = measured(lamp)
    assert (watts > 0).all()
    if share is None:
        assert said == []
        return
    (line,) = said
    found = re.match(r"only ([\d.]+) % of the light leaves .*: it ends on 'box' \(mask", line)
    assert float(found[1]) == pytest.approx(share, rel=0.5)


@pytest.mark.slow
def test_opaque_glass_of_blender_is_named_with_the_line_that_mends_it(mi, tmp_path):
    balls = [trimesh.creation.icosphere(subdivisions=2, radius=radius) for radius in (0.1, 0.5)]
    lines, offset = ["mtllib lamp.mtl"], 1
    for ball, material in zip(balls, ("bulb", "white glass"), strict=True):
        lines += [f"usemtl {material}"]
        lines += ["v " + " ".join(map(str, row)) for row in ball.vertices.tolist()]
        lines += ["f " + " ".join(map(str, row)) for row in (ball.faces + offset).tolist()]
        offset += len(ball.vertices)
    (tmp_path / "lamp.obj").write_text("\n".join(lines))
    (tmp_path / "lamp.mtl").write_text(MTL)
    with pytest.raises(
        LumitreeError, match=r"no light leaves .* it ends on 'white_glass'"
    ) as error:
        measured(load_luminaire(tmp_path / "lamp.obj"))
    assert "if this is glass, which Blender writes into OBJ files as opaque (d 1)" in str(
        error.value
    )
    line = str(error.value).split("put first into lamp.toml: ")[1]
    (tmp_path / "lamp.toml").write_text(line)
    watts, said = measured(load_luminaire(tmp_path / "lamp.obj"))
    assert said == []
    assert 0.8 < watts[0] / (4 * np.pi * 0.1**2 * np.pi * 3) <= 1


def test_a_material_that_creates_light_is_named(mi, tmp_path):
    path = tmp_path / "bright.exr"
    mi.Bitmap(np.full((2, 2, 3), 1.5, np.float32)).write(str(path))
    bright = f'<string name="filename" value="{path}"/><boolean name="raw" value="true"/>'
    bright = f'<texture type="bitmap" name="reflectance">{bright}</texture>'
    paint = f'<bsdf type="diffuse" id="paint">{bright}</bsdf>'
    plate = f'<bsdf type="twosided">{paint}</bsdf>'
    lamp = lamp_of(tmp_path, BULB, cube("plate", (1, 1, 0.1), (0, 0, -0.4), inside=plate))
    _, (line,) = measured(lamp)
    found = re.match(
        r"([\d.]+) ± [\d.]+ % of the light of the emitters leaves .*: the material", line
    )
    assert float(found[1]) > 105
    assert re.search(r"material of 'plate' \(twosided 'paint'\) creates light", line)


def test_emitters_without_light(mi, tmp_path):
    lamp = lamp_of(tmp_path, BULB.replace("3,2,1", "0"))
    with pytest.raises(LumitreeError, match=r"no light leaves .*lamp; its emitters are black"):
        measured(lamp)
