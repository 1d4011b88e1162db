"""View transforms from linear colours, of which display white is 1, to the bytes of a display.

"srgb" clips at 1 and encodes sRGB, for measuring. "agx" is AgX by Troy Sobotka, with the primaries
of Rec. 2020 as Blender and Filament have it: bright colours approach white slowly and keep their
hue, and dark ones keep contrast. Its look is "punchy", without which images are dull.
"""

from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from lumitree.core.images import srgb_from_linear, tonemap
from lumitree.core.photometry import LUMA

View = Literal["agx", "srgb"]
VIEWS: tuple[View, ...] = get_args(View)

# Linear Rec. 2020 of linear sRGB (ITU-R BT.2087).
_REC2020_FROM_SRGB = np.array(
    [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
)
# AgX: the primaries that the curve is applied to, and those to which its result is converted, as
# matrices of linear Rec. 2020.
_INSET = np.array(
    [
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ]
)
_OUTSET = np.array(
    [
        [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
        [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
        [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
    ]
)
# Stops around middle grey that are shown, and middle grey.
_STOPS, _GREY = (-10.0, 6.5), 0.18
# The curve: its slope at middle grey, which becomes ½, and the powers of its toe and its shoulder.
_SLOPE, _TOE, _SHOULDER = 2.0, 3.0, 3.25
# Exponent that decodes the result of the curve.
_GAMMA = 2.2
# Beyond it everything is white.
_MOST = 1e6
# Entries of the table of the curve.
_LEVELS = 4097


class Look(NamedTuple):
    """Power of the colours after the curve of AgX, and saturation (ASC CDL)."""

    power: float
    saturation: float


PUNCHY = Look(1.35, 1.4)


def displayed(linear: NDArray[np.floating], view: View) -> NDArray[np.uint8]:
    """sRGB bytes [H, W, 3] of linear sRGB [H, W, 3], relative to display white."""
    if view == "srgb":
        return tonemap(linear)
    return np.round(srgb_from_linear(agx(linear)) * 255).astype(np.uint8)


def agx(linear: NDArray[np.floating], look: Look = PUNCHY) -> NDArray[np.float32]:
    """Linear sRGB [..., 3] in [0, 1] that AgX shows of linear sRGB [..., 3]."""
    # Single precision and a table of the curve take half the time.
    colours = np.nan_to_num(linear, posinf=_MOST, neginf=0.0).clip(-_MOST, _MOST)
    colours = _product(colours.astype(np.float32), _INSET @ _REC2020_FROM_SRGB)
    low, high = _STOPS
    stops = np.log2(np.maximum(colours, np.float32(1e-10)) / np.float32(_GREY))
    levels = np.linspace(0, 1, _LEVELS)
    curved = np.interp((stops - low) / (high - low), levels, _curve(levels) ** look.power)
    grey = np.outer(np.ones(3), LUMA)
    saturated = _OUTSET @ (grey + look.saturation * (np.eye(3) - grey))
    decoded = np.maximum(_product(curved.astype(np.float32), saturated), 0) ** np.float32(_GAMMA)
    return np.clip(_product(decoded, np.linalg.inv(_REC2020_FROM_SRGB)), 0, 1)


def glsl_constants() -> str:
    """The constants of `agx` for `agx.glsl`, as GLSL."""
    low, high = _STOPS
    grey = np.outer(np.ones(3), LUMA)
    matrices = {
        "BEFORE": _INSET @ _REC2020_FROM_SRGB,
        "SATURATED": _OUTSET @ (grey + PUNCHY.saturation * (np.eye(3) - grey)),
        "AFTER": np.linalg.inv(_REC2020_FROM_SRGB),
    }
    numbers = {
        "LOW": low, "HIGH": high, "MIDDLE": -low / (high - low), "GREY": _GREY, "SLOPE": _SLOPE,
        "TOE": _TOE, "SHOULDER": _SHOULDER, "LOOK_POWER": PUNCHY.power, "GAMMA": _GAMMA,
        "MOST": _MOST,
    }  # fmt: skip
    lines = [f"const float {name} = {float(value)!r};" for name, value in numbers.items()]
    for name, matrix in matrices.items():
        # Matrices of GLSL are written column by column.
        columns = ", ".join(f"{each:.9f}" for each in matrix.T.ravel())
        lines.append(f"const mat3 {name} = mat3({columns});")
    return "\n".join(lines) + "\n"


def _product(colours: NDArray[np.float32], matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """A matrix times colours [..., 3]."""
    return colours @ matrix.T.astype(np.float32)


def _curve(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sigmoid of AgX from [0, 1] to [0, 1]."""
    low, high = _STOPS
    middle = -low / (high - low)
    offset = level - middle
    power = np.where(offset < 0, _TOE, _SHOULDER)
    # The scales for which the ends are 0 and 1.
    reach = np.where(offset < 0, middle, 1 - middle)
    bend = ((2 * _SLOPE * reach) ** power - 1) * (np.abs(offset) / reach) ** power
    return np.clip(0.5 + _SLOPE * offset * (1 + bend) ** (-1 / power), 0, 1)
