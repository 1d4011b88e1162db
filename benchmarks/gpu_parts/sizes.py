"""How large the parts are: `gpu`, minutes on a large GPU, and `tiny`, minutes on two CPU cores."""

import dataclasses
from collections.abc import Mapping
from typing import Literal, get_args

from benchmarks.paper_tables.scales import SCALES, ScaleName
from lumitree.asset.asset import PARTS
from lumitree.fit.config import BakeConfig
from lumitree.fit.network.config import TrainConfig
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
        illumination: width of its images in pixels, and samples per pixel.
        paper: scale of the benchmark `paper`, whose views the network learns from and is tested on.
        network_lamp: what the network learns.
        network: its settings.
        octree: tree depth of its octree, and positions averaged in a leaf.
        reserve: seconds that the octree and the scores take after the training.
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
    illumination: tuple[int, int]
    paper: ScaleName
    network_lamp: str
    network: TrainConfig
    octree: tuple[int, int]
    reserve: float
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
            BakeConfig.of("preview"),
            parts=PARTS,
            octree=dataclasses.replace(
                BakeConfig.of("preview").octree, time=None, rays=1 << 20, tree_depth=7
            ),
            irradiance_paths=0,
        ),
        patience=1.0,
        illumination=(480, 64),
        paper="gpu",
        network_lamp="dallas",
        network=TrainConfig(),
        octree=(8, 64),
        reserve=90.0,
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
            irradiance_paths=0,
            light=LightFieldConfig(paths=1 << 16, batch=1 << 16, depth=3, resolution=16),
            octree=OctreeConfig(
                time=None,
                rays=1 << 14,
                tree_depth=4,
                l_max=0,
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
        illumination=(32, 1),
        paper="test",
        network_lamp="neoclassical",
        network=dataclasses.replace(SCALES["test"].network, num_steps=600),
        octree=(4, 4),
        reserve=60.0,
        tests={"kernels": ("tests/rendering/test_alias_table.py",)},
        test_seconds=120.0,
    ),
}
