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

from lumitree._version import __version__ as __version__
from lumitree.core.backend import select_llvm
from lumitree.core.interrupt import Interrupted
from lumitree.errors import LumitreeError, LumitreeWarning

if TYPE_CHECKING:
    from lumitree.asset.asset import Asset, AssetInfo
    from lumitree.asset.file import save
    from lumitree.core.frames import LocalFrame
    from lumitree.core.progress import Progress, show_progress
    from lumitree.core.results import Result
    from lumitree.fit.bake import bake, bake_views, refine
    from lumitree.fit.bake_network import (
        bake_network,
        capture,
        extract,
        train,
    )
    from lumitree.fit.catalogue.bake_many import BakeManyResult, bake_many
    from lumitree.fit.catalogue.index import BakedLamp
    from lumitree.fit.config import BakeConfig, NetworkConfig
    from lumitree.fit.merge import merge
    from lumitree.fit.octree.config import OctreeConfig, OctreeFitConfig
    from lumitree.fit.photometric_files import bake_photometric
    from lumitree.fit.result import BakeResult, CaptureResult, TrainResult
    from lumitree.lamp.loading import builtin_luminaires, load_luminaire
    from lumitree.lamp.luminaire import Luminaire
    from lumitree.lamp.scene_shapes import SceneShape
    from lumitree.lamp.source import LuminaireSource
    from lumitree.measure.evaluate import EvaluateResult, evaluate
    from lumitree.measure.photometry.figures import Estimate, PhotometricFigures
    from lumitree.measure.photometry.near_field import NearFieldLimit
    from lumitree.measure.photometry.photometry import PhotometryResult, photometry
    from lumitree.output.export import ExportResult, export
    from lumitree.output.preview import AssetPreviewResult, PreviewResult, preview
    from lumitree.output.viewer.view import ViewResult, view
    from lumitree.rendering.asset_cache import load
    from lumitree.rendering.mixture import MixResult, mix
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.placement_file import read_placements
    from lumitree.rendering.plugins.register import register, shape
    from lumitree.rendering.render import RenderResult, render
    from lumitree.trace.flux_figures import Flux, MissedFlux
    from lumitree.trace.light_field_config import LightFieldConfig


# Where each public name is defined; imported on first use, so that `lumitree --help` answers at
# once.
_HOMES = {
    "Asset": "asset.asset",
    "AssetInfo": "asset.asset",
    "AssetPreviewResult": "output.preview",
    "BakeConfig": "fit.config",
    "BakeManyResult": "fit.catalogue.bake_many",
    "BakeResult": "fit.result",
    "BakedLamp": "fit.catalogue.index",
    "CaptureResult": "fit.result",
    "OctreeFitConfig": "fit.octree.config",
    "Estimate": "measure.photometry.figures",
    "EvaluateResult": "measure.evaluate",
    "ExportResult": "output.export",
    "Flux": "trace.flux_figures",
    "LightFieldConfig": "trace.light_field_config",
    "LocalFrame": "core.frames",
    "Luminaire": "lamp.luminaire",
    "LuminaireSource": "lamp.source",
    "MissedFlux": "trace.flux_figures",
    "NearFieldLimit": "measure.photometry.near_field",
    "NetworkConfig": "fit.config",
    "OctreeConfig": "fit.octree.config",
    "PhotometricFigures": "measure.photometry.figures",
    "PhotometryResult": "measure.photometry.photometry",
    "Placement": "rendering.placement",
    "PreviewResult": "output.preview",
    "Progress": "core.progress",
    "MixResult": "rendering.mixture",
    "RenderResult": "rendering.render",
    "Result": "core.results",
    "SceneShape": "lamp.scene_shapes",
    "TrainResult": "fit.result",
    "ViewResult": "output.viewer.view",
    "bake": "fit.bake",
    "bake_many": "fit.catalogue.bake_many",
    "bake_network": "fit.bake_network",
    "bake_photometric": "fit.photometric_files",
    "bake_views": "fit.bake",
    "builtin_luminaires": "lamp.loading",
    "capture": "fit.bake_network",
    "evaluate": "measure.evaluate",
    "export": "output.export",
    "extract": "fit.bake_network",
    "load": "rendering.asset_cache",
    "load_luminaire": "lamp.loading",
    "merge": "fit.merge",
    "photometry": "measure.photometry.photometry",
    "preview": "output.preview",
    "read_placements": "rendering.placement_file",
    "refine": "fit.bake",
    "register": "rendering.plugins.register",
    "mix": "rendering.mixture",
    "render": "rendering.render",
    "save": "asset.file",
    "shape": "rendering.plugins.register",
    "show_progress": "core.progress",
    "train": "fit.bake_network",
    "view": "output.viewer.view",
}
__all__ = [
    "Asset",
    "AssetInfo",
    "AssetPreviewResult",
    "BakeConfig",
    "BakeManyResult",
    "BakeResult",
    "BakedLamp",
    "CaptureResult",
    "Estimate",
    "EvaluateResult",
    "ExportResult",
    "Flux",
    "Interrupted",
    "LightFieldConfig",
    "LocalFrame",
    "Luminaire",
    "LuminaireSource",
    "LumitreeError",
    "LumitreeWarning",
    "MissedFlux",
    "MixResult",
    "NearFieldLimit",
    "NetworkConfig",
    "OctreeConfig",
    "OctreeFitConfig",
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
    "bake_photometric",
    "bake_views",
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
