"""Rooms and lamps whose shapes are instances of groups."""

import numpy as np
import pytest

import lumitree
from support.fields import random_asset
from support.lamps import AREA, lamp_of, sphere

ROOM = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="perspective"><float name="fov" value="50"/>
<transform name="to_world"><lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
</sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
</shape>{}</scene>"""
GROUP = '<shape type="shapegroup" id="group">{}</shape>'
BOX = '<shape type="cube">{}<bsdf type="diffuse"/></shape>'
PLACES = ("-1.5", "1.5")


def place(x):
    return f'<transform name="to_world"><scale value="0.4"/><translate x="{x}"/></transform>'


def repeated(x):
    return f'<shape type="instance"><ref id="group"/>{place(x)}</shape>'


def save(path, *shapes):
    path.write_text(ROOM.format("".join(shapes)))
    return path


@pytest.mark.slow
def test_lamps_are_placed_in_a_room_with_instances(mi, tmp_path):
    lumitree.save(random_asset(3), tmp_path / "lamp.lumitree")
    lamps = [lumitree.Placement(str(tmp_path / "lamp.lumitree"), at=(0, 1, 0), size=0.5)]
    instanced = save(
        tmp_path / "instanced.xml", GROUP.format(BOX.format("")), *map(repeated, PLACES)
    )
    plain = save(tmp_path / "plain.xml", *(BOX.format(place(x)) for x in PLACES))
    found, expected = (lumitree.render(each, lamps, spp=256) for each in (instanced, plain))
    assert expected.pixels.mean() > 0
    assert found.pixels.mean(axis=(0, 1)) == pytest.approx(
        expected.pixels.mean(axis=(0, 1)), rel=0.02
    )
    assert np.abs(found.pixels - expected.pixels).mean() < 0.1 * expected.pixels.mean()


@pytest.mark.slow
def test_an_explicit_lamp_with_instances_is_placed_and_previewed(mi, tmp_path):
    lamp_of(
        tmp_path,
        sphere("lamp", 0.3, inside=AREA),
        GROUP.format(BOX.format("")),
        *map(repeated, PLACES),
    )
    room = save(tmp_path / "room.xml")
    found = lumitree.render(
        room, [lumitree.Placement(str(tmp_path / "lamp.xml"), at=(0, 0, 0))], spp=16
    )
    assert found.pixels.mean() > 0
    assert lumitree.preview(tmp_path / "lamp.xml", resolution=16, spp=4).png
