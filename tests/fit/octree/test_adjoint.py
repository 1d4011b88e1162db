"""The adjoint of the field's integral: gradients against finite differences, and sums by weight."""

import types
from typing import Any

import numpy as np
import pytest

from lumitree.core.device import on_device
from support import reference_field as reference
from support.field_rays import NUM_RAYS, rays_on_device, targeted_rays
from support.fields import leaf_field, make_asset, random_asset
from support.slow import slow


def by_depth(field, through, d_through):
    """Derivatives by optical depth, from those by transmittance."""
    slope = through if field.law == "exponential" else through > 0
    return -np.asarray(d_through) * slope


def unpadded(field, coefficients):
    """Coefficients [M, 3 K] without their padding."""
    count = 3 * (field.l_max + 1) ** 2
    return np.array(coefficients).reshape(field.num_leaves, field.width)[:, :count]


def both_gradients(mi, field, origins, directions, d_radiance, d_depth):
    """Gradients by log density [M] and coefficients [M, 3 K]."""
    from lumitree.fit.octree.leaf_field import gradients

    o, d = rays_on_device(mi, origins, directions)
    integrated = field.integrate(o, d)
    density, coefficients = gradients(
        field,
        o,
        d,
        integrated,
        on_device(mi.Color3f, d_radiance),
        on_device(mi.Float, d_depth),
    )
    return np.array(density), unpadded(field, coefficients)


class ReferenceField:
    """The same field in double precision, by the reference implementation; `max_radiance` 1."""

    def __init__(self, asset, origins, directions, monkeypatch):
        boxes = reference.leaf_boxes(asset)
        monkeypatch.setattr(reference, "leaf_boxes", lambda _: boxes)
        self._asset, self._rays = asset, list(zip(origins, directions, strict=True))
        self.log_density = np.log(asset.density.astype(float))
        self.coefficients = asset.coefficients.astype(float)

    def integrate(self):
        asset: Any = types.SimpleNamespace(
            frame=self._asset.frame,
            l_max=self._asset.l_max,
            law=self._asset.law,
            max_radiance=1.0,
            light_factors=(1.0, 1.0, 1.0),
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
@pytest.mark.parametrize("l_max", [slow(0), 1, slow(2)])
def test_adjoint_is_the_derivative(mi, law, l_max, monkeypatch):
    from lumitree.fit.octree.leaf_field import depth_gradient

    density_scale = {"linear": 1.0, "exponential": 1.5}[law]

    asset = random_asset(
        40 + l_max,
        tree_depth=2,
        l_max=l_max,
        law=law,
        density_scale=density_scale,
        max_radiance=1.0,
    )
    origins, directions = targeted_rays(l_max)
    random = np.random.default_rng(l_max)
    d_radiance = random.normal(size=(NUM_RAYS, 3))
    d_through = random.normal(size=NUM_RAYS)
    exact = ReferenceField(asset, origins, directions, monkeypatch)
    through = exact.integrate()[1]
    if law == "linear":
        assert (through == 0).any()
    assert ((through > 0.01) & (through < 0.99)).any()

    field = leaf_field(asset)
    d_depth = by_depth(field, through, d_through)
    density, coefficients = both_gradients(mi, field, origins, directions, d_radiance, d_depth)
    # The same by the traversal for opacity alone.
    device = rays_on_device(mi, origins, directions)
    alone = depth_gradient(field, *device, on_device(mi.Float, d_depth))
    assert np.array(alone) == pytest.approx(
        exact.gradient(exact.log_density, 0 * d_radiance, d_through), abs=2e-3
    )
    assert np.array(field.through(*device)) == pytest.approx(through, abs=1.2e-3)
    by_density = exact.gradient(exact.log_density, d_radiance, d_through)
    by_coefficients = exact.gradient(exact.coefficients, d_radiance, d_through)
    # Weights below 1e-4 are left out, and so is what is behind a transmittance of 1e-3.
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
    density, _ = both_gradients(mi, field, *ALONG_X, [[0, 0, 0]], [0.7])
    assert density == pytest.approx([0.7 * 0.4, 0.7 * 0.9, 0, 0], rel=1e-5)


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_leaves_too_thin_to_be_visible_have_the_right_gradient(mi, law):
    """Adam follows the sign of a gradient, however small: it must be right."""
    depth = np.array([1e-5, 0.3])
    field = leaf_field(column(depth, [0.01, 0.2], law))
    density, _ = both_gradients(mi, field, *ALONG_X, [[1, 1, 1]], [0])
    behind = {"linear": 0.0, "exponential": 0.2 * (1 - np.exp(-0.3))}[law]
    assert density[0] == pytest.approx(3 * depth[0] * (0.01 - behind), rel=1e-2)


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("density", [[0.3, 0.5, 0.2, 0.1], [0.6, 1.0, 1.8, 20.0]])
def test_values_are_accumulated_by_weight(mi, law, density):
    """Values of several rays are summed; a leaf behind an opaque one has no weight."""
    from lumitree.fit.octree.leaf_field import accumulate_by_weight

    field = leaf_field(column(density, [0.5] * 4, law))
    origins, directions = (np.repeat(values, 2, axis=0) for values in ALONG_X)
    total = accumulate_by_weight(
        field, *rays_on_device(mi, origins, directions), mi.Float([3.0, -1.0])
    )
    tau = np.concatenate([[0], np.cumsum(np.array(density) / 2)])
    through = np.maximum(1 - tau, 0) if law == "linear" else np.exp(-tau)
    expected = 2 * -np.diff(through)
    assert np.array(total) == pytest.approx(expected, rel=1e-4)
    # One value for all rays.
    total = accumulate_by_weight(field, *rays_on_device(mi, origins, directions), mi.Float(1.0))
    assert np.array(total) == pytest.approx(expected, rel=1e-4)
