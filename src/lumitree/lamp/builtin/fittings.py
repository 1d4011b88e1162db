"""Fittings of lamps: canopies, rods, chains, bands, candles."""

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.builtin.layout import at
from lumitree.lamp.meshes import Mesh, join, lathe, moved, resample, smooth, sweep


def canopy(radius: float, height: float) -> Mesh:
    """Domed rose under the ceiling at y = 0, with a collar on its axis; metres."""
    profile = [[0, -1.35], [0.12, -1.35], [0.14, -1.3], [0.14, -1.05], [0.2, -1.0], [0.5, -0.88]]
    profile += [[0.85, -0.55], [0.97, -0.3], [1, -0.25], [1, 0], [0, 0]]
    return lathe([*smooth(np.multiply(profile[:-2], [radius, height]), 3), [radius, 0], [0, 0]], 64)


def rod(top: float, bottom: float, radius: float) -> Mesh:
    """Upright rod on the y axis, metres."""
    return lathe([[0, bottom], [radius, bottom], [radius, top], [0, top]], 24)


def band(inner: float, outer: float, bottom: float, top: float, segments: int = 128) -> Mesh:
    """Flat hoop about the y axis with chamfered edges, metres."""
    bevel = 0.15 * min(outer - inner, top - bottom)
    corners = [[outer, bottom + bevel], [outer, top - bevel], [outer - bevel, top]]
    corners += [[inner + bevel, top], [inner, top - bevel], [inner, bottom + bevel]]
    corners += [[inner + bevel, bottom], [outer - bevel, bottom], corners[0]]
    return lathe(corners, segments)


def hoop(radius: float, wire: float, segments: int = 96) -> Mesh:
    """Round wire bent to a horizontal circle about the origin, metres."""
    angle = np.linspace(0, 2 * np.pi, 13) + np.pi / 2
    return lathe(np.column_stack([radius + wire * np.cos(angle), wire * np.sin(angle)]), segments)


def chain(top: float, bottom: float, link: float) -> Mesh:
    """Chain on the y axis between two heights, of oval links `link` long; metres."""
    wire = 0.075 * link
    count = max(2, round((top - bottom - link) / (0.78 * link)) + 1)
    angle = np.linspace(0, 2 * np.pi, 33)
    oval = np.column_stack([0.3 * np.sin(angle), 0.5 * np.cos(angle), 0 * angle])
    oval[:, 1] += 0.12 * np.sign(oval[:, 1]) * (np.abs(oval[:, 1]) > 0.1) - 0.12 * oval[:, 1] / 0.5
    ring = sweep(oval * link * [1, 0.93, 1], wire, 10)
    heights = np.linspace(top - link / 2, bottom + link / 2, count)
    return join([moved(ring, at(0, y, 0, turn=90 * (i % 2))) for i, y in enumerate(heights)])


def strut(start: ArrayLike, end: ArrayLike, radius: float, segments: int = 12) -> Mesh:
    """Straight round bar between two points [3], metres."""
    return sweep(np.array([start, end], np.float64), radius, segments)


def candle(height: float) -> Mesh:
    """Candle sleeve that stands on y = 0; a flame bulb's origin goes 2 mm below its top."""
    inside = [[0.0078, height - 0.02], [0, height - 0.02]]
    rim = [[0.0112, height - 0.002], [0.0105, height], [0.0088, height], [0.0078, height - 0.001]]
    foot = [[0, 0], [0.0112, 0]]
    return lathe([*foot, *rim, *inside], 32)


def drip_pan(radius: float) -> Mesh:
    """Turned dish with a cup for a candle; the candle stands at y = 0, metres."""
    under = [[0, -0.022], [0.3, -0.02], [0.26, -0.012], [0.5, -0.008], [0.85, -0.002], [1, 0.006]]
    lip = [[1.02, 0.0075], [1.0, 0.0085], [0.86, 0.002]]
    over = [[0.55, -0.002], [0.45, 0.0], [0.42, 0.012], [0.46, 0.02], [0.4, 0.021], [0.36, 0.006]]
    profile = np.array([*under, *lip, *over, [0, 0.004]]) * [radius, 1]
    return lathe(resample(smooth(profile, 3), 34), 36)
