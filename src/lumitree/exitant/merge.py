"""Exitant light fields of one luminaire, from different light paths, combined into one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lumitree.asset.exitant import ExitantField, TracedPaths, make_exitant_field, unpack
from lumitree.core.octahedral import solid_angles
from lumitree.errors import LumitreeError
from lumitree.model.photometry import luminance


def merge_exitant(fields: Sequence[ExitantField], names: Sequence[str]) -> ExitantField:
    """The estimate from all light paths of several fields: their mean, weighted by path counts.

    It differs from one longer bake only by the rounding of stored intensities, at most 0.2 % of
    the largest channel of each bin, in each field and in the result.

    Args:
        fields: at least two, of one luminaire, with grids and bins of the same numbers.
        names: what they are called in messages.

    Raises:
        LumitreeError: they are of different luminaires, grids or numbers of bins; two have a
            seed in common; or one does not state its light paths.
    """
    records = _check(fields, names)
    counts = np.array([record.count for record in records], np.float64)
    side, resolution = 1 << fields[0].depth, fields[0].resolution
    codes = [field.cells.astype(np.int64) @ [1, side, side**2] for field in fields]
    occupied = np.unique(np.concatenate(codes))
    intensity = np.zeros((len(occupied), resolution**2, 3))
    by_direction = []
    for field, code, weight in zip(fields, codes, counts / counts.sum(), strict=True):
        colours = field.scale * unpack(field.intensity)
        dense = np.stack([field.dense(channel) for channel in colours.T], axis=-1)
        intensity[np.searchsorted(occupied, code)] += weight * dense
        by_direction.append(luminance(dense.sum(axis=0)))
    cells = np.stack([occupied % side, occupied // side % side, occupied // side**2], axis=1)
    traced = TracedPaths(
        count=sum(record.count for record in records),
        seeds=tuple(sorted(seed for record in records for seed in record.seeds)),
        luminaire=records[0].luminaire,
        noise=relative_noise(by_direction, counts),
    )
    return make_exitant_field(cells, intensity, fields[0].depth, traced)


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


def _check(fields: Sequence[ExitantField], names: Sequence[str]) -> list[TracedPaths]:
    """Records of the light paths of fields that can be merged."""
    records: list[TracedPaths] = []
    owners: dict[int, str] = {}
    for field, name in zip(fields, names, strict=True):
        if (record := field.traced) is None:
            raise LumitreeError(
                f"{name} does not state the light paths of its exitant light field; bake it again"
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


def _grid(field: ExitantField) -> str:
    return f"{1 << field.depth} cells and {field.resolution} bins a side"
