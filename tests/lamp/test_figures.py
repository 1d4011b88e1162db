"""Figures of a model: numbers of triangles and emitters, radiance, size."""

import numpy as np
import pytest

from lumitree.asset.materials import VertexColours
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.parts import Diffuse, Geometry, Material, Part, Texture, figures

TRIANGLE = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]),
    np.tile([0.0, 0, 1], (3, 1)),
    np.array([[0, 1, 2]]),
    colours=np.array([[0.1, 0.2, 0.3], [0.4, 0.0, 0.9], [0.0, 0.0, 0.0]]),
)


def lamp(radiance, surface=None):
    material = Material("m", surface or Diffuse(), radiance)
    moved = np.eye(4)
    moved[:3, 3] = [3, 0, 1]
    return Geometry((Part("p", TRIANGLE, "m", (np.eye(4), moved)),), (material,))


def test_copies_count_and_stretch_the_box():
    found = figures(lamp((5.0, 7.0, 1.0)))
    assert (found.triangles, found.emitters, found.emitted_radiance) == (2, 2, 7.0)
    assert found.size == (4, 2, 1)
    assert figures(lamp(None)).emitters == 0


@pytest.mark.parametrize(
    ("radiance", "largest"),
    [
        (VertexColours(), 0.9),
        (Texture(np.full((2, 2, 3), 40.0, np.float32), encoded=False), 40.0),
        (Texture(np.full((2, 2, 3), 51, np.uint8), encoded=False), 0.2),
        # sRGB 128 is 21.586 % of the light.
        (Texture(np.full((2, 2, 3), 128, np.uint8), encoded=True), 0.21586),
    ],
)
def test_largest_radiance_of_textures(radiance, largest):
    assert figures(lamp(radiance)).emitted_radiance == pytest.approx(largest, rel=1e-4)
