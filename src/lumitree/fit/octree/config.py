"""Settings of the octree fit: every number that was chosen by experience or by measurement.

Each part of the bake takes one group. The evidence is in docs/decisions: octree-fit.md,
calibration.md, and field.md for the headroom. A setting that is not there was chosen during
development and not compared.
The settings are part of the saved state of a bake: a state is only continued with equal ones.
"""

import dataclasses
from typing import Any

from lumitree.core.arguments import MAX_RAYS, MAX_SECONDS, check_choice, check_count, check_range
from lumitree.core.harmonics import MAX_L
from lumitree.core.transmittance import LAWS, Law
from lumitree.errors import LumitreeError
from lumitree.octree.build import MAX_TREE_DEPTH, check_tree_depth

# Rays come in tiles of this many rays a side: neighbours, which a vector unit traces together. No
# setting, since means and uncertainties over tiles depend on it.
TILE_SIDE = 4
TILE_RAYS = TILE_SIDE**2


_FACTOR = 1e-6, 1e6
_LEVEL = 1, MAX_TREE_DEPTH
_SHARE = 0.0, 1.0
_EMISSION = 1e-9, 0.999
_DECAY = 0.0, 0.9999
_INTERVAL = 1e-3, 1.0
_PRIOR = 1e-3, 1e9
_PATHS_PER_RAY = 1e-3, 1e3
_RAYS = TILE_RAYS, 1 << 30


def _setting(default: Any, limits: tuple[float, float]) -> Any:
    """Field of a group with a default, from the first to the second of two limits."""
    return dataclasses.field(default=default, metadata={"limits": limits})


@dataclasses.dataclass(frozen=True)
class _Settings:
    """Numbers within the limits of their fields; counts of rays are whole tiles.

    Raises:
        LumitreeError: a setting is out of range.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if (limits := field.metadata.get("limits")) is None:
                continue
            value = getattr(self, field.name)
            check = check_count if type(field.default) is int else check_range
            check(field.name, value, *limits)
            if limits == _RAYS and value % TILE_RAYS:
                raise LumitreeError(f"{field.name} is {value}; expected a multiple of {TILE_RAYS}")


@dataclasses.dataclass(frozen=True)
class MaxRadianceConfig(_Settings):
    """How the upper end of the emission, L_max of the asset, is found.

    Attributes:
        rays: rays traced, in tiles that are as wide as a pixel.
        paths: camera paths a ray.
        headroom: L_max over the 99.99th percentile of the radiance of pixels. A thin filament
            outshines its pixel, in a leaf that hides only part of it.
    """

    rays: int = _setting(1 << 21, _RAYS)
    paths: int = _setting(2, (1, 1 << 16))
    headroom: float = _setting(4.0, (1.0, 1e6))


@dataclasses.dataclass(frozen=True)
class EstimateConfig(_Settings):
    """The first octree, from statistics of rays (`estimate`, `growth`).

    Attributes:
        rays: rays traced for the statistics, rounded up to whole batches.
        growth_rays: rays that decide which cells of the last level are visited; earlier levels get
            a quarter of the next one's, but at least one batch.
        batch_rays: rays traced at once; bounds the memory.
        light_paths_per_ray: light paths traced for each ray.
        start_level: level at which the octree starts to grow.
        max_level: level of the leaves, unless the smallest leaves of the bake are larger. Finer
            leaves come from splitting.
        logit_directions: number of directions at which a leaf's fit of radiance is converted to
            logits.
        min_emission, max_emission: range, in units of L_max, that the fitted radiance is clipped to
            before it is converted to logits.
        prior_paths: pseudo-count of paths that agree with the fit of the leaf's parent, or with
            black where it has none.
        prior_band_paths: added to `prior_paths`, times l², for band l.
        opaque_from: opacity above which a leaf is made opaque.
    """

    rays: int = _setting(1 << 23, _RAYS)
    growth_rays: int = _setting(1 << 22, _RAYS)
    batch_rays: int = _setting(1 << 20, _RAYS)
    light_paths_per_ray: float = _setting(0.5, _PATHS_PER_RAY)
    start_level: int = _setting(5, _LEVEL)
    max_level: int = _setting(8, _LEVEL)
    logit_directions: int = _setting(32, (1, 1 << 16))
    min_emission: float = _setting(1e-5, _EMISSION)
    max_emission: float = _setting(0.99, _EMISSION)
    prior_paths: float = _setting(20.0, _PRIOR)
    prior_band_paths: float = _setting(200.0, (0.0, 1e9))
    opaque_from: float = _setting(0.9, _SHARE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_emission < self.max_emission:
            raise LumitreeError(
                f"min_emission {self.min_emission:g} is not below max_emission "
                f"{self.max_emission:g}"
            )


@dataclasses.dataclass(frozen=True)
class ViewsConfig(_Settings):
    """Bakes from stored views, which start from their visual hull.

    Attributes:
        held_out_stride: one view in this many is held out for the score.
        hull_level: level of the leaves of the hull, unless the smallest leaves are larger.
        hull_optical_depth: initial optical depth across a leaf of the hull.
        hull_emission: initial emission, in units of L_max.
        coefficient_rate_factor: factor on `RefineConfig.coefficient_rate`, since the hull is
            farther from the result than a first estimate is.
    """

    held_out_stride: int = _setting(8, (2, 1 << 16))
    hull_level: int = _setting(6, _LEVEL)
    hull_optical_depth: float = _setting(0.3, _FACTOR)
    hull_emission: float = _setting(0.01, _EMISSION)
    coefficient_rate_factor: float = _setting(4.0, _FACTOR)


@dataclasses.dataclass(frozen=True)
class CalibrationConfig(_Settings):
    """Calibration of the field's emission against the light of the luminaire (`calibration`).

    Attributes:
        rounds: rounds; round n counts for 1 / (n - 1) from the third on.
        rays: rays drawn for each half of a round.
        light_paths_per_ray: light paths traced for each ray.
        coarsest_level, finest_level: levels of the cells whose leaves are scaled together; coarser
            cells first.
        max_band: highest band of the shift of a cell's logits.
        prior_paths: pseudo-count of paths of the region that agree with the field.
        region_levels: levels from a cell up to the region in which the light that one path brings
            is measured; a single cell has too few paths for that.
        min_factor: smallest mean factor on the emission of a cell in one round.
        max_shift: largest shift of a logit in one round.
    """

    rounds: int = _setting(4, (0, 1 << 16))
    rays: int = _setting(1 << 17, _RAYS)
    light_paths_per_ray: float = _setting(0.5, _PATHS_PER_RAY)
    coarsest_level: int = _setting(3, _LEVEL)
    finest_level: int = _setting(5, _LEVEL)
    max_band: int = _setting(1, (0, MAX_L))
    prior_paths: float = _setting(1000.0, _PRIOR)
    region_levels: int = _setting(3, (0, MAX_TREE_DEPTH))
    min_factor: float = _setting(0.1, (1e-6, 1.0))
    max_shift: float = _setting(2.0, (0.0, 1e6))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.region_levels <= self.coarsest_level <= self.finest_level:
            raise LumitreeError(
                f"region_levels {self.region_levels}, coarsest_level {self.coarsest_level} and "
                f"finest_level {self.finest_level} must not descend"
            )


@dataclasses.dataclass(frozen=True)
class FluxConfig(_Settings):
    """The flux correction factor (`flux_correction`).

    The noise of rays dominates, so that light paths may be few.

    Attributes:
        draws: draws; together they estimate the factor to ±0.5 %, a single one to ±1.5 %.
        rays: rays of a draw.
        light_paths_per_ray: light paths traced for each ray.
    """

    draws: int = _setting(8, (1, 1 << 16))
    rays: int = _setting(1 << 20, _RAYS)
    light_paths_per_ray: float = _setting(1 / 16, _PATHS_PER_RAY)


@dataclasses.dataclass(frozen=True)
class HeldOutConfig(_Settings):
    """The rays that a bake is scored on and does not learn from (`heldout`).

    Attributes:
        rays: rays.
        paths: camera paths for each of a ray's two independent estimates of radiance.
    """

    rays: int = _setting(1 << 17, _RAYS)
    paths: int = _setting(8, (1, 1 << 16))


@dataclasses.dataclass(frozen=True)
class RefineConfig(_Settings):
    """Gradient descent on the leaves (`refine`).

    Attributes:
        rays: rays drawn for a step; those that cross no leaf cost little.
        light_paths_per_ray: light paths traced for each ray.
        opacity_rays_per_ray: further rays, for their transmittance only; one costs a third of a
            ray.
        epsilon: of the loss, in units of L_max. 0.002 of the 99.99th percentile of radiance.
        opacity_weight: of the squared error of the transmittance in the loss.
        density_rate: initial step of Adam for log density.
        coefficient_rate: initial step of Adam for coefficients.
        final_rate: final step over initial step; steps fall exponentially with the budget spent,
            and `smoothing` with them.
        mean_decay, square_decay: Adam's decay of the mean of gradients, and of their squares.
        smoothing: part of the way by which coefficients are first regularised towards the mean of
            the neighbouring leaves'.
        smoothing_interval: steps from one regularisation to the next.
    """

    rays: int = _setting(1 << 15, _RAYS)
    light_paths_per_ray: float = _setting(0.5, _PATHS_PER_RAY)
    opacity_rays_per_ray: int = _setting(4, (1, 1 << 10))
    epsilon: float = _setting(0.0005, (1e-9, 1.0))
    opacity_weight: float = _setting(5.0, (0.0, 1e6))
    density_rate: float = _setting(0.15, _FACTOR)
    coefficient_rate: float = _setting(0.03, _FACTOR)
    final_rate: float = _setting(0.05, (1e-9, 1.0))
    mean_decay: float = _setting(0.9, _DECAY)
    square_decay: float = _setting(0.98, _DECAY)
    smoothing: float = _setting(0.5, _SHARE)
    smoothing_interval: int = _setting(8, (1, 1 << 30))


@dataclasses.dataclass(frozen=True)
class SplitConfig(_Settings):
    """Which leaves are split, and which are dropped (`refine`).

    Attributes:
        indicator_rays: rays of a batch from which the per-leaf error indicator is computed.
        indicator_batches: number of batches.
        indicator_opacity_weight: weight of the squared error of the transmittance beside the
            squared relative error of the radiance; at 500, 0.045 of opacity counts as much as a
            radiance that is wrong by 100 %.
        covered_error: share of the summed indicator that the leaves to be split account for.
        max_leaves: splitting makes no more leaves than this.
        min_optical_depth: leaves with a smaller optical depth across are dropped.
    """

    indicator_rays: int = _setting(1 << 20, _RAYS)
    indicator_batches: int = _setting(4, (1, 1 << 16))
    indicator_opacity_weight: float = _setting(500.0, (0.0, 1e6))
    covered_error: float = _setting(0.99, _SHARE)
    max_leaves: int = _setting(3_000_000, (1, 1 << 30))
    min_optical_depth: float = _setting(2e-3, (0.0, 1e6))


@dataclasses.dataclass(frozen=True)
class ScheduleConfig(_Settings):
    """When during the descent things happen.

    Attributes:
        score_interval: share of the budget between two scores on the held-out rays. Not a time, so
            that with a budget of rays the field that is kept does not depend on the machine.
        split_interval: share of the budget between two times at which leaves are split.
        last_split: share of the budget after which none are.
        closing_calibrations: time reserved for what follows the descent, in units of the time that
            the last calibration took.
    """

    score_interval: float = _setting(0.04, _INTERVAL)
    split_interval: float = _setting(0.15, _INTERVAL)
    last_split: float = _setting(0.65, _SHARE)
    closing_calibrations: float = _setting(2.5, (0.0, 1e6))


@dataclasses.dataclass(frozen=True, kw_only=True)
class OctreeConfig(_Settings):
    """Settings of the octree fit.

    Attributes:
        time: budget of the radiance field in seconds, 0.001 to 31,536,000 (one year). The first
            estimate, about 20 s on 2 CPU cores, is always completed. None: no limit; `rays` is
            then needed.
        rays: budget of rays for the gradient descent, 1 to 2⁵⁰. The fit ends at whichever of
            `time` and `rays` is reached first. None: no limit.
        tree_depth: level of the smallest leaves, 1 to 10. Their side is the longest side of the
            bounding box divided by 2^tree_depth.
        l_max: highest band of the spherical harmonics, 0 to 4. Each leaf stores (l_max + 1)²
            coefficients per RGB channel.
        law: transmittance T as a function of the optical depth τ: "exponential", exp(-τ), or
            "linear", max(0, 1 - τ).
        ray_spacing_level: neighbouring rays of a tile are as far apart as leaves of this level, or
            of the smallest leaves if those are larger. Closer rays show a leaf from too few
            directions; rays farther apart are slower to trace.
        max_radiance, estimate, views, calibration, flux, held_out, refine, split, schedule:
            settings of the parts of the fit.

    Raises:
        LumitreeError: a setting is out of range, or neither `time` nor `rays` is given.
    """

    time: float | None = 285.0
    rays: int | None = None
    tree_depth: int = 8
    l_max: int = 2
    law: Law = "exponential"
    ray_spacing_level: int = _setting(6, _LEVEL)
    max_radiance: MaxRadianceConfig = MaxRadianceConfig()
    estimate: EstimateConfig = EstimateConfig()
    views: ViewsConfig = ViewsConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    flux: FluxConfig = FluxConfig()
    held_out: HeldOutConfig = HeldOutConfig()
    refine: RefineConfig = RefineConfig()
    split: SplitConfig = SplitConfig()
    schedule: ScheduleConfig = ScheduleConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tree_depth(self.tree_depth)
        check_count("l_max", self.l_max, 0, MAX_L)
        check_choice("law", self.law, LAWS)
        if self.time is None and self.rays is None:
            raise LumitreeError("a bake needs a budget; give it a time or a number of rays")
        if self.time is not None:
            check_range("time", self.time, 1e-3, MAX_SECONDS, "seconds")
        if self.rays is not None:
            check_count("rays", self.rays, 1, MAX_RAYS)
