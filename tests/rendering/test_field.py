"""The traversal against its slow twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumitree.core.device import on_device
from lumitree.octree.build import child_cells
from support.fields import make_asset, random_asset
from support.reference_field import integrate_ray
from support.slow import slow


def trace(mi, asset, origins, directions):
    from lumitree.octree.field import Field

    field = Field(asset)
    o = on_device(mi.Point3f, origins)
    d = on_device(mi.Vector3f, directions)
    radiance, through = field.emission(o, d)
    alone = field.transmittance(o, d)
    assert np.array_equal(np.array(alone), np.array(through))
    return np.array(radiance).T, np.array(through)


def check(mi, asset, origins, directions, tolerance=2e-4):
    radiance, through = trace(mi, asset, origins, directions)
    for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
        expected, expected_through = integrate_ray(asset, o, d)
        assert through[i] == pytest.approx(expected_through, abs=tolerance)
        assert radiance[i] == pytest.approx(expected, abs=tolerance * asset.max_radiance)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    law=st.sampled_from(["linear", "exponential"]),
    l_max=st.integers(0, 4),
    thin=st.booleans(),
)
def test_random_rays(mi, seed, law, l_max, thin):
    random = np.random.default_rng(seed)
    half = np.array([1.0, 0.61, 0.37]) if thin else np.ones(3)
    asset = random_asset(seed, law=law, l_max=l_max, density_scale=0.7, half_extents=half)
    targets = random.uniform(-1, 1, (16, 3))
    directions = random.normal(size=(16, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    origins = (targets - 3 * directions).astype(np.float32)
    check(
        mi,
        asset,
        origins.astype(float),
        directions.astype(float),
        2e-4 if law == "linear" else 1.2e-3,
    )


@pytest.mark.parametrize(("seed", "depth"), [(0, 7), slow(1, 7), slow(2, 9)])
def test_random_rays_through_a_deep_tree(mi, seed, depth):
    # More levels than one wide node has, and more leaves a ray than are put off together.
    random = np.random.default_rng(seed)
    asset = random_asset(seed, tree_depth=depth, density_scale=0.5, law="exponential")
    directions = random.normal(size=(24, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = (random.uniform(-0.9, 0.9, (24, 3)) - 3 * directions).astype(np.float32)
    check(mi, asset, origins.astype(float), directions.astype(float), 1.2e-3)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), axis=st.integers(0, 2), sign=st.sampled_from([-1.0, 1.0]))
def test_axis_parallel_rays_on_cell_boundaries(mi, seed, axis, sign):
    random = np.random.default_rng(seed)
    asset = random_asset(seed, density_scale=0.7)
    # Multiples of 1/16: half of them lie exactly on the planes between cells.
    origins = random.integers(-16, 16, (16, 3)) / 16.0
    directions = np.zeros((16, 3))
    directions[:, axis] = sign
    origins[:, axis] = -2 * sign
    check(mi, asset, origins, directions)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), tilt=st.sampled_from([1e-7, 1e-6, 1e-4, 1e-3]))
def test_grazing_rays(mi, seed, tilt):
    random = np.random.default_rng(seed)
    asset = random_asset(seed, density_scale=0.7)
    # Nearly parallel to z, between two planes, so that the float32 and the float64 ray agree on
    # which cells they cross.
    directions = np.tile([tilt, -tilt, 1.0], (16, 1))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions.astype(np.float32).astype(float)
    origins = (random.integers(-16, 16, (16, 3)) + 0.5) / 16.0
    origins[:, 2] = -2
    check(mi, asset, origins, directions)


def test_rays_through_edges_and_corners_end(mi):
    asset = random_asset(3, density_scale=0.1)
    diagonal = np.array([[1.0, 1, 1], [1, 1, -1], [1, -1, 0], [0, 1, 1]])
    diagonal /= np.linalg.norm(diagonal, axis=1, keepdims=True)
    radiance, through = trace(mi, asset, -2 * diagonal, diagonal)
    assert np.isfinite(radiance).all()
    assert ((through >= 0) & (through <= 1)).all()


def test_missing_and_degenerate_rays_see_nothing(mi):
    asset = random_asset(5)
    origins = [[0, 0, 5], [3, 3, 3], [0, 2, 0]]
    directions = [[1, 0, 0], [0, 1, 0], [np.nan, 0, 1]]
    radiance, through = trace(mi, asset, origins, directions)
    assert (radiance == 0).all()
    assert (through == 1).all()


def test_empty_asset_is_clear(mi):
    asset = make_asset(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3, 9)))
    radiance, through = trace(mi, asset, [[0, 0, -2]], [[0, 0, 1]])
    assert (radiance == 0).all()
    assert through == [1]


def test_coefficients_that_are_denormal_in_half_precision_count(mi):
    """Coefficients of either sign count in a kernel that traces rays, which may flush denormals."""
    import lumitree

    def rendered(coefficient):
        coefficients = np.full((8, 3, 1), coefficient)
        cells = child_cells(np.zeros(3, int))
        asset = make_asset(cells, np.ones(8), np.full(8, 1e4), coefficients, tree_depth=1)
        film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
        look = mi.ScalarTransform4f().look_at([0, 0.2, 5], [0, 0, 0], [0, 1, 0])
        sensor = {"type": "perspective", "fov": 5, "to_world": look, "film": film}
        scene = {"type": "scene", "sensor": sensor, "lamp": lumitree.shape(asset)}
        integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 2})
        image = np.array(mi.render(mi.load_dict(scene), integrator=integrator, spp=4), np.float64)
        expected, _ = integrate_ray(asset, np.array([0.1, 0.2, 5]), np.array([0, 0, -1.0]))
        return image.mean(), np.mean(expected)

    (bright, expected_bright), (dark, expected_dark) = rendered(5.9e-5), rendered(-5.9e-5)
    assert bright - dark == pytest.approx(expected_bright - expected_dark, rel=0.1)


def test_thresholds_of_the_paper_change_little(mi):
    from lumitree.octree.field import Field

    asset = random_asset(7)
    random = np.random.default_rng(7)
    d = random.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d = on_device(mi.Point3f, -2 * d), on_device(mi.Vector3f, d)
    exact = np.array(Field(asset).transmittance(o, d))
    loose = np.array(Field(asset, min_density=0.1, max_opacity=0.9).transmittance(o, d))
    assert (loose >= exact - 1e-6).all()
    assert (np.abs(loose - exact) <= 0.1 + 0.1 * 2 * np.sqrt(3)).all()
    assert (loose != exact).any()


def test_instances_share_one_field(mi, tmp_path):
    from lumitree.asset.file import save
    from lumitree.octree.field import shared_field
    from lumitree.rendering.asset_cache import open_asset

    save(random_asset(1), tmp_path / "a.lumitree")
    first = open_asset(tmp_path / "a.lumitree")
    assert open_asset(tmp_path / "." / "a.lumitree") is first
    assert shared_field(first) is shared_field(first)
