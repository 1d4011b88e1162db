"""Faces that are several times in one place count once, in models of all formats."""

import warnings

import numpy as np
import pytest

from lumitree.asset.materials import Dielectric
from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers.overrides import emitting_area
from lumitree.lamp.meshes import area_normals
from lumitree.lamp.read_source import read_model
from lumitree.lamp.source import LuminaireSource
from support.gltf_builder import QUAD, QUAD_FACES, Gltf, sphere

LIT = {"name": "lit", "emissiveFactor": [1, 1, 1]}
TRANSMISSION = {"KHR_materials_transmission": {"transmissionFactor": 1}}
SOLID = TRANSMISSION | {"KHR_materials_volume": {"thicknessFactor": 1}}
SMOOTH = {"pbrMetallicRoughness": {"roughnessFactor": 0, "metallicFactor": 0}}
AREA = 4.0


def read(path, **options):
    """A model, and the numbers of faces that are said to repeat others."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read_model(LuminaireSource(str(path), **options))
    said = [str(each.message) for each in caught if issubclass(each.category, LumitreeWarning)]
    repeated = [line for line in said if "repeat others of the same material" in line]
    return model, [
        int(line.split(": ")[1].split(" faces")[0].replace(",", "")) for line in repeated
    ]


def normals(model, title="lit"):
    """Area vectors [F, 3] of the faces of a material in all their places."""
    names = {each.name for each in model.materials if each.title == title}
    found = [
        area_normals(part.mesh.vertices @ place[:3, :3].T + place[:3, 3], part.mesh.faces) / 2
        for part in model.parts
        for place in part.places
        if part.material in names
    ]
    return np.concatenate([np.zeros((0, 3)), *found])


def area(model, title="lit"):
    return np.linalg.norm(normals(model, title), axis=1).sum()


def nodes(*fields):
    """Nodes with one quad that emits."""
    gltf = Gltf()
    gltf.quad(gltf.material(**LIT), name="first")
    for each in fields:
        gltf.node(**{"mesh": 0} | each)
    return gltf


def instanced(count):
    gltf = nodes()
    at = gltf.accessor(np.tile(np.float32([0, 0, 1]), (count, 1)))
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}}
    gltf.json["nodes"][0]["extensions"] = extension
    return gltf


def within_a_primitive():
    gltf = Gltf()
    faces = np.concatenate([QUAD_FACES, QUAD_FACES[:1], QUAD_FACES[:, [1, 2, 0]]])
    gltf.node(gltf.primitive(QUAD, faces, material=gltf.material(**LIT)))
    return gltf


def across_primitives():
    gltf = Gltf()
    material = gltf.material(**LIT)
    rounded = QUAD + np.float32(2e-6) * np.random.default_rng(0).uniform(-1, 1, QUAD.shape)
    faces = [QUAD_FACES, QUAD_FACES[1:]]
    shapes = [QUAD, rounded.astype(np.float32)]
    pairs = zip(shapes, faces, strict=True)
    gltf.node(*(gltf.primitive(*each, material=material) for each in pairs))
    return gltf


@pytest.mark.parametrize(
    ("gltf", "count"),
    [
        (nodes({}), 2),
        (nodes({}, {}, {}), 6),
        # A half turn exchanges the triangles; a mirrored copy keeps its front.
        (nodes({"rotation": [0, 0, 1, 0]}), 2),
        (nodes({"scale": [-1, -1, 1]}), 2),
        (nodes({"matrix": np.diag([1.0, 1, 1, 1]).ravel().tolist()}), 2),
        (instanced(3), 4),
        (within_a_primitive(), 3),
        (across_primitives(), 1),
    ],
)
def test_what_emits_twice_in_one_place_emits_once(tmp_path, gltf, count):
    """Blender exports an object and an instance of its collection; it gave twice the light."""
    model, said = read(gltf.save(tmp_path))
    assert said == [count]
    assert area(model) == pytest.approx(AREA, rel=1e-5)
    assert emitting_area(model, "lit") == pytest.approx(AREA, rel=1e-5)


@pytest.mark.parametrize(
    "gltf",
    [
        nodes({"translation": [0, 0, 1e-3]}),
        nodes({"scale": [1, 1.001, 1]}),
        nodes({"rotation": [0, 0, 0.383, 0.924]}),
    ],
)
def test_what_is_only_near_stays(tmp_path, gltf):
    model, said = read(gltf.save(tmp_path))
    assert said == []
    assert area(model) == pytest.approx(2 * AREA, rel=1e-3)


def test_other_materials_in_one_place_stay(tmp_path):
    gltf = nodes()
    gltf.quad(gltf.material(name="other"))
    model, said = read(gltf.save(tmp_path))
    assert (said, len(model.parts)) == ([], 2)


@pytest.mark.parametrize("name", ["first", "second"])
@pytest.mark.parametrize("option", ["keep", "drop"])
def test_each_of_two_objects_in_one_place_can_be_chosen(tmp_path, name, option):
    model, said = read(nodes({"name": "second"}).save(tmp_path), **{option: [name]})
    assert said == []
    assert area(model) == pytest.approx(AREA)


def reversed_quad(**fields):
    gltf = Gltf()
    material = gltf.material(name="lit", **fields)
    gltf.quad(material)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES[:, ::-1], material=material))
    gltf.quad(gltf.material(emissiveFactor=[1, 1, 1]), translation=[0, 0, 9])
    return gltf


@pytest.mark.parametrize(
    ("fields", "sides"),
    [
        ({"emissiveFactor": [1, 1, 1]}, 2),
        ({"emissiveFactor": [1, 1, 1], "doubleSided": True}, 2),
        ({}, 2),
        ({"doubleSided": True}, 1),
        (SMOOTH | {"extensions": TRANSMISSION}, 1),
    ],
)
def test_both_windings_stay_where_the_sides_differ(tmp_path, fields, sides):
    """The second a little behind the first, so that a ray from either side meets its own."""
    model, said = read(reversed_quad(**fields).save(tmp_path))
    found = normals(model)
    assert np.linalg.norm(found, axis=1).sum() == pytest.approx(sides * AREA)
    assert said == ([] if sides == 2 else [2])
    height = {}
    for part in model.parts:
        if part.mesh.vertices[:, 2].max() < 1 and part.places[0][2, 3] == 0:
            z = part.mesh.vertices[part.mesh.faces].mean(axis=1)[:, 2]
            front = area_normals(part.mesh.vertices, part.mesh.faces)[:, 2] > 0
            height |= {bool(side): z[front == side].mean() for side in np.unique(front)}
    if sides == 2:
        assert 0 < height[True] - height[False] < 1e-3


def glass_balls(*places, within=False):
    """Balls of solid glass: in several nodes, or several times in one primitive."""
    gltf = Gltf()
    glass = gltf.material(name="glass", **SMOOTH, extensions=SOLID)
    mesh = sphere(1.0, 12)
    if within:
        faces = np.concatenate([mesh.faces, *(mesh.faces[:, ::step] for step in places)])
        gltf.node(gltf.primitive(mesh.vertices, faces.astype(np.uint32), material=glass))
    else:
        gltf.sphere(glass, segments=12)
        for scale in places:
            gltf.node(mesh=0, scale=scale)
    gltf.quad(gltf.material(**LIT), translation=[0, 0, 9])
    return gltf


@pytest.mark.parametrize(
    "gltf",
    [
        glass_balls([1, 1, 1]),
        glass_balls([-1, -1, 1], [1, 1, 1]),
        # Mirror images, with the other diagonals.
        glass_balls([-1, 1, 1], [1, 1, -1], [-1, -1, -1]),
        glass_balls(1, within=True),
        glass_balls(-1, within=True),
        glass_balls(-1, 1, -1, within=True),
    ],
)
def test_a_repeated_ball_of_glass_is_one_solid(tmp_path, gltf):
    """Light would cross two borders in one place, or find no solid at all."""
    model, said = read(gltf.save(tmp_path))
    (part,) = (each for each in model.parts if each.material.startswith("glass"))
    (material,) = (each for each in model.materials if each.name == part.material)
    assert isinstance(material.surface, Dielectric)
    assert len(said) == 1
    assert len(part.mesh.faces) == len(sphere(1.0, 12).faces)
    volume = (part.mesh.vertices[part.mesh.faces[:, 0]] * normals(model, "glass")).sum() / 3
    assert 3.5 < volume < 4.2


def test_light_of_one_lamp_in_two_nodes_counts_once(tmp_path):
    gltf = Gltf()
    for at in ([0, 0, 0], [0, 0, 0], [0, 1, 0]):
        gltf.node(translation=at, extensions={"KHR_lights_punctual": {"light": 0}})
    lights = [{"type": "spot", "name": "bulb", "intensity": 5.0}]
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    model, said = read(gltf.save(tmp_path))
    assert [len(part.places) for part in model.parts] == [2, 2]
    assert said == [sum(len(part.mesh.faces) for part in model.parts)]
