"""Sheet of the irradiance around a luminaire, explicit beside baked, in false colour."""

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from lumitree.measure.irradiance import FACES, NUM_CUBE_FACES, PATCHES, IrradianceEvaluation
from lumitree.output.tiles import Layout, TileSheet

ROWS = ("explicit", "baked", "difference")
# Largest relative difference on the colour scale.
MAX_DIFFERENCE = 0.2
# Part of the patches that may be brighter than the scale: patches that rare paths reach are noisy.
_CLIPPED = 0.002
# Pixels a side of a patch.
_PATCH = 18
_LIGHT, _DIFFERENCE = colormaps["viridis"], colormaps["RdBu_r"]
# Difference of a patch that the explicit lamp does not light.
_UNKNOWN = (0.75, 0.75, 0.75)


def irradiance_layout() -> Layout:
    """Layout of the sheet: a column for each face."""
    return Layout(len(FACES), len(ROWS), _PATCH * PATCHES, title=66, footer=54, side=30)


def draw_irradiance(evaluation: IrradianceEvaluation, title: str) -> TileSheet:
    """Sheet with a column for each face and the rows of `ROWS`.

    Explicit and baked irradiance have one colour scale for the faces of the cube, and one for the
    plane that touches the bounding box. The difference is relative to the explicit irradiance of
    each patch.

    Args:
        title: one line above the sheet, e.g. luminaire and asset.
    """
    explicit, baked, error = evaluation.explicit.lux, evaluation.baked.lux, evaluation.error
    scales = [_scale(explicit[:NUM_CUBE_FACES]), _scale(explicit[NUM_CUBE_FACES:])]
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = baked / explicit - 1
    of_difference = Normalize(-MAX_DIFFERENCE, MAX_DIFFERENCE)
    sheet = TileSheet(irradiance_layout())
    sheet.title(
        title,
        "irradiance on a cube of three times the size of the bounding box, faces as seen from "
        "the lamp, and on a plane that touches the box from below; "
        f"{evaluation.num_paths:,} paths each",
    )
    for row, name in enumerate(ROWS):
        sheet.row_name(row, name)
    for column, face in enumerate(FACES):
        of_cube = column < NUM_CUBE_FACES
        sheet.heading(column, f"face {face}" if of_cube else "touching plane")
        factor, _, norm = scales[0 if of_cube else 1]
        for row, lux in enumerate((explicit, baked)):
            sheet.image(row, column, _LIGHT(norm(_seen(face, lux[column]) * factor))[..., :3])
        shown = _seen(face, difference[column])
        colours = _DIFFERENCE(of_difference(shown))[..., :3]
        sheet.image(2, column, np.where(np.isfinite(shown)[..., None], colours, _UNKNOWN))
        mean = float(explicit[column].mean())
        sheet.caption(0, column, f"mean {mean * _unit(mean)[0]:.4g} {_unit(mean)[1]}")
        sheet.caption(1, column, f"ratio {_number(error.ratio, error.ratio_error, column, 3)}")
        percent = _number(100 * error.rms, 100 * error.rms_error, column, 1, " %")
        sheet.caption(2, column, f"RMS error {percent}")
    for column, (_, unit, norm), name in zip((1, 6), scales, ("cube", "touching"), strict=True):
        sheet.colour_bar(column, _LIGHT, norm, f"{name}: irradiance, {unit}")
    sheet.colour_bar(3, _DIFFERENCE, of_difference, "baked / explicit - 1")
    return sheet


def _scale(lux: NDArray[np.float64]) -> tuple[float, str, Normalize]:
    """Factor to a unit that gives short numbers, the unit, and the colour scale in this unit."""
    largest = float(np.quantile(lux, 1 - _CLIPPED)) or float(lux.max()) or 1.0
    factor, unit = _unit(largest)
    return factor, unit, Normalize(0, largest * factor, clip=True)


def _unit(lux: float) -> tuple[float, str]:
    """Factor to the unit in which a number is from 1 to 1000 if it is more, and the unit."""
    factor, unit = 1.0, "lx"
    for smaller, name in ((1e-3, "klx"), (1e-6, "Mlx"), (1e-9, "Glx")):
        if lux * smaller >= 1:
            factor, unit = smaller, name
    return factor, unit


def _seen(face: str, patches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Patches [P, P] of a face as an image, as seen from the lamp with +y up.

    -y and the touching plane have -z up, +y has +z up, as the views of `preview` from above and
    from below.
    """
    if face in ("-x", "+x"):
        image = patches[::-1]
    elif face in ("-y", "touching"):
        image = patches.T
    else:
        image = patches.T[::-1]
    return image[:, ::-1] if face in ("-x", "+z") else image


def _number(
    values: NDArray[np.float64],
    errors: NDArray[np.float64],
    index: int,
    digits: int,
    unit: str = "",
) -> str:
    """A value and its standard error."""
    if not np.isfinite(values[index]):
        return "not known"
    error = f" ± {errors[index]:.{digits}f}" if np.isfinite(errors[index]) else ""
    return f"{values[index]:.{digits}f}{error}{unit}"
