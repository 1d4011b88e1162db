"""Settings of whole bakes, and what each quality means.

`BakeConfig` has the settings that users choose as fields, and the settings of the light field and
of the octree fit as groups. It is checked when it is made, and passed on unchanged.
"""

import dataclasses
from collections.abc import Collection
from typing import Literal

from lumitree.asset.asset import PARTS, Part
from lumitree.core.arguments import (
    MAX_SAMPLES,
    check_choices,
    check_count,
    check_image_settings,
    check_light,
)
from lumitree.core.dataset import MAX_VIEWS
from lumitree.core.seeds import check_seed
from lumitree.core.transmittance import Law
from lumitree.errors import LumitreeError
from lumitree.fit.network.config import PRESETS, TrainConfig
from lumitree.fit.octree.config import EstimateConfig, OctreeConfig, OctreeFitConfig, RefineConfig
from lumitree.measure.irradiance_check import check_irradiance_paths
from lumitree.octree.build import check_tree_depth
from lumitree.trace.light_field_config import LightFieldConfig, LightFieldFitConfig

Quality = Literal["preview", "standard", "high"]
NetworkPreset = Literal["preview", "paper"]
NETWORK_PARTS: tuple[Part, ...] = ("light", "field")


@dataclasses.dataclass(frozen=True, kw_only=True)
class BakeConfig:
    """Settings of a bake by the octree fit. The defaults are the quality "standard".

    `BakeConfig.preview()`, `standard()` and `high()` return the settings of a quality;
    `dataclasses.replace` changes some of them.

    Attributes:
        parts: what the asset gets. "light": the light field, 5 to 12 s on 2 CPU cores; it
            illuminates scenes. "field": the radiance field; images show it, and it illuminates if
            there is no light field. Without it images show the light field, which
            is blurred and lets all light through. "geometry": the luminaire itself, which images
            under `lumitree_path` show in place of the field; beside one of the other two. A part
            that is asked for and cannot be made is an error. None: what images under
            `lumitree_path` need, "light" and "geometry"; of a luminaire that cannot be stored,
            because it has what is not listed in docs/format.md, "light" and "field", with a
            warning.
        time: budget of the radiance field in seconds, 0.001 to 31,536,000 (one year). The first
            estimate, about 20 s on 2 CPU cores, is always completed. None: no limit; `rays` is
            then needed.
        rays: budget of rays for the gradient descent, 1 to 2⁵⁰. The bake ends at whichever of
            `time` and `rays` is reached first. None: no limit.
        tree_depth: level of the smallest leaves, 1 to 10. Their side is the longest side of the
            bounding box divided by 2^tree_depth.
        l_max: highest band of the spherical harmonics, 0 to 4. Each leaf stores (l_max + 1)²
            coefficients per RGB channel.
        law: transmittance T as a function of the optical depth τ: "exponential", exp(-τ), or
            "linear", max(0, 1 - τ).
        irradiance_paths: number of light paths, and of rays of the asset, by which the irradiance
            around the asset is compared with that around the luminaire at the end, as in
            `evaluate`; 0 to 67,108,864. 2¹⁸ to 2²⁰ take 1 to 10 s on 2 CPU cores; with 2¹⁹ the mean
            of a face has a standard error of 0.3 to 1 %. 0: it is not compared.
        lumens: luminous flux of the asset, lm, if lengths of the luminaire are in metres; 10⁻⁶ to
            10⁹. None: that of the luminaire.
        temperature: colour temperature of the whole flux of the asset, K, 1000 to 20,000. One
            factor for each of R, G and B gives the whole flux the chromaticity of a black body and
            keeps its luminous flux: a coloured part of a lamp stays coloured relative to the
            others. None: the colours of the luminaire.
        seed: root seed of all random numbers, 0 to 2³¹ - 1. With `rays` and without `time`, equal
            seeds and settings give equal files on one machine.
        light_field: settings of the light field.
        octree: settings of the octree fit.

    Raises:
        LumitreeError: a setting is out of range.
    """

    parts: Collection[Part] | None = None
    time: float | None = 285.0
    rays: int | None = None
    tree_depth: int = 8
    l_max: int = 2
    law: Law = "exponential"
    irradiance_paths: int = 1 << 19
    lumens: float | None = None
    temperature: float | None = None
    seed: int = 0
    light_field: LightFieldConfig = dataclasses.field(default_factory=LightFieldConfig)
    octree: OctreeConfig = dataclasses.field(default_factory=OctreeConfig)

    def __post_init__(self) -> None:
        if self.parts is not None:
            check_choices("part", self.parts, PARTS)
            if not set(self.parts) - {"geometry"}:
                raise LumitreeError(
                    f"parts are {', '.join(self.parts) or 'none'}; expected light, field or "
                    "both, and geometry"
                )
            # In one order, so that equal parts are equal settings.
            object.__setattr__(self, "parts", tuple(each for each in PARTS if each in self.parts))
        check_irradiance_paths(self.irradiance_paths)
        check_light(self.lumens, self.temperature)
        # Checks what it contains.
        _ = self.octree_fit

    @property
    def light_field_fit(self) -> LightFieldFitConfig:
        """Settings of the bake of the light field."""
        return light_field_fit(self.light_field, self.seed)

    @property
    def octree_fit(self) -> OctreeFitConfig:
        """Settings of the bake of the radiance field."""
        groups = self.octree
        # Not `dataclasses.replace`: editors cannot follow its keywords to the fields.
        return OctreeFitConfig(
            tree_depth=self.tree_depth,
            l_max=self.l_max,
            law=self.law,
            time=self.time,
            rays=self.rays,
            seed=self.seed,
            ray_spacing_level=groups.ray_spacing_level,
            max_radiance=groups.max_radiance,
            estimate=groups.estimate,
            views=groups.views,
            calibration=groups.calibration,
            flux=groups.flux,
            held_out=groups.held_out,
            refine=groups.refine,
            split=groups.split,
            schedule=groups.schedule,
        )

    @staticmethod
    def preview() -> "BakeConfig":
        """Half as many light paths; a field in 1 minute on 2 CPU cores, of tree depth 7."""
        return QUALITIES["preview"]

    @staticmethod
    def standard() -> "BakeConfig":
        """The defaults; a field in 5 minutes on 2 CPU cores, of tree depth 8."""
        return QUALITIES["standard"]

    @staticmethod
    def high() -> "BakeConfig":
        """Eight times as many light paths; a field in 30 minutes, of tree depth 10."""
        return QUALITIES["high"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """Settings of a bake by the network of the paper. The defaults are the preset "preview".

    `NetworkConfig.preview()` and `paper()` return the settings of a preset.

    Attributes:
        parts: what the asset gets, see `BakeConfig`: "field", which the network is trained for, and
            "light".
        num_views: number of captured views, 1 to 100,000.
        resolution: pixels per side of a view, 1 to 16,384.
        samples_per_pixel: paths per pixel of a view, 1 to 1,048,576.
        tree_depth: level of the leaves, 1 to 10.
        samples_per_leaf: positions per leaf at which the network is evaluated, 1 to 1,048,576.
        irradiance_paths: see `BakeConfig`.
        seed: root seed of the training and of the light field, 0 to 2³¹ - 1. Views do not
            depend on it.
        light_field: settings of the light field.
        train: settings of the network and of its training; its seed is 0, since that of the
            training is `seed`.

    Raises:
        LumitreeError: a setting is out of range.
    """

    parts: Collection[Part] = NETWORK_PARTS
    num_views: int = 60
    resolution: int = 192
    samples_per_pixel: int = 48
    tree_depth: int = 7
    samples_per_leaf: int = 64
    irradiance_paths: int = 1 << 18
    seed: int = 0
    light_field: LightFieldConfig = dataclasses.field(default_factory=LightFieldConfig)
    train: TrainConfig = PRESETS["preview"]

    def __post_init__(self) -> None:
        check_choices("part", self.parts, NETWORK_PARTS)
        if "field" not in self.parts:
            raise LumitreeError(
                f"parts are {', '.join(self.parts) or 'none'}; expected field, which the network "
                "is trained for: use bake for the others alone"
            )
        check_count("num_views", self.num_views, 1, MAX_VIEWS)
        check_image_settings(resolution=self.resolution, spp=self.samples_per_pixel)
        check_tree_depth(self.tree_depth)
        check_count("samples_per_leaf", self.samples_per_leaf, 1, MAX_SAMPLES)
        check_irradiance_paths(self.irradiance_paths)
        check_seed(self.seed)
        if self.train.seed:
            raise LumitreeError(
                f"train.seed is {self.train.seed}; expected 0: the training takes seed"
            )
        if self.train.emission_weights != "decrease":
            raise LumitreeError(
                f"train.emission_weights is {self.train.emission_weights}; expected decrease, as "
                "no asset has others"
            )

    @property
    def light_field_fit(self) -> LightFieldFitConfig:
        """Settings of the bake of the light field."""
        return light_field_fit(self.light_field, self.seed)

    @staticmethod
    def preview() -> "NetworkConfig":
        """A bake of minutes on 2 CPU cores."""
        return NETWORK_BAKES["preview"]

    @staticmethod
    def paper() -> "NetworkConfig":
        """The settings of the paper: days on a GPU."""
        return NETWORK_BAKES["paper"]


def light_field_fit(light_field: LightFieldConfig, seed: int) -> LightFieldFitConfig:
    """Settings of the bake of a light field with a root seed."""
    return LightFieldFitConfig(
        paths=light_field.paths,
        depth=light_field.depth,
        resolution=light_field.resolution,
        batch=light_field.batch,
        seed=seed,
    )


QUALITIES: dict[Quality, BakeConfig] = {
    "preview": BakeConfig(
        time=60.0,
        tree_depth=7,
        irradiance_paths=1 << 18,
        light_field=LightFieldConfig(paths=1 << 20),
        octree=OctreeConfig(estimate=EstimateConfig(rays=1 << 22, growth_rays=1 << 21)),
    ),
    "standard": BakeConfig(),
    "high": BakeConfig(
        time=1740.0,
        tree_depth=10,
        irradiance_paths=1 << 20,
        light_field=LightFieldConfig(paths=1 << 24),
        # With ten times as many leaves, few rays a step would cross most of them not at all.
        octree=OctreeConfig(refine=RefineConfig(rays=1 << 17)),
    ),
}

NETWORK_BAKES: dict[NetworkPreset, NetworkConfig] = {
    "preview": NetworkConfig(),
    # The paper does not state its samples per pixel.
    "paper": NetworkConfig(
        num_views=100,
        resolution=800,
        samples_per_pixel=256,
        tree_depth=10,
        samples_per_leaf=256,
        irradiance_paths=1 << 20,
        light_field=LightFieldConfig(paths=1 << 24),
        train=PRESETS["paper"],
    ),
}
