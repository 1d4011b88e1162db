"""How large the parts are: `gpu`, minutes on a large GPU, and `tiny`, minutes on two CPU cores."""

import dataclasses
from collections.abc import Mapping
from typing import Literal, get_args

from benchmarks.paper_tables.scales import SCALES, ScaleName, Views
from lumitree.asset.asset import PARTS
from lumitree.fit.config import BakeConfig
from lumitree.fit.network.config import PRESETS, TrainConfig
from lumitree.fit.octree.config import (
    CalibrationConfig,
    EstimateConfig,
    FluxConfig,
    HeldOutConfig,
    MaxRadianceConfig,
    OctreeConfig,
    RefineConfig,
    SplitConfig,
)
from lumitree.trace.light_field_config import LightFieldConfig

SizeName = Literal["gpu", "tiny"]
SIZE_NAMES: tuple[SizeName, ...] = get_args(SizeName)


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Everything that the seconds of the parts depend on.

    Attributes:
        name: of these sizes.
        lamps: built-in lamps that are compared; the first has a radiance field, and is measured.
        batches: independent images, or bakes of a light field, on each device.
        width, spp: of an image that is compared: pixels, and samples per pixel of a batch.
        rays: rays of an asset, and light paths of a lamp, for the irradiance around them.
        paths: light paths of a light field.
        bake: settings of the asset of the first lamp.
        patience: factor on the limits of time of the parts.
        devices: rays of the bakes (0: without radiance fields), width of the images in pixels, and
            samples per pixel.
        luminaires: pixels per side and samples per pixel of the captures.
        query: rays of a query, and the depth of the deepest tree.
        equal: seconds of rendering for the figures at equal error, and width in pixels.
        paper: scale of the benchmark `paper` of which a step and a lamp are measured.
        network_lamp: what the network learns.
        views: that it learns from.
        network: its settings.
        extraction: tree depths, and positions averaged in a leaf.
        tests: folders and files of the tests, by part.
        test_seconds: after which a test counts as hanging.
    """

    name: SizeName
    lamps: tuple[str, ...]
    batches: int
    width: int
    spp: int
    rays: int
    paths: int
    bake: BakeConfig
    patience: float
    devices: tuple[int, int, int]
    luminaires: tuple[int, int]
    query: tuple[int, int]
    equal: tuple[float, int]
    paper: ScaleName
    network_lamp: str
    views: Views
    network: TrainConfig
    extraction: tuple[tuple[int, ...], int]
    tests: Mapping[str, tuple[str, ...]]
    test_seconds: float


SIZES: dict[SizeName, Sizes] = {
    "gpu": Sizes(
        name="gpu",
        lamps=("bulbs", "star"),
        batches=16,
        width=96,
        spp=64,
        rays=1 << 20,
        paths=1 << 19,
        bake=dataclasses.replace(
            BakeConfig.preview(),
            parts=PARTS,
            time=None,
            rays=1 << 20,
            tree_depth=7,
            irradiance_paths=0,
        ),
        patience=1.0,
        devices=(1 << 22, 480, 64),
        luminaires=(192, 32),
        query=(1 << 19, 10),
        equal=(60.0, 240),
        paper="gpu",
        network_lamp="dallas",
        views=SCALES["gpu"].train,
        network=PRESETS["paper"],
        extraction=((8, 9, 10), 64),
        tests={
            # Those that compare kernels with reference implementations, and samplers by χ².
            "kernels": (
                "tests/rendering/test_field.py",
                "tests/rendering/test_emitter_sampling.py",
                "tests/rendering/test_plugins.py",
                "tests/rendering/test_irradiance.py",
                "tests/rendering/test_device_light_field.py",
                "tests/octree",
            ),
            "rendering": ("tests/rendering",),
            "tracing": ("tests/trace", "tests/measure"),
            "fits": ("tests/fit/light_field", "tests/fit/octree"),
            "others": ("tests/lamp", "tests/core", "tests/asset", "tests/formats"),
        },
        test_seconds=120.0,
    ),
    "tiny": Sizes(
        name="tiny",
        lamps=("bulbs",),
        batches=4,
        width=32,
        spp=2,
        rays=1 << 14,
        paths=1 << 14,
        bake=BakeConfig(
            parts=PARTS,
            time=None,
            rays=1 << 14,
            tree_depth=4,
            l_max=0,
            irradiance_paths=0,
            light_field=LightFieldConfig(paths=1 << 16, batch=1 << 16, depth=3, resolution=16),
            octree=OctreeConfig(
                max_radiance=MaxRadianceConfig(rays=1 << 15),
                estimate=EstimateConfig(rays=1 << 16, growth_rays=1 << 15, batch_rays=1 << 15),
                calibration=CalibrationConfig(rays=1 << 13),
                flux=FluxConfig(draws=2, rays=1 << 14),
                held_out=HeldOutConfig(rays=1 << 13),
                refine=RefineConfig(rays=1 << 13),
                split=SplitConfig(indicator_rays=1 << 13),
            ),
        ),
        # Other work may share the cores.
        patience=3.0,
        devices=(0, 32, 1),
        luminaires=(16, 1),
        query=(1 << 12, 5),
        equal=(2.0, 24),
        paper="test",
        network_lamp="neoclassical",
        views=SCALES["test"].train,
        network=dataclasses.replace(SCALES["test"].network, num_steps=600),
        extraction=((3, 4), 4),
        tests={"kernels": ("tests/rendering/test_alias_table.py",)},
        test_seconds=120.0,
    ),
}
