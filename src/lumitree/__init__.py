"""Complex luminaires, baked once into a radiance field and given back to Mitsuba 3.

Import lumitree before mitsuba: it then names a working libLLVM to Mitsuba (see
`lumitree.core.backend`).
"""

from lumitree.core.program import exit_on_signals, is_program

if is_program():
    # The command line imports this package first; `main` installs its own handlers.
    exit_on_signals()

import importlib
from typing import TYPE_CHECKING, Any

from lumitree.core.backend import select_llvm
from lumitree.core.interrupt import Interrupted
from lumitree.errors import LumitreeError, LumitreeWarning

if TYPE_CHECKING:
    from lumitree.api.baking import bake, refine
    from lumitree.api.exporting import ExportResult, export
    from lumitree.api.files import load
    from lumitree.api.lamp_index import BakedLamp
    from lumitree.api.luminaires import builtin_luminaires, load_luminaire
    from lumitree.api.many import BakeManyResult, bake_many
    from lumitree.api.merging import merge
    from lumitree.api.network import bake_network, capture, extract, train
    from lumitree.api.page import ViewResult, view
    from lumitree.api.photometry import photometry
    from lumitree.api.rendering import mix, render
    from lumitree.api.results import (
        AssetPreviewResult,
        BakeResult,
        CaptureResult,
        EvaluateResult,
        Flux,
        MissedFlux,
        MixResult,
        PhotometryResult,
        PreviewResult,
        RenderResult,
        Result,
        TrainResult,
    )
    from lumitree.api.viewing import evaluate, preview
    from lumitree.asset.asset import Asset, AssetInfo
    from lumitree.asset.file import save
    from lumitree.core.frames import LocalFrame
    from lumitree.core.progress import Progress, show_progress
    from lumitree.goniophotometry.figures import Estimate, PhotometricFigures
    from lumitree.goniophotometry.near_field import NearFieldLimit
    from lumitree.luminaire.luminaire import Luminaire
    from lumitree.luminaire.scene_shapes import SceneShape
    from lumitree.luminaire.source import LuminaireSource
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.placement_file import read_placements
    from lumitree.rendering.plugins import register, shape

__version__ = "0.1.0"

# Where each public name is defined; imported on first use, so that `lumitree --help` answers at
# once.
_HOMES = {
    "Asset": "asset.asset",
    "AssetInfo": "asset.asset",
    "AssetPreviewResult": "api.results",
    "BakeManyResult": "api.many",
    "BakeResult": "api.results",
    "BakedLamp": "api.lamp_index",
    "CaptureResult": "api.results",
    "Estimate": "goniophotometry.figures",
    "EvaluateResult": "api.results",
    "ExportResult": "api.exporting",
    "Flux": "api.results",
    "LocalFrame": "core.frames",
    "Luminaire": "luminaire.luminaire",
    "LuminaireSource": "luminaire.source",
    "MissedFlux": "api.results",
    "NearFieldLimit": "goniophotometry.near_field",
    "PhotometricFigures": "goniophotometry.figures",
    "PhotometryResult": "api.results",
    "Placement": "rendering.placement",
    "PreviewResult": "api.results",
    "Progress": "core.progress",
    "MixResult": "api.results",
    "RenderResult": "api.results",
    "Result": "api.results",
    "SceneShape": "luminaire.scene_shapes",
    "TrainResult": "api.results",
    "ViewResult": "api.page",
    "bake": "api.baking",
    "bake_many": "api.many",
    "bake_network": "api.network",
    "builtin_luminaires": "api.luminaires",
    "capture": "api.network",
    "evaluate": "api.viewing",
    "export": "api.exporting",
    "extract": "api.network",
    "load": "api.files",
    "load_luminaire": "api.luminaires",
    "merge": "api.merging",
    "photometry": "api.photometry",
    "preview": "api.viewing",
    "read_placements": "rendering.placement_file",
    "refine": "api.baking",
    "register": "rendering.plugins",
    "mix": "api.rendering",
    "render": "api.rendering",
    "save": "asset.file",
    "shape": "rendering.plugins",
    "show_progress": "core.progress",
    "train": "api.network",
    "view": "api.page",
}
__all__ = [
    "Asset",
    "AssetInfo",
    "AssetPreviewResult",
    "BakeManyResult",
    "BakeResult",
    "BakedLamp",
    "CaptureResult",
    "Estimate",
    "EvaluateResult",
    "ExportResult",
    "Flux",
    "Interrupted",
    "LocalFrame",
    "Luminaire",
    "LuminaireSource",
    "LumitreeError",
    "LumitreeWarning",
    "MissedFlux",
    "MixResult",
    "NearFieldLimit",
    "PhotometricFigures",
    "PhotometryResult",
    "Placement",
    "PreviewResult",
    "Progress",
    "RenderResult",
    "Result",
    "SceneShape",
    "TrainResult",
    "ViewResult",
    "bake",
    "bake_many",
    "bake_network",
    "builtin_luminaires",
    "capture",
    "evaluate",
    "export",
    "extract",
    "load",
    "load_luminaire",
    "merge",
    "mix",
    "photometry",
    "preview",
    "read_placements",
    "refine",
    "register",
    "render",
    "save",
    "shape",
    "show_progress",
    "train",
    "view",
]

select_llvm()


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"lumitree.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'lumitree' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
