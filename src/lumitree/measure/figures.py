"""Contact sheets of an evaluation: views, and the irradiance in false colour."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from numpy.typing import NDArray

from lumitree.core.images import auto_exposure, tonemap
from lumitree.measure.irradiance import FACES, NUM_CUBE_FACES, IrradianceEvaluation
from lumitree.rendering.drawing import OPACITY, ColourScale, Sheet, Tile, image_grid

MAX_ROWS = 6
# Pixels of an image of a view, and of a face.
_VIEW, _FACE = 320, 216
# Smaller relative errors are black.
_ERROR = ColourScale(LogNorm(1e-4, 1, clip=True), "inferno", "|baked - reference| / L_max")
_DIFFERENCE = ColourScale(Normalize(-0.2, 0.2, clip=True), "RdBu_r", "baked / explicit - 1")
# Part of the patches that may be brighter than the scale: patches that rare paths reach are noisy.
_CLIPPED = 0.002


@dataclasses.dataclass(frozen=True)
class SheetRow:
    """One view of a sheet.

    Attributes:
        reference: [H, W, 3] radiance of the luminaire.
        baked: [H, W, 3] radiance of the asset, same unit.
        reference_opacity: [H, W] in [0, 1].
        baked_opacity: [H, W] in [0, 1].
        metrics: at least `psnr_linear` (dB) and `opacity_rmse` of this view.
    """

    name: str
    reference: NDArray[np.floating]
    baked: NDArray[np.floating]
    reference_opacity: NDArray[np.floating]
    baked_opacity: NDArray[np.floating]
    metrics: Mapping[str, float]

    def tiles(self, max_radiance: float) -> list[Tile]:
        """Images of the columns of `draw_sheet`; the reference decides the exposure of both."""
        exposure, metrics = auto_exposure(self.reference), self.metrics
        error = np.abs(self.baked - self.reference).mean(axis=-1) / max_radiance
        psnr = f"psnr_linear {metrics['psnr_linear']:.2f} dB"
        if "psnr_linear_black" in metrics:
            psnr += f" (black {metrics['psnr_linear_black']:.2f})"
        return [
            Tile(tonemap(self.reference, exposure), f"{self.name} (exposure {exposure:.3g})"),
            Tile(tonemap(self.baked, exposure), psnr),
            Tile(_ERROR(error)),
            Tile(OPACITY(self.reference_opacity)),
            Tile(OPACITY(self.baked_opacity), f"opacity_rmse {metrics['opacity_rmse']:.4f}"),
        ]


def draw_sheet(rows: Sequence[SheetRow], max_radiance: float, title: str) -> Sheet:
    """Contact sheet of views.

    Columns: reference and baked radiance (sRGB, both at the reference's `auto_exposure`), their
    relative error |baked - reference| / L_max (mean over the channels) in false colour, reference
    and baked opacity in grey.

    Args:
        rows: 1 to 6 views, shown in this order.
        max_radiance: L_max, radiance unit, positive.
        title: one line above the sheet, e.g. luminaire and asset.
    """
    return image_grid(
        [row.tiles(max_radiance) for row in rows],
        _VIEW,
        title=title,
        columns=("Reference", "Baked", "Error", "Reference opacity", "Baked opacity"),
        bars={2: _ERROR, 3: OPACITY, 4: OPACITY},
    )


def draw_irradiance(evaluation: IrradianceEvaluation, title: str) -> Sheet:
    """Sheet with a column for each face, and explicit, baked and the difference of both in rows.

    Explicit and baked irradiance have one colour scale for the faces of the cube, and one for the
    plane that touches the bounding box. The difference is relative to the explicit irradiance of
    each patch, and grey where this is 0.

    Args:
        title: one line above the sheet, e.g. luminaire and asset.
    """
    explicit, baked, error = evaluation.explicit.lux, evaluation.baked.lux, evaluation.error
    ratio = np.divide(baked, explicit, out=np.full_like(baked, np.nan), where=explicit > 0)
    cube = _scale(explicit[:NUM_CUBE_FACES], "cube: irradiance, lx")
    touching = _scale(explicit[NUM_CUBE_FACES:], "touching: irradiance, lx")
    rows: tuple[list[Tile], ...] = ([], [], [])
    for index, face in enumerate(FACES):
        scale = cube if index < NUM_CUBE_FACES else touching
        tiles = (
            Tile(scale(_seen(face, explicit[index])), f"mean {explicit[index].mean():,.4g} lx"),
            Tile(
                scale(_seen(face, baked[index])),
                "ratio " + _number(error.ratio[index], error.ratio_error[index], ".3f"),
            ),
            Tile(
                _DIFFERENCE(_seen(face, ratio[index]) - 1),
                "RMS error " + _number(error.rms[index], error.rms_error[index], ".1%"),
            ),
        )
        for row, tile in zip(rows, tiles, strict=True):
            row.append(tile)
    return image_grid(
        rows,
        _FACE,
        title=title,
        subtitle="irradiance on a cube of three times the size of the bounding box, faces as seen "
        "from the lamp, and on a plane that touches the box from below; "
        f"{evaluation.num_paths:,} paths each",
        columns=[*(f"face {face}" for face in FACES[:NUM_CUBE_FACES]), "touching plane"],
        names=("explicit", "baked", "difference"),
        bars={1: cube, 3: _DIFFERENCE, 6: touching},
    )


def _scale(lux: NDArray[np.float64], label: str) -> ColourScale:
    """Colour scale of irradiance."""
    largest = float(np.quantile(lux, 1 - _CLIPPED)) or float(lux.max()) or 1.0
    return ColourScale(Normalize(0, largest, clip=True), "viridis", label)


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


def _number(value: float, error: float, form: str) -> str:
    """A value and its standard error."""
    if not np.isfinite(value):
        return "not known"
    return f"{value:{form}}" + (f" ± {error:{form}}" if np.isfinite(error) else "")
