"""Detection of glass that Mitsuba renders wrongly: nested, touching, inside out, or not closed.

Mitsuba does not track which media a path is inside of. Each dielectric surface defines the indices
of refraction on its two sides. Solid glass must therefore be closed, and no two bodies may overlap
or touch.

The check computes all crossings of straight lines, along three directions, with the dielectric
shapes. Definitions, for one crossing of a line with a surface:

    step      +1 where the line enters the denser side, -1 where it leaves it
    depth     sum of the steps so far; in correct geometry 0 outside of glass and 1 inside
"""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeWarning
from lumitree.lamp.glass_crossings import Crossings, trace_lines
from lumitree.lamp.luminaire import Luminaire

# Largest number of lines whose crossings are examined one by one.
_MAX_EXAMINED = 2000
# Smallest cosine between the normals of surfaces that touch.
_PARALLEL = 0.9
# Two surfaces that touch in a smaller fraction of a shape's crossings only share a sharp edge.
_MIN_SHARE = 0.01
# Largest number of warnings per luminaire.
_MAX_WARNED = 5


def warn_of_faults(luminaire: Luminaire) -> list[str]:
    """Warn of glass that cannot be rendered correctly; returns one line per fault."""
    faults = diagnose(luminaire.scene)
    for fault in faults[:_MAX_WARNED]:
        warnings.warn(f"{luminaire.name}: {fault}", LumitreeWarning, stacklevel=3)
    if len(faults) > _MAX_WARNED:
        more = f"{luminaire.name}: {len(faults) - _MAX_WARNED} more faults of this kind"
        warnings.warn(more, LumitreeWarning, stacklevel=3)
    return faults


def diagnose(scene: Any) -> list[str]:
    """Faults of a scene's glass.

    A fault that is smaller than the spacing of the lines (1/256 of the extent of the glass) may be
    missed. Instances and shapes behind null surfaces are not examined.

    Args:
        scene: mi.Scene.

    Returns:
        One line of text for each fault; empty if none was found.
    """
    shapes = [shape for shape in scene.shapes() if _is_dielectric(shape)]
    if not shapes:
        return []
    names = [_name(shape) for shape in shapes]
    crossings = trace_lines(shapes)
    open_shapes = _open_shapes(crossings, len(shapes))
    closed = crossings.take(~np.isin(crossings.shape, open_shapes))
    messages = [
        f"{names[index]} is a dielectric, but not closed: lines that enter it never leave; close "
        "it, or make it a thindielectric if it is a single sheet"
        for index in open_shapes
    ]
    touching = _touching(closed)
    messages += [
        f"surfaces of {_pair(names, pair)} touch, or are closer than the offset of Mitsuba's rays: "
        "paths will miss one of them; leave a gap, or thicken the wall"
        for pair in sorted(touching)
    ]
    nested, inside_out = _nesting_faults(closed, touching)
    messages += [
        f"{_pair(names, pair)} overlap or are nested: light in one enters the other as if it came "
        "from air; leave a gap, or give the outer one a cavity (an inner surface whose normals "
        "point into the cavity)"
        for pair in sorted(nested)
    ]
    messages += [
        f"{names[index]} is a dielectric turned inside out: its normals point into the glass; flip "
        "them, or, if it is the surface of a cavity, add the closed outer surface"
        for index in sorted(inside_out)
    ]
    return messages


def _is_dielectric(shape: Any) -> bool:
    """Whether the surface refracts: Mitsuba sets NonSymmetric where refraction scales radiance."""
    flags = load_mitsuba().BSDFFlags
    kind = shape.bsdf().flags()
    return bool(kind & int(flags.NonSymmetric)) and bool(kind & int(flags.Transmission))


def _name(shape: Any) -> str:
    return repr(shape.id()) if shape.id() else f"an unnamed {shape.class_name().lower()}"


def _pair(names: list[str], pair: tuple[int, int]) -> str:
    first, second = (names[index] for index in pair)
    return f"parts of {first}" if pair[0] == pair[1] else f"{first} and {second}"


def _open_shapes(crossings: Crossings, num_shapes: int) -> NDArray[np.int64]:
    """Shapes that a line enters more or less often than it leaves."""
    key, index = np.unique(crossings.line * num_shapes + crossings.shape, return_inverse=True)
    balance = np.bincount(index, crossings.step, len(key))
    return np.unique(key[np.abs(balance) > 0.5] % num_shapes)


def _touching(crossings: Crossings) -> set[tuple[int, int]]:
    """Pairs of shapes whose surfaces are closer than the offset of a ray's origin."""
    near, next_one = slice(None, -1), slice(1, None)
    step, normal = crossings.step, crossings.normal
    gap = np.diff(crossings.distance) * np.abs((normal * crossings.direction).sum(axis=1)[near])
    facing = (normal[near] * normal[next_one]).sum(axis=1) * step[near] * step[next_one]
    same_line = crossings.line[near] == crossings.line[next_one]
    found = same_line & (gap < crossings.offset[near]) & (facing > _PARALLEL)
    pairs = np.sort(np.stack([crossings.shape[near], crossings.shape[next_one]], -1)[found], axis=1)
    totals = np.bincount(crossings.shape) if len(crossings.shape) else np.zeros(0)
    unique, counts = np.unique(pairs, axis=0, return_counts=True)
    return {
        (int(a), int(b))
        for (a, b), count in zip(unique, counts, strict=True)
        if count >= _MIN_SHARE * min(totals[a], totals[b])
    }


def _nesting_faults(
    crossings: Crossings, touching: set[tuple[int, int]]
) -> tuple[set[tuple[int, int]], set[int]]:
    """Pairs of shapes that overlap or are nested, and shapes that are inside out.

    The crossings are with closed shapes, so that the steps of each line sum to 0. Where shapes
    touch, the order of their crossings is not reliable.
    """
    depth = np.cumsum(crossings.step)
    suspicious = np.unique(crossings.line[(depth < 0) | (depth > 1)])
    stride = -(-len(suspicious) // _MAX_EXAMINED) or 1
    chosen = crossings.take(np.isin(crossings.line, suspicious[::stride]))
    nested: set[tuple[int, int]] = set()
    inside_out: set[int] = set()
    line, entered, missing = -1, [], 0
    for at, shape, step in zip(
        chosen.line.tolist(), chosen.shape.tolist(), chosen.step.tolist(), strict=True
    ):
        if at != line:
            line, entered, missing = at, [], 0
        if step < 0 and entered:
            entered.pop()
        elif step < 0:
            missing += 1
            inside_out.add(shape)
        elif missing:
            missing -= 1
        else:
            if entered:
                nested.add((min(entered[-1], shape), max(entered[-1], shape)))
            entered.append(shape)
    return nested - touching, inside_out - {shape for pair in touching for shape in pair}
