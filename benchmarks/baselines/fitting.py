"""Each representation, fitted to traced rays."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.places import Patches, Points
from benchmarks.baselines.sources import Sources, SphereSource, histogram, projected, tabulated
from benchmarks.baselines.traced_rays import TracedRays
from benchmarks.baselines.wavelets import FILTER_WIDTH, BoxCells, WaveletLight, binned, filtered
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import intensity_of_histogram
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.output.point_lights import cluster_points
from lumitree.trace.emitted_rays import RayBatch, seeded_sampler

# About as many bins as a Type C file of 1° has values (181 · 360).
FAR_FIELD_RESOLUTION = 256
# Points that k-means is given to cluster: its time is linear in them.
_CLUSTERED = 1 << 14


def far_field_point(rays: TracedRays) -> Sources:
    """Far field, from a point at the centre: what renderers make of an IES file."""
    index = np.zeros(len(rays.flux), np.int64)
    return Sources(Points(np.zeros((1, 3))), tabulated(rays, index, 1, FAR_FIELD_RESOLUTION))


def far_field_sphere(rays: TracedRays) -> Sources:
    """Far field, from the sphere through the box's corners: each direction from a whole disk."""
    index = np.zeros(len(rays.flux), np.int64)
    radius = float(np.linalg.norm(rays.half_extents))
    return SphereSource(radius, tabulated(rays, index, 1, FAR_FIELD_RESOLUTION))


def point_lights(rays: TracedRays, count: int, resolution: int, seed: int) -> Sources:
    """Anisotropic point lights at the centres of clusters of last vertices.

    The illumination of Velázquez-Armendáriz et al. 2015, as far as its text says how.
    """
    from scipy.spatial import KDTree

    random = np.random.default_rng(SeedStream(Purpose.LIGHT_FIELD, 0, draw=1).seed(seed))
    power = rays.flux.sum(axis=1, dtype=np.float64)
    chosen = random.choice(len(power), _CLUSTERED, p=power / power.sum())
    centres = cluster_points(rays.origin[chosen], count, random)
    index = np.asarray(KDTree(centres).query(rays.origin)[1])
    return Sources(Points(centres), tabulated(rays, index, len(centres), resolution))


def box_table(rays: TracedRays, patches: int, resolution: int) -> Sources:
    """Light field on the box: a table by position on a face and by direction.

    Args:
        patches: along the box's longest side; about square patches on all faces.
        resolution: octahedral bins of direction a side; half of them point into the box and
            remain empty.
    """
    places, index = _patches(rays, patches)
    return Sources(places, tabulated(rays, index, places.count, resolution))


def box_harmonics(rays: TracedRays, patches: int, l_max: int) -> Sources:
    """Light field on the box: spherical harmonics of direction, by position on a face."""
    places, index = _patches(rays, patches)
    return Sources(places, projected(rays, index, l_max, places.normals))


def wavelet_light(
    rays: TracedRays, positions: int, directions: int, num_bytes: float
) -> WaveletLight:
    """Light field on the box, compressed by wavelets: Atanasov and Koylazov 2025, rebuilt.

    Args:
        positions: cells of position along a side of a face.
        directions: cells of direction along a side of the square of a hemisphere.
        num_bytes: of the compressed light field; it holds as many coefficients as fit.
    """
    cells = BoxCells(rays.half_extents, positions, directions)
    return WaveletLight(filtered(binned(rays, cells), FILTER_WIDTH), cells, num_bytes)


def _patches(rays: TracedRays, count: int) -> tuple[Patches, NDArray[np.int64]]:
    """The patches of the box, and the one through which each ray leaves."""
    places = Patches(rays.half_extents, count)
    origin, direction = (
        on_device(kind, values)
        for kind, values in ((mi.Point3f, rays.origin), (mi.Vector3f, rays.direction))
    )
    return places, np.array(places.seen(origin, direction)[0]).astype(np.int64)


class RaySet:
    """Rays chosen by their flux, as a TM-25 file holds them: they can only be traced.

    Args:
        count: number of rays; each carries an equal share of the flux, in the mean colour of the
            ray that it was chosen from.
    """

    def __init__(self, rays: TracedRays, count: int, seed: int) -> None:
        random = np.random.default_rng(SeedStream(Purpose.LIGHT_FIELD, 0, draw=2).seed(seed))
        power = rays.flux.sum(axis=1, dtype=np.float64)
        chosen = random.choice(len(power), count, p=power / power.sum())
        flux = rays.flux[chosen] * (power.sum() / power[chosen] / count)[:, None]
        self._count = count
        self._rays = [
            on_device(mi.Float, values)
            for values in (rays.origin[chosen], rays.direction[chosen], flux)
        ]
        # Nine floats, as in a TM-25 file with tristimulus values.
        self.num_bytes = 36 * count

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`."""
        chosen = seeded_sampler(seed, count).next_1d()
        row = dr.minimum(mi.UInt32(chosen * self._count), self._count - 1)
        origin, direction, flux = (
            dr.gather(kind, values, row)
            for kind, values in zip((mi.Point3f, mi.Vector3f, mi.Color3f), self._rays, strict=True)
        )
        flux *= self._count / count
        dr.eval(origin, direction, flux)
        return RayBatch(origin, direction, flux)

    def sample_direction(self, x: Any, sampler: Any) -> None:
        """A ray meets no receiver."""

    def eval(self, origin: Any, direction: Any) -> None:
        """Nor a line."""


class BakedAsset:
    """An asset of lumitree, with its own sampling.

    Attributes:
        draw: as `EmittedRays.draw`.
        num_bytes: of what is in the asset.
    """

    def __init__(self, asset: Any, num_bytes: int) -> None:
        from lumitree.octree.field import shared_field
        from lumitree.rendering.asset_rays import AssetRays
        from lumitree.rendering.sampling.divided_sampling import emitter_sampler
        from lumitree.rendering.sampling.proxy import BoxProxy

        self._proxy = BoxProxy(asset.frame.half_extents)
        self._sampler = emitter_sampler(asset, shared_field(asset), self._proxy)
        self.draw = AssetRays(asset).draw
        self.num_bytes = num_bytes

    def sample_direction(self, x: Any, sampler: Any) -> tuple[Any, Any]:
        """As `Representation.sample_direction`."""
        direction, target = self._sampler.sample(x, sampler.next_2d())
        distance, _, enters = self._proxy.enter(x, direction)
        entry = x + distance * direction
        radiance, _, pdf = self._sampler.eval(x, entry, direction, distance, enters, target)
        return direction, radiance * dr.select(pdf > 0, dr.rcp(pdf), 0)

    def eval(self, origin: Any, direction: Any) -> Any:
        """As `Representation.eval`."""
        return self._sampler.look(origin, -direction, True)[0]


def light_field(rays: TracedRays, depth: int, resolution: int) -> BakedAsset:
    """lumitree's light field, of the same rays."""
    from lumitree.asset.asset import light_field_asset
    from lumitree.asset.light_field import make_light_field

    side = 1 << depth
    cell = np.clip(((rays.origin + 1) * (side / 2)).astype(np.int64), 0, side - 1)
    key = (cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    intensity = intensity_of_histogram(histogram(rays, index, len(first), resolution))
    field = make_light_field(cell[first], intensity, depth)
    asset = light_field_asset(field, LocalFrame(rays.half_extents, np.eye(4)), "light")
    return BakedAsset(asset, field.num_bytes)


def baked_field(luminaire: str, seed: int) -> BakedAsset:
    """lumitree's field, by an octree fit at its default quality: without light field."""
    import tempfile

    import lumitree

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "field.lumitree"
        lumitree.bake(
            luminaire,
            file,
            lumitree.BakeConfig(parts=("field",), irradiance_paths=0, seed=seed),
            progress=None,
        )
        return BakedAsset(lumitree.load(file), file.stat().st_size)
