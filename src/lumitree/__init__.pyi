"""The public names of lumitree, each where it is defined. They are imported on first use."""

from ._version import __version__ as __version__
from .asset.asset import Asset as Asset
from .asset.asset import AssetInfo as AssetInfo
from .asset.file import save as save
from .core.executor import process_pool as process_pool
from .core.frames import LocalFrame as LocalFrame
from .core.interruption import Interrupted as Interrupted
from .core.photometry import Flux as Flux
from .core.photometry import MissedFlux as MissedFlux
from .core.progress import Progress as Progress
from .core.progress import show_progress as show_progress
from .core.results import Result as Result
from .errors import LumitreeError as LumitreeError
from .errors import LumitreeWarning as LumitreeWarning
from .exports.blender_extension import (
    BlenderExtensionResult as BlenderExtensionResult,
)
from .exports.blender_extension import (
    blender_extension as blender_extension,
)
from .exports.export import ExportResult as ExportResult
from .exports.export import export as export
from .fit.bake import bake as bake
from .fit.bake import refine as refine
from .fit.bake_network import (
    CaptureResult as CaptureResult,
)
from .fit.bake_network import (
    TrainResult as TrainResult,
)
from .fit.bake_network import (
    capture as capture,
)
from .fit.bake_network import (
    extract as extract,
)
from .fit.bake_network import (
    train as train,
)
from .fit.config import BakeConfig as BakeConfig
from .fit.config import NetworkConfig as NetworkConfig
from .fit.finishing import (
    BakeResult as BakeResult,
)
from .fit.octree.config import OctreeConfig as OctreeConfig
from .lamp.luminaire import Luminaire as Luminaire
from .lamp.luminaire import builtin_luminaires as builtin_luminaires
from .lamp.luminaire import load_luminaire as load_luminaire
from .lamp.scene_shapes import SceneShape as SceneShape
from .lamp.source import LuminaireSource as LuminaireSource
from .many.bake_many import bake_many as bake_many
from .many.bake_many import collect as collect
from .many.result import BakedLamp as BakedLamp
from .many.result import BakeManyResult as BakeManyResult
from .measure.design import DesignedArea as DesignedArea
from .measure.design import DesignedLamp as DesignedLamp
from .measure.design import DesignResult as DesignResult
from .measure.design import design as design
from .measure.dimming import TaskPlane as TaskPlane
from .measure.direct_light import direct_illuminance as direct_illuminance
from .measure.evaluate import EvaluateResult as EvaluateResult
from .measure.evaluate import evaluate as evaluate
from .measure.glare import Glare as Glare
from .measure.glare import LampGlare as LampGlare
from .measure.glare import glare as glare
from .measure.glare import lamp_glare as lamp_glare
from .measure.illuminance import IlluminanceResult as IlluminanceResult
from .measure.illuminance import illuminance as illuminance
from .measure.near_field import NearFieldLimit as NearFieldLimit
from .measure.photometric_figures import (
    Estimate as Estimate,
)
from .measure.photometric_figures import (
    PhotometricFigures as PhotometricFigures,
)
from .measure.photometry import (
    PhotometryResult as PhotometryResult,
)
from .measure.photometry import (
    photometry as photometry,
)
from .measure.preview import (
    AssetPreviewResult as AssetPreviewResult,
)
from .measure.preview import (
    PreviewResult as PreviewResult,
)
from .measure.preview import (
    preview as preview,
)
from .measure.receivers import AreaFigures as AreaFigures
from .measure.receivers import LampIlluminance as LampIlluminance
from .measure.receivers import Plane as Plane
from .measure.receivers import Surface as Surface
from .rendering.asset_cache import load as load
from .rendering.placement import Placement as Placement
from .rendering.placement import read_placements as read_placements
from .rendering.placement import write_placements as write_placements
from .rendering.register import register as register
from .rendering.register import shape as shape
from .rendering.render import RenderResult as RenderResult
from .rendering.render import render as render
from .trace.light_field_config import LightFieldConfig as LightFieldConfig
from .viewer.mix import MixResult as MixResult
from .viewer.mix import mix as mix
from .viewer.view import ViewResult as ViewResult
from .viewer.view import view as view
