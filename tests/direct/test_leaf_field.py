"""The trainable field: its integral against its twins, its adjoint against finite differences."""

import types

import numpy as np
import pytest

from fields import leaf_field, make_asset, random_asset
from lumitree.rendering import reference

NUM_RAYS = 16


def random_rays(seed):
    """Origins and directions [16, 3]; every fourth ray is parallel to an axis, off the planes."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(NUM_RAYS, 3))
    targets = random.uniform(-0.8, 0.8, (NUM_RAYS, 3))
    for i in range(0, NUM_RAYS, 4):
        directions[i] = 0
        directions[i, i // 4 % 3] = random.choice([-1.0, 1.0])
        targets[i] = (random.integers(-16, 16, 3) + 0.5) / 16
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (targets - 3 * directions).astype(np.float32), directions.astype(np.float32)


def on_device(mi, origins, directions):
    return mi.Point3f(*origins.T), mi.Vector3f(*directions.T)


def by_depth(field, through, d_through):
    """Derivative by optical depth of what is derived by transmittance."""
    slope = through if field.law == "exponential" else through > 0
    return -np.asarray(d_through) * slope


def unpadded(field, coefficients):
    """[M, 3 K] of what lies padded."""
    count = 3 * (field.l_max + 1) ** 2
    return np.array(coefficients).reshape(field.num_leaves, field.width)[:, :count]


def adjoint(mi, field, origins, directions, d_radiance, d_depth):
    """Gradients by log density [M] and coefficients [M, 3 K]."""

    o, d = on_device(mi, origins, directions)
    integrated = field.integrate(o, d)
    density, coefficients = field.gradients(
        o,
        d,
        integrated,
        mi.Color3f(*np.asarray(d_radiance, np.float32).T),
        mi.Float(np.asarray(d_depth, np.float32)),
    )
    return np.array(density), unpadded(field, coefficients)


class Twin:
    """The same field in double precision, by the slow reference; `max_radiance` 1."""

    def __init__(self, asset, origins, directions, monkeypatch):
        boxes = reference.leaf_boxes(asset)
        monkeypatch.setattr(reference, "leaf_boxes", lambda _: boxes)
        self._asset, self._rays = asset, list(zip(origins, directions, strict=True))
        self.log_density = np.log(asset.density.astype(float))
        self.coefficients = asset.coefficients.astype(float)

    def integrate(self):
        asset = types.SimpleNamespace(
            half_extents=self._asset.half_extents,
            l_max=self._asset.l_max,
            law=self._asset.law,
            max_radiance=1.0,
            density=np.exp(self.log_density),
            coefficients=self.coefficients,
        )
        rays = [
            reference.integrate_ray(asset, o.astype(float), d.astype(float)) for o, d in self._rays
        ]
        return np.array([ray[0] for ray in rays]), np.array([ray[1] for ray in rays])

    def gradient(self, values, d_radiance, d_through, step=1e-5):
        """Central differences of sum(dL · L) + sum(dT T) by every element of `values`."""
        result = np.zeros(values.size)
        flat = values.reshape(-1)
        for i in range(values.size):
            losses = []
            for sign in (1, -1):
                before = flat[i]
                flat[i] = before + sign * step
                radiance, through = self.integrate()
                losses.append((d_radiance * radiance).sum() + (d_through * through).sum())
                flat[i] = before
            result[i] = (losses[0] - losses[1]) / (2 * step)
        return result


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("l_max", [0, 1, 2])
def test_adjoint_is_the_derivative(mi, law, l_max, monkeypatch):
    density_scale = {"linear": 1.0, "exponential": 1.5}[law]

    asset = random_asset(
        40 + l_max, tree_depth=2, l_max=l_max, law=law, density_scale=density_scale, max_radiance=1
    )
    origins, directions = random_rays(l_max)
    random = np.random.default_rng(l_max)
    d_radiance = random.normal(size=(NUM_RAYS, 3))
    d_through = random.normal(size=NUM_RAYS)
    twin = Twin(asset, origins, directions, monkeypatch)
    through = twin.integrate()[1]
    if law == "linear":
        assert (through == 0).any()
    assert ((through > 0.01) & (through < 0.99)).any()

    field = leaf_field(asset)
    d_depth = by_depth(field, through, d_through)
    density, coefficients = adjoint(mi, field, origins, directions, d_radiance, d_depth)
    # The same by the walk for opacity alone.
    device = on_device(mi, origins, directions)
    alone = field.depth_gradient(*device, mi.Float(d_depth.astype(np.float32)))
    assert np.array(alone) == pytest.approx(
        twin.gradient(twin.log_density, 0 * d_radiance, d_through), abs=2e-3
    )
    assert np.array(field.through(*device)) == pytest.approx(through, abs=1.2e-3)
    by_density = twin.gradient(twin.log_density, d_radiance, d_through)
    by_coefficients = twin.gradient(twin.coefficients, d_radiance, d_through)
    # Light below the thresholds (1e-4 of a leaf, 1e-3 of an opaque ray) is left out.
    tolerance = {"linear": 5e-4, "exponential": 2e-3}[law]
    assert density == pytest.approx(by_density, abs=tolerance)
    assert coefficients.ravel() == pytest.approx(by_coefficients, abs=tolerance)
    assert np.abs(by_density).max() > 0.1
    assert np.abs(by_coefficients).max() > 0.01


def column(density, radiance, law):
    """Asset of one layer of cells along +x, with densities and radiances (of 1) front to back."""
    count = len(density)
    level = int(np.log2(count))
    cells = [(x, 0, 0) for x in range(count)]
    logit = np.log(radiance) - np.log1p(-np.asarray(radiance))
    coefficients = np.repeat(logit[:, None, None], 3, axis=1) / 0.28209479177387814
    return make_asset(
        cells,
        np.full(count, level),
        density,
        coefficients,
        tree_depth=level,
        law=law,
        max_radiance=1.0,
    )


ALONG_X = np.array([[-2, -0.9, -0.9]], np.float32), np.array([[1, 0, 0]], np.float32)


def test_what_is_hidden_behind_saturation_gets_no_gradient(mi):
    """Cells of optical depth 0.4, 0.9, 0.5: the second saturates the ray, the third is hidden."""
    depth = np.array([0.4, 0.9, 0.5, 0.1])
    field = leaf_field(column(2 * depth, [0.5, 0.5, 0.5, 0.5], "linear"))
    density, _ = adjoint(mi, field, *ALONG_X, [[0, 0, 0]], [0.7])
    assert density == pytest.approx([0.7 * 0.4, 0.7 * 0.9, 0, 0], rel=1e-5)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_leaves_too_thin_to_be_seen_still_know_their_emission(mi, law):
    """Adam sees the sign of a gradient, however small: it must be that of the true one."""
    depth = np.array([1e-5, 0.3])
    field = leaf_field(column(depth, [0.01, 0.2], law))
    density, _ = adjoint(mi, field, *ALONG_X, [[1, 1, 1]], [0])
    behind = {"linear": 0.0, "exponential": 0.2 * (1 - np.exp(-0.3))}[law]
    assert density[0] == pytest.approx(3 * depth[0] * (0.01 - behind), rel=1e-2)


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("density", [[0.3, 0.5, 0.2, 0.1], [0.6, 1.0, 1.8, 20.0]])
def test_a_value_is_shared_out_by_weight(mi, law, density):
    """Of several rays, and added to what is there; what is behind an opaque leaf gets nothing."""
    field = leaf_field(column(density, [0.5] * 4, law))
    origins, directions = (np.repeat(values, 2, axis=0) for values in ALONG_X)
    total = field.share_out(*on_device(mi, origins, directions), mi.Float([3.0, -1.0]))
    tau = np.concatenate([[0], np.cumsum(np.array(density) / 2)])
    through = np.maximum(1 - tau, 0) if law == "linear" else np.exp(-tau)
    expected = 2 * -np.diff(through)
    assert np.array(total) == pytest.approx(expected, rel=1e-4)
    # One value for all rays.
    total = field.share_out(*on_device(mi, origins, directions), mi.Float(1.0))
    assert np.array(total) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_integral_agrees_with_renderer_and_reference(mi, law, seed):
    from lumitree.octree.field import Field

    half = np.array([1.0, 0.61, 0.37]) if seed == 1 else np.ones(3)
    asset = random_asset(seed, l_max=seed - 1, law=law, density_scale=0.7, half_extents=half)
    origins, directions = random_rays(seed)
    o, d = on_device(mi, origins, directions)
    radiance, through, _ = (np.array(value).T for value in leaf_field(asset).integrate(o, d))
    rendered, rendered_through = (np.array(value).T for value in Field(asset).emission(o, d))
    # Each leaf that shows less than 1e-4 of itself is left out; a ray meets few of them.
    assert radiance == pytest.approx(rendered / asset.max_radiance, abs=1e-3)
    assert through == pytest.approx(rendered_through, abs=1e-6)
    for i in range(NUM_RAYS):
        expected, expected_through = reference.integrate_ray(
            asset, origins[i].astype(float), directions[i].astype(float)
        )
        assert radiance[i] == pytest.approx(expected / asset.max_radiance, abs=2e-3)
        assert through[i] == pytest.approx(expected_through, abs=1.2e-3)


def test_meets_tells_lines_that_cross_a_leaf(mi):
    asset = random_asset(9, tree_depth=3)
    lower, upper = reference.leaf_boxes(asset)
    random = np.random.default_rng(9)
    directions = random.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = random.uniform(-1.5, 1.5, (400, 3))
    first = (lower - origins[:, None]) / directions[:, None]
    second = (upper - origins[:, None]) / directions[:, None]
    length = np.maximum(first, second).min(axis=2) - np.minimum(first, second).max(axis=2)
    # Lines that graze an edge may go either way in single precision.
    clear = np.abs(length.max(axis=1)) > 1e-4
    expected = length.max(axis=1) > 0
    met = np.array(leaf_field(asset).meets(*on_device(mi, origins, directions)))
    assert (met == expected)[clear].all()
    assert 0.05 < expected[clear].mean() < 0.95


def test_find_leaf_is_the_leaf_whose_box_holds_the_point(mi):
    asset = random_asset(11, tree_depth=3)
    lower, upper = reference.leaf_boxes(asset)
    random = np.random.default_rng(11)
    points = random.uniform(-1.2, 1.2, (2000, 3)).astype(np.float32)
    # Corners belong to the leaf above them, as intervals are half open.
    points = np.concatenate([points, lower, [[0, -1.0001, 0]]]).astype(np.float32)
    holds = ((points[:, None] >= lower) & (points[:, None] < upper)).all(axis=2)
    holds &= (np.abs(points) <= asset.half_extents).all(axis=1, keepdims=True)
    leaf, found = (
        np.array(value) for value in leaf_field(asset).octree.find_leaf(mi.Point3f(*points.T))
    )
    assert np.array_equal(found, holds.any(axis=1))
    assert np.array_equal(leaf[found], holds.argmax(axis=1)[found])
    assert 0 < found.sum() < len(points)


def test_what_lies_on_the_border_is_found_within(mi):
    """Give or take a rounding, whether or not the border is one of the cells."""
    half = np.array([1, 0.5, 0.4])
    cells = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), -1).reshape(-1, 3)
    asset = make_asset(
        cells, np.full(512, 3), np.ones(512), np.zeros((512, 3, 1)), half_extents=half
    )
    octree = leaf_field(asset).octree
    for axis in range(3):
        for side in (-1, 1):
            # Within, about the border, and beyond.
            points = np.full((5, 3), 0.1, np.float32)
            points[:, axis] = side * (half[axis] + np.array([-0.01, -1e-6, 0, 1e-6, 1e-3]))
            leaf, found = octree.find_leaf(mi.Point3f(*points.T))
            assert np.array(found).tolist() == [True] * 4 + [False]
            assert (np.array(leaf)[:4] == np.array(leaf)[0]).all()


def test_find_leaf_leaves_masked_points_alone(mi):
    asset = random_asset(11, tree_depth=3)
    centre = reference.leaf_boxes(asset)[0][:2] + 1e-3
    octree = leaf_field(asset).octree
    _, found = octree.find_leaf(mi.Point3f(*centre.T), mi.Bool([True, False]))
    assert np.array(found).tolist() == [True, False]


def neighbours(asset):
    """Leaf [M, 6] across the middle of each face, -1 where there is none: the slow twin."""
    lower, upper = reference.leaf_boxes(asset)
    finest = 2.0 ** (1 - asset.tree_depth)
    found = np.full((len(lower), 6), -1)
    for i in range(len(lower)):
        for face in range(6):
            axis, above = divmod(face, 2)
            # The finest cell that touches the middle from beyond, and above.
            point = (lower[i] + upper[i] + finest) / 2
            if (upper - lower)[i, 0] == finest:
                point = (lower[i] + upper[i]) / 2
            point[axis] = (upper[i] if above else lower[i])[axis] + (above - 0.5) * finest
            holds = np.flatnonzero(((point > lower) & (point < upper)).all(axis=1))
            if len(holds):
                found[i, face] = holds[0]
    return found


def test_neighbours_are_the_leaves_beyond_the_faces(mi):
    asset = random_asset(12, tree_depth=3)
    expected = neighbours(asset)
    for face, (leaf, there) in enumerate(leaf_field(asset).neighbours):
        leaf, there = np.array(leaf), np.array(there)
        assert np.array_equal(there, expected[:, face] >= 0)
        assert np.array_equal(leaf[there], expected[there, face])
    assert 0.1 < (expected >= 0).mean() < 0.9


@pytest.mark.parametrize("l_max", [0, 1, 2])
def test_smoothing_draws_leaves_to_the_mean_of_their_neighbours(mi, l_max):
    """A leaf that has none stays as it is."""
    asset = random_asset(12, tree_depth=3, l_max=l_max)
    index = neighbours(asset)
    there = index >= 0
    field = leaf_field(asset)
    before = field.coefficient_array()
    field.smooth(0.3)
    mean = np.where(there[..., None, None], before[index], 0).sum(axis=1)
    mean /= np.maximum(there.sum(axis=1), 1)[:, None, None]
    alone = ~there.any(axis=1)
    expected = np.where(alone[:, None, None], before, 0.7 * before + 0.3 * mean)
    assert field.coefficient_array() == pytest.approx(expected, abs=1e-5)
    assert np.abs(field.coefficient_array() - before).max() > 0.1
