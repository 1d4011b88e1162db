"""Light fields of one luminaire, from different light paths, combined into one.

Symbols
    Q, K, I, J, s, V, κ     as in `lumitree.asset.light_inside`
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.light_field import LightField, TracedPaths, make_light_field, unpack
from lumitree.asset.light_inside import LightInside
from lumitree.asset.lit_bins import by_coarse_bin, dense
from lumitree.core.octahedral import coarse_solid_angles, solid_angles
from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeError
from lumitree.fit.light_field.inside import DISTANCES, make_entries
from lumitree.octree.build import morton
from lumitree.trace.histograms import cell_codes, coded_cells


def merge_light_fields(fields: Sequence[LightField], names: Sequence[str]) -> LightField:
    """The estimate from all light paths of several fields: their mean, weighted by path counts.

    It differs from one longer bake only by the rounding of stored intensities, at most 0.2 % of
    the largest channel of each bin, in each field and in the result; and by the curves of light
    inside the box, which are found anew. If a field lacks that light, so does the result.

    Args:
        fields: at least two, of one luminaire, with grids and bins of the same numbers.
        names: what they are called in messages.

    Raises:
        LumitreeError: they are of different luminaires, grids or numbers of bins; two have a
            seed in common; or one does not state its light paths.
    """
    records = _check(fields, names)
    counts = np.array([record.count for record in records], np.float64)
    depth, resolution = fields[0].depth, fields[0].resolution
    codes = [cell_codes(field.cells, depth) for field in fields]
    occupied = np.unique(np.concatenate(codes))
    intensity = np.zeros((len(occupied), resolution**2, 3))
    by_direction = []
    for field, code, weight in zip(fields, codes, counts / counts.sum(), strict=True):
        colours = field.scale * unpack(field.intensity)
        dense = np.stack([field.dense(channel) for channel in colours.T], axis=-1)
        intensity[np.searchsorted(occupied, code)] += weight * dense
        by_direction.append(luminance(dense.sum(axis=0)))
    cells = coded_cells(occupied, depth)
    traced = TracedPaths(
        count=sum(record.count for record in records),
        seeds=tuple(sorted(seed for record in records for seed in record.seeds)),
        luminaire=records[0].luminaire,
        noise=relative_noise(by_direction, counts),
    )
    merged = make_light_field(cells, intensity, depth, traced)
    if any(field.inside is None for field in fields):
        return merged
    return dataclasses.replace(merged, inside=_merged_inside(merged, fields, counts))


def _merged_inside(
    merged: LightField, fields: Sequence[LightField], counts: NDArray[np.float64]
) -> LightInside:
    """Light inside the box of several fields, weighted by path counts.

    J s is averaged. From the curves of κ follow the means of (I + J) V, which are averaged too.
    """
    depth, coarse = merged.depth, merged.resolution // 2
    parts = [_expanded(field) for field in fields]
    codes = [cell_codes(part.cells, depth) for part in parts]
    occupied = np.unique(np.concatenate(codes))
    bins, points = coarse**2, len(DISTANCES)
    flux = np.zeros((len(occupied), bins, 3))
    beyond, free = np.zeros((2, len(occupied), bins, points), np.float32)
    for part, code, weight in zip(parts, codes, counts / counts.sum(), strict=True):
        rows = np.searchsorted(occupied, code)
        flux[rows] += weight * part.flux
        beyond[rows] += np.float32(weight) * part.beyond
        free[rows] += np.float32(weight) * part.free
    cells = coded_cells(occupied, depth)
    entries = make_entries(merged, cells, flux, -np.diff(beyond, axis=2))
    assert merged.traced is not None
    seed = merged.traced.seeds[0]
    reach, curves = entries.reach(seed)
    codes_of_entries = cell_codes(entries.cells[entries.rows], depth)
    unoccluded = free[np.searchsorted(occupied, codes_of_entries), entries.bins]
    return entries.encoded(reach, curves, unoccluded, seed)


@dataclasses.dataclass(frozen=True)
class _Expanded:
    """Light inside the box of one field, by cell [C] and bin [Q²].

    Attributes:
        cells: [C, 3].
        flux: [C, Q², 3] of J.
        beyond: [C, Q², K] luminous flux of J s.
        free: [C, Q², K] luminous flux of (I + J) V.
    """

    cells: NDArray[np.uint8]
    flux: NDArray[np.float64]
    beyond: NDArray[np.float32]
    free: NDArray[np.float32]


def _expanded(field: LightField) -> _Expanded:
    inside = field.inside
    assert inside is not None
    if not np.array_equal(inside.distances, DISTANCES):
        raise LumitreeError(
            "the light inside the box is stated for other distances than this lumitree's; bake it "
            "again"
        )
    bins = (field.resolution // 2) ** 2
    flux = dense(inside.lit, bins, inside.scale * unpack(inside.intensity))
    flux *= coarse_solid_angles(field.resolution)[:, None]
    reach = dense(inside.lit, bins, inside.reach_curves[inside.reach])
    beyond = luminance(flux).astype(np.float32)[..., None] * reach
    exits = field.dense(luminance(field.scale * unpack(field.intensity)))
    leaving = by_coarse_bin(exits * solid_angles(field.resolution)).sum(axis=2)
    rows = np.searchsorted(morton(inside.cells), morton(field.cells))
    everything = beyond.copy()
    everything[rows] += leaving[..., None].astype(np.float32)
    factor = dense(inside.lit, bins, inside.visibility_curves[inside.visibility])
    free = np.divide(everything, factor, out=np.zeros_like(factor), where=factor > 0)
    return _Expanded(inside.cells, flux, beyond, free)


def relative_noise(estimates: ArrayLike, counts: ArrayLike) -> float | None:
    """Relative standard error of the mean of independent estimates, from their spread.

    With estimates I_k from N_k paths, N = Σ N_k and Ī = Σ N_k I_k / N, the variance of Ī in a bin
    is estimated by Σ N_k (I_k - Ī)² / (N (K - 1)).

    Args:
        estimates: [K, R²] luminous intensity in each bin of direction.
        counts: [K] number of light paths of each.

    Returns:
        Root mean square of the standard error over that of Ī, both over the sphere. None for K = 1
        and for estimates without light.
    """
    estimates, counts = np.asarray(estimates, np.float64), np.asarray(counts, np.float64)
    solid_angle = solid_angles(round(estimates.shape[1] ** 0.5))
    weights = (counts / counts.sum())[:, None]
    mean = (weights * estimates).sum(axis=0)
    light = (solid_angle * mean**2).sum()
    if len(estimates) < 2 or not light > 0:
        return None
    variance = (weights * (estimates - mean) ** 2).sum(axis=0) / (len(estimates) - 1)
    return float(np.sqrt((solid_angle * variance).sum() / light))


def _check(fields: Sequence[LightField], names: Sequence[str]) -> list[TracedPaths]:
    """Records of the light paths of fields that can be merged."""
    records: list[TracedPaths] = []
    owners: dict[int, str] = {}
    for field, name in zip(fields, names, strict=True):
        if (record := field.traced) is None:
            raise LumitreeError(
                f"{name} does not state the light paths of its light field; bake it again"
            )
        if (field.depth, field.resolution) != (fields[0].depth, fields[0].resolution):
            raise LumitreeError(
                f"{names[0]} has {_grid(fields[0])}, {name} {_grid(field)}; expected the same: "
                "bake them with the same settings"
            )
        if records and record.luminaire != records[0].luminaire:
            raise LumitreeError(
                f"{names[0]} and {name} were baked from different luminaires; expected the same"
            )
        for seed in record.seeds:
            if seed in owners:
                raise LumitreeError(
                    f"{owners[seed]} and {name} have light paths of the same seed {seed}; expected "
                    "different seeds: bake one of them with another"
                )
            owners[seed] = name
        records.append(record)
    return records


def _grid(field: LightField) -> str:
    return f"{1 << field.depth} cells and {field.resolution} bins a side"
