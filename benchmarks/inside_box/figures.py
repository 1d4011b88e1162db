"""Errors of irradiance on patches, without the noise of either side.

Symbols
    r   reference: independent batches
    m   baked irradiance: two bakes, each with two independent sets of samples
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from benchmarks.inside_box.patches import Floats

# Farther from the lamp's surfaces, local units, patches are "far".
FAR = 0.1
# Patches from where fewer rays leave the lamp are in closed parts of it, and do not count.
_OPEN = 0.01
# Patches in shadow, as a part of the brightest ones, which are this quantile of the reference.
_SHADOW, _BRIGHTEST = 0.01, 0.99
_MIN_SHADOW_PATCHES = 4
# Part of the reference's mean square that must not be noise.
_MIN_SIGNAL = 0.5


@dataclasses.dataclass(frozen=True)
class PatchErrors:
    """Baked over reference, on the patches of a kind.

    Attributes:
        patches: their number.
        ratio, ratio_error: of the means, and the standard error by the noise of both.
        rms, rms_error: root mean square difference over the root mean square of the reference,
            without the noise of either side, and what a standard error of its square adds to it,
            by the spread over the patches. A difference below the noise counts as 0.
        rms_of_one: the same with the noise of the light paths of one bake.
    """

    patches: int
    ratio: float
    ratio_error: float
    rms: float
    rms_error: float
    rms_of_one: float


def masks(distance: Floats, leaving: Floats) -> dict[str, NDArray[np.bool_]]:
    """Patches [P, P] by kind, from what `patches.surroundings` returns."""
    counts = leaving >= _OPEN
    return {
        "far": counts & (distance > FAR),
        "near": counts & (distance <= FAR),
        "all": counts,
    }


def patch_errors(baked: Floats, reference: Floats, mask: NDArray[np.bool_]) -> PatchErrors | None:
    """Errors on the patches of a mask.

    Args:
        baked: [2, 2, P, P] by bake and set of samples.
        reference: [B, P, P] batches, an even number.
        mask: [P, P].

    Returns:
        None if there are no such patches, or most of the reference is noise.
    """
    m, r = baked[..., mask], reference[:, mask]
    if not r.any() or _signal(r) < _MIN_SIGNAL * (r.mean(axis=0) ** 2).mean():
        return None
    # Halves that share no random numbers: the mean of products of their differences has no noise.
    first, second = r[0::2].mean(axis=0), r[1::2].mean(axis=0)
    of_two = (m[0].mean(axis=0) - first) * (m[1].mean(axis=0) - second)
    of_one = np.mean([(one[0] - first) * (one[1] - second) for one in m], axis=0)
    square, norm = max(float(of_two.mean()), 0.0), _signal(r)
    square_error = of_two.std() / np.sqrt(of_two.size)
    sets, batches = m.mean(axis=-1).ravel(), r.mean(axis=-1)
    relative = [each.std(ddof=1) / np.sqrt(each.size) / batches.mean() for each in (sets, batches)]
    return PatchErrors(
        patches=int(mask.sum()),
        ratio=float(sets.mean() / batches.mean()),
        ratio_error=float(np.hypot(*relative)),
        rms=float(np.sqrt(square / norm)),
        rms_error=float((np.sqrt(square + square_error) - np.sqrt(square)) / np.sqrt(norm)),
        rms_of_one=float(np.sqrt(max(float(of_one.mean()), 0.0) / norm)),
    )


def _signal(r: Floats) -> float:
    """Mean square [B, N] over patches, without noise."""
    return float((r[0::2].mean(axis=0) * r[1::2].mean(axis=0)).mean())


def over_planes(errors: list[PatchErrors]) -> dict[str, float] | None:
    """Mean ratio and root mean square of the relative RMS of several planes."""
    if not errors:
        return None
    return {
        "ratio": float(np.mean([each.ratio for each in errors])),
        "rms": float(np.sqrt(np.mean([each.rms**2 for each in errors]))),
        "rms_of_one": float(np.sqrt(np.mean([each.rms_of_one**2 for each in errors]))),
    }


def shadow(baked: Floats, reference: Floats) -> dict[str, float] | None:
    """Light in the darkest patches of a plane, over the light in its brightest.

    Args:
        baked: [P, P].
        reference: [P, P].

    Returns:
        Means over the patches in shadow of both, and the baked one's 95th percentile; None if no
        patches are in shadow.
    """
    brightest = float(np.quantile(reference, _BRIGHTEST))
    dark = reference <= _SHADOW * brightest
    if dark.sum() < _MIN_SHADOW_PATCHES:
        return None
    return {
        "patches": int(dark.sum()),
        "reference": float(reference[dark].mean() / brightest),
        "baked": float(baked[dark].mean() / brightest),
        "baked_95": float(np.quantile(baked[dark], 0.95) / brightest),
    }
