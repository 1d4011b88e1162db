"""Faults of glass: each kind is found and named, and sound glass is left in peace."""

import re

import numpy as np
import pytest
import trimesh

from lumitree.lamp.diagnosis import diagnose, trace_lines
from lumitree.lamp.luminaire import load_luminaire
from support.lamps import AREA, GLASS, cube, lamp_of, sphere

LAMP = sphere("lamp", 0.1, (0, 0, 5), AREA)
BUBBLE = GLASS.replace("int_ior", "outside").replace("ext", "int").replace("outside", "ext_ior")
MASKED = f'<bsdf type="mask">{GLASS}</bsdf>'


@pytest.fixture
def faults(mi, tmp_path):
    def find(*shapes):
        return diagnose(lamp_of(tmp_path, LAMP, *shapes).scene)

    return find


def ply(tmp_path, name, mesh, inside=GLASS):
    mesh.export(tmp_path / f"{name}.ply")
    file = f'<string name="filename" value="{name}.ply"/>'
    return f'<shape type="ply" id="{name}">{file}{inside}</shape>'


@pytest.mark.parametrize(
    "shapes",
    [
        [sphere("a", 1, inside=GLASS)],
        [cube("a", 1, inside=GLASS)],
        [sphere("a", 1, inside=GLASS), sphere("b", 1, (2.1, 0, 0), GLASS)],
        [sphere("wall", 1, inside=GLASS), sphere("cavity", 0.9, inside=GLASS, flip=True)],
        [sphere("wall", 1, inside=GLASS), sphere("cavity", 0.9, inside=BUBBLE)],
        [
            sphere("wall", 1, inside=GLASS),
            sphere("cavity", 0.9, inside=GLASS, flip=True),
            cube("inside", 0.3, inside=GLASS),
        ],
        [sphere("a", 1, inside='<bsdf type="thindielectric"/>'), sphere("b", 0.5, inside=GLASS)],
        [sphere("a", 1, inside=GLASS), sphere("b", 0.5, inside='<bsdf type="diffuse"/>')],
        ['<shape type="rectangle"><bsdf type="thindielectric"/></shape>'],
    ],
)
def test_sound_glass(faults, shapes):
    assert faults(*shapes) == []


@pytest.mark.parametrize(
    ("shapes", "names", "what"),
    [
        ([sphere("a", 1, inside=GLASS), sphere("b", 0.9, inside=GLASS)], ("a", "b"), "overlap"),
        ([sphere("a", 1, inside=GLASS), cube("b", 1, (1, 0, 0), GLASS)], ("a", "b"), "overlap"),
        (
            [cube("a", 1, inside=MASKED), cube("b", 0.2, inside=GLASS)],
            ("a", "b"),
            "overlap",
        ),
        ([cube("a", 1, inside=GLASS), cube("b", 1, (2, 0, 0), GLASS)], ("a", "b"), "touch, or"),
        ([sphere("a", 1, inside=GLASS), sphere("b", 1, inside=GLASS)], ("a", "b"), "touch, or"),
        (
            [sphere("a", 1, inside=GLASS), sphere("b", 0.99999, inside=GLASS, flip=True)],
            ("a", "b"),
            "touch, or",
        ),
        ([sphere("a", 1, inside=GLASS, flip=True)], ("a",), "inside out"),
        ([f'<shape type="cylinder" id="a">{GLASS}</shape>'], ("a",), "not closed.*thindielectric"),
        ([f'<shape type="rectangle" id="a">{GLASS}</shape>'], ("a",), "not closed.*thindielectric"),
        (
            ['<shape type="disk" id="a"><bsdf type="roughdielectric"/></shape>'],
            ("a",),
            "not closed",
        ),
    ],
)  # fmt: skip
def test_faults_are_found_and_named(faults, shapes, names, what):
    (found,) = faults(*shapes)
    assert re.search(what, found)
    assert all(f"'{name}'" in found for name in names)
    assert "\n" not in found


def test_faults_within_one_mesh(faults, tmp_path):
    ball = trimesh.creation.icosphere(3)
    moved = trimesh.creation.icosphere(3)
    moved.apply_translation([1.2, 0.1, 0])
    (found,) = faults(ply(tmp_path, "two", trimesh.util.concatenate([ball, moved])))
    assert "parts of 'two' overlap" in found
    holed = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 1] < 0.8])
    (found,) = faults(ply(tmp_path, "holed", holed))
    assert "'holed' is a dielectric, but not closed" in found


def test_crossings_give_the_mean_chords_of_a_cube_and_a_ball(mi):
    """Volume / projected area, along every direction: for a mesh and for a shape that is none."""
    glass = {"bsdf": {"type": "dielectric"}}
    box = mi.load_dict({"type": "cube", **glass})
    ball = mi.load_dict({"type": "sphere", "center": [4, 0, 1], **glass})
    crossings = trace_lines([box, ball])
    for direction in np.unique(crossings.direction, axis=0):
        chords = []
        for shape in range(2):
            chosen = (crossings.direction == direction).all(axis=1) & (crossings.shape == shape)
            one = crossings.take(chosen)
            assert (one.step[0::2] == 1).all()
            assert (one.step[1::2] == -1).all()
            assert (one.line[0::2] == one.line[1::2]).all()
            chords.append(np.diff(one.distance.reshape(-1, 2)).mean())
        assert chords[0] == pytest.approx(8 / (4 * np.abs(direction).sum()), rel=0.01)
        assert chords[1] == pytest.approx(4 / 3, rel=0.01)


def test_scenes_without_glass_and_the_builtin_are_sound(faults):
    assert faults() == []
    assert diagnose(load_luminaire("bulbs").scene) == []
