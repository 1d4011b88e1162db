"""Glass of the built-in lamps: nothing cuts it or lies in it."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.meshes import join, moved
from lumitree.lamp.parts import Glass

CLEARANCE = 2e-4  # metres


@pytest.fixture(scope="module")
def models():
    return {name: builtin.build() for name, builtin in BUILTIN.items()}


def is_glass(model, part):
    surface = {material.name: material for material in model.materials}[part.material].surface
    return isinstance(surface, Glass) and not surface.thin


def glass_parts(model):
    return [part for part in model.parts if is_glass(model, part)]


def standing(parts):
    """All copies of the parts where they stand, as one mesh."""
    return join(moved(part.mesh, place) for part in parts for place in part.places)


def load(mi, mesh):
    shape = make_mesh("mesh", {"vertices": mesh.vertices, "faces": mesh.faces})
    return mi.load_dict({"type": "scene", "mesh": shape})


def point(mi, values):
    return on_device(mi.Point3f, values)


def crossed(mi, scene, mesh):
    """Number of the mesh's edges that cut the scene's surface."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    start, end = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
    length = np.linalg.norm(end - start, axis=1)
    start, end, length = start[length > 0], end[length > 0], length[length > 0]
    direction = on_device(mi.Vector3f, (end - start) / length[:, None])
    ray = mi.Ray3f(point(mi, start), direction)
    ray.maxt = on_device(mi.Float, length)
    return np.count_nonzero(np.array(scene.ray_test(ray)))


def inside(mi, scene, points):
    """Number of points within the scene's solids: the next surface is left, not entered."""
    direction = mi.Vector3f(0.267, 0.802, 0.535)
    si = scene.ray_intersect(mi.Ray3f(point(mi, points), direction))
    leaving = np.array(si.n.x * 0.267 + si.n.y * 0.802 + si.n.z * 0.535) > 0
    return np.count_nonzero(leaving & np.array(si.is_valid()))


def centroids(mesh):
    return mesh.vertices[mesh.faces].mean(axis=1)


@pytest.mark.parametrize("name", BUILTIN)
def test_nothing_cuts_the_glass_or_lies_in_it(mi, models, name):
    model = models[name]
    glass = standing(glass_parts(model))
    others = standing([part for part in model.parts if not is_glass(model, part)])
    glass_scene, others_scene = load(mi, glass), load(mi, others)
    assert crossed(mi, glass_scene, others) == 0
    assert crossed(mi, others_scene, glass) == 0
    assert inside(mi, glass_scene, centroids(others)) == 0
    # Just outside its surface there is no other glass either.
    corners = glass.vertices[glass.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert inside(mi, glass_scene, centroids(glass) + CLEARANCE * normal) == 0
    assert inside(mi, glass_scene, centroids(glass) - CLEARANCE / 10 * normal) > 0
