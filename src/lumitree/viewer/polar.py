"""The polar curve of an asset as an SVG image, for pages."""

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.octahedral import interpolated
from lumitree.formats.type_c import direction_of
from lumitree.rendering.asset_flux import intensity_by_bin

# The vertical planes, by C in degrees, and their colours; step of γ, degrees.
_PLANES, _STEP = {0: "#60a5fa", 90: "#fb923c"}, 3
_RADIUS = 88


def polar_svg(asset: Asset) -> str:
    """Luminous intensity in two vertical planes, y up and in metres; empty without a light field.

    Straight down is at the bottom, and C = 0 and C = 90 are on the right.
    """
    if asset.light_field is None:
        return ""
    gamma = np.arange(0, 360, _STEP)
    directions = np.stack([direction_of(c, gamma) for c in _PLANES]) @ asset.frame.rotation
    intensity = interpolated(intensity_by_bin(asset), directions.reshape(-1, 3))
    candela = intensity.reshape(len(_PLANES), -1) * asset.frame.scale**2
    largest = float(candela.max()) or 1.0
    turn = np.deg2rad(gamma)
    lines = [
        f'<circle r="{_RADIUS * part:g}" fill="none" stroke="#78716c" stroke-width="0.5"/>'
        for part in (0.5, 1)
    ]
    lines.append(
        f'<path d="M-{_RADIUS} 0H{_RADIUS}M0 -{_RADIUS}V{_RADIUS}" stroke="#78716c" '
        'stroke-width="0.5"/>'
    )
    for radius, colour in zip(candela / largest * _RADIUS, _PLANES.values(), strict=True):
        points = " ".join(
            f"{x:.1f},{y:.1f}"
            for x, y in zip(radius * np.sin(turn), radius * np.cos(turn), strict=True)
        )
        lines.append(f'<polygon points="{points}" fill="none" stroke="{colour}"/>')
    texts = [f"{largest:,.4g} cd", *(f"C{c}-C{c + 180}" for c in _PLANES)]
    for row, (text, colour) in enumerate(zip(texts, ("#a8a29e", *_PLANES.values()), strict=True)):
        lines.append(f'<text x="-98" y="{-88 + 11 * row}" fill="{colour}">{text}</text>')
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="-100 -100 200 200" role="img" '
        'aria-label="Polar curve" font-family="system-ui, sans-serif" font-size="9">'
        f"{''.join(lines)}</svg>"
    )
