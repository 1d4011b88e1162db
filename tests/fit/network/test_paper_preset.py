"""The preset `paper` against the text of the paper, statement by statement (docs/equations.md)."""

import inspect

import numpy as np
import pytest

from lumitree.fit.config import BakeConfig
from lumitree.fit.network.step import EPSILON, learning_rate
from lumitree.octree.extract import extract
from lumitree.rendering.emitter import SAMPLING_KINDS

BAKE = BakeConfig.of("paper", "network").network
CONFIG = BAKE.train


@pytest.mark.parametrize(
    ("statement", "found", "stated"),
    [
        ("8-layered, 256 neurons wide", (CONFIG.num_layers, CONFIG.width), (8, 256)),
        ("an extra output layer of 128 neurons", CONFIG.output_width, 128),
        ("l_max = 2", CONFIG.l_max, 2),
        ("a batch size of 1024 rays", CONFIG.rays_per_batch, 1024),
        ("N_c = 64 positions in the coarse model", CONFIG.num_coarse, 64),
        ("N_f = 128 additional coordinates in the fine one", CONFIG.num_fine, 128),
        ("700k-1.1M iterations", CONFIG.num_steps, 700_000),
        ("linear transmittance", CONFIG.law, "linear"),
        ("HDR color loss", CONFIG.colour_loss, "hdr"),
        ("we directly supervise the opacity", CONFIG.supervise_opacity, True),
        ("epsilon = 0.01", EPSILON, 0.01),
        ("100 images as our training set", BAKE.views, 100),
        ("a resolution of 800²", BAKE.resolution, 800),
        ("a maximum octree depth of 10 levels", BAKE.tree_depth, 10),
        ("256 positional samples", BAKE.samples_per_leaf, 256),
        ("the preset's network", BAKE.train, CONFIG),
        (
            "prune voxels whose density is below 0.01",
            inspect.signature(extract).parameters["min_density"].default,
            0.01,
        ),
        ("uniformly sample the proxy geometry", "uniform" in SAMPLING_KINDS, True),
    ],
)
def test_statement(statement, found, stated):
    assert found == stated, statement


def test_learning_rate_decays_exponentially_from_start_to_end():
    rate = learning_rate(CONFIG)
    assert float(rate(0)) == pytest.approx(5e-4)
    assert float(rate(CONFIG.num_steps)) == pytest.approx(5e-6, rel=1e-4)
    middle = np.sqrt(5e-4 * 5e-6)
    assert float(rate(CONFIG.num_steps // 2)) == pytest.approx(middle, rel=1e-4)
