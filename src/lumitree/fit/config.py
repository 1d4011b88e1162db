"""Settings of whole bakes, and what each quality means.

`BakeConfig` has the settings of all bakes as fields, and the settings of the light field, of the
octree fit and of the network as groups. It is checked when it is made, and passed on unchanged.
"""

import dataclasses
import warnings
from collections.abc import Collection, Sequence
from typing import Any, Literal, get_args

from lumitree.asset.asset import PARTS, Part
from lumitree.core.arguments import (
    MAX_SAMPLES,
    check_choice,
    check_choices,
    check_count,
    check_image_settings,
    check_light,
)
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.octree.config import EstimateConfig, OctreeConfig, RefineConfig
from lumitree.lamp.dataset import MAX_VIEWS
from lumitree.lamp.source import RAY_SUFFIXES, Kind, photometric_suffix, source_kind
from lumitree.measure.irradiance import check_irradiance_paths
from lumitree.octree.build import check_tree_depth
from lumitree.trace.light_field_config import LightFieldConfig

Quality = Literal["preview", "standard", "high", "paper"]
Method = Literal["octree", "network"]
_QUALITIES: dict[Method, tuple[Quality, ...]] = {
    "octree": ("preview", "standard", "high"),
    "network": ("preview", "paper"),
}
# Sources that are no luminaires: what they are called, and the only part that can be made of them.
KINDS: dict[Kind, str] = {"photometric": "a photometric file", "dataset": "a dataset"}
ONLY_PARTS: dict[Kind, Part] = {"photometric": "light", "dataset": "field"}
_FIT = ("octree", "time", "rays")
_WORKERS = ("executor", "workers", "scheduler")
# Settings that they do not use: arguments and options of `bake`, and keys of files of settings.
_UNUSED: dict[Kind, tuple[str, ...]] = {
    "photometric": (
        *("quality", "method", "light", "network", "irradiance_paths", "seed", "work"),
        *(*_FIT, *_WORKERS),
    ),
    "dataset": ("method", "light", "network", "irradiance_paths", "octree.estimate", *_WORKERS),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """Settings of the radiance field by the network of the paper. The defaults take minutes.

    Attributes:
        views: number of captured views, 1 to 100,000.
        resolution: pixels per side of a view, 1 to 16,384.
        spp: paths per pixel of a view, 1 to 1,048,576.
        tree_depth: level of the leaves, 1 to 10.
        samples_per_leaf: positions per leaf at which the network is evaluated, 1 to 1,048,576.
        train: settings of the network and of its training.

    Raises:
        LumitreeError: a setting is out of range.
    """

    views: int = 60
    resolution: int = 192
    spp: int = 48
    tree_depth: int = 7
    samples_per_leaf: int = 64
    train: TrainConfig = dataclasses.field(default_factory=TrainConfig.preview)

    def __post_init__(self) -> None:
        check_count("views", self.views, 1, MAX_VIEWS)
        check_image_settings(resolution=self.resolution, spp=self.spp)
        check_tree_depth(self.tree_depth)
        check_count("samples_per_leaf", self.samples_per_leaf, 1, MAX_SAMPLES)
        if self.train.emission_weights != "decrease":
            raise LumitreeError(
                f"train.emission_weights is {self.train.emission_weights}; expected decrease, as "
                "no asset has others"
            )


@dataclasses.dataclass(frozen=True, kw_only=True)
class BakeConfig:
    """Settings of a bake. The defaults are the quality "standard".

    `BakeConfig.of` returns the settings of a quality; `dataclasses.replace` changes some of them.

    Attributes:
        method: how a radiance field is made: "octree", by gradient descent from traced rays; or
            "network", as in the paper: views, a network, and an octree of its output.
        parts: what the asset gets. "light": the light field, 5 to 12 s on 2 CPU cores; it
            illuminates scenes. "field": the radiance field, which images show; without the part
            "light", a light field is made of its rays. Without a field images show the light field,
            which is blurred and lets all light through. "geometry": the luminaire itself, which
            images under `lumitree_path` show in place of the field; beside one of the other two. A
            part that is named here and cannot be made is an error. None: "light" and "geometry",
            which images under `lumitree_path` need; "light" and "field" by the method "network",
            and, with a warning, for a luminaire that cannot be stored because it has something that
            is not listed in docs/format.md.
        irradiance_paths: number of light paths, and of rays of the asset, by which the irradiance
            around the asset is compared with the irradiance around the luminaire at the end, as in
            `evaluate`; 0 to 67,108,864. 2¹⁸ to 2²⁰ take 1 to 10 s on 2 CPU cores; with 2¹⁸ the mean
            of a face has a standard error of 0.4 to 1.4 %. 0: it is not compared.
        lumens: luminous flux of the asset, lm, if lengths of the luminaire are in metres; 10⁻⁶ to
            10⁹. None: the flux of the luminaire.
        temperature: colour temperature of the whole flux of the asset, K, 1000 to 20,000. One
            factor for each of R, G and B gives the whole flux the chromaticity of a black body and
            keeps its luminous flux: a coloured part of a lamp stays coloured relative to the
            others. None: the colours of the luminaire.
        seed: root seed of all random numbers, 0 to 2³¹ - 1. With `octree.rays` and without
            `octree.time`, equal seeds and settings give equal files on one machine. Views do not
            depend on it.
        light: settings of the light field.
        octree: settings of the octree fit.
        network: settings of the network.

    Raises:
        LumitreeError: a setting is out of range.
    """

    method: Method = "octree"
    parts: Collection[Part] | None = None
    irradiance_paths: int = 1 << 18
    lumens: float | None = None
    temperature: float | None = None
    seed: int = 0
    light: LightFieldConfig = dataclasses.field(default_factory=LightFieldConfig)
    octree: OctreeConfig = dataclasses.field(default_factory=OctreeConfig)
    network: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        for name, kind in _GROUPS.items():
            _check_kind(name, getattr(self, name), kind)
        check_choice("method", self.method, get_args(Method))
        if self.parts is not None:
            check_choices("part", self.parts, PARTS)
            if not set(self.parts) - {"geometry"}:
                raise LumitreeError(
                    f"parts are {', '.join(self.parts) or 'none'}; expected light, field or "
                    "both, and geometry"
                )
            # In one order, so that equal parts are equal settings.
            object.__setattr__(self, "parts", tuple(each for each in PARTS if each in self.parts))
        if self.method == "network" and self.parts not in (None, ("field",), ("light", "field")):
            raise LumitreeError(
                f"parts are {', '.join(self.parts or ())}; expected field, or light and field, by "
                "the method network"
            )
        check_irradiance_paths(self.irradiance_paths)
        check_light(self.lumens, self.temperature)
        check_seed(self.seed)

    @staticmethod
    def of(quality: Quality | None = None, method: Method = "octree") -> "BakeConfig":
        """Settings of a quality.

        Args:
            quality: "preview", "standard" or "high": 1, 2 or 16 million light paths, 5 to 30 s on 2
                CPU cores, and a radiance field, if one is made, of tree depth 7 in 1 minute, of
                depth 8 in 5 minutes, or of depth 10 in 30 minutes. By the method "network",
                "preview": a field in minutes on 2 CPU cores; or "paper": the settings of the paper,
                hours on a GPU. Default: "standard", or "preview" by the method "network".
            method: see `BakeConfig`.

        Raises:
            LumitreeError: the method has no such quality.
        """
        check_choice("method", method, _QUALITIES)
        if quality is None:
            quality = "standard" if method == "octree" else "preview"
        check_choice(f"quality of the method {method}", quality, _QUALITIES[method])
        if quality == "paper":
            # The paper does not state its samples per pixel.
            network = NetworkConfig(
                views=100,
                resolution=800,
                spp=256,
                tree_depth=10,
                samples_per_leaf=256,
                train=TrainConfig(),
            )
            high = BakeConfig.of("high")
            return dataclasses.replace(high, method=method, network=network)
        if quality == "preview":
            return BakeConfig(
                method=method,
                light=LightFieldConfig(paths=1 << 20),
                octree=OctreeConfig(
                    time=60.0,
                    tree_depth=7,
                    estimate=EstimateConfig(rays=1 << 22, growth_rays=1 << 21),
                ),
            )
        if quality == "high":
            return BakeConfig(
                irradiance_paths=1 << 20,
                light=LightFieldConfig(paths=1 << 24),
                # With ten times as many leaves, few rays a step would not cross most of them.
                octree=OctreeConfig(time=1740.0, tree_depth=10, refine=RefineConfig(rays=1 << 17)),
            )
        return BakeConfig()


_GROUPS = {"light": LightFieldConfig, "octree": OctreeConfig, "network": NetworkConfig}


def _check_kind(name: str, value: object, kind: type) -> None:
    """Refuse settings that are no object of their class."""
    if not isinstance(value, kind):
        raise LumitreeError(
            f"{name} is {shown(repr(value), 60)}; expected an object of {kind.__name__}"
        )


def chosen_config(
    config: BakeConfig | None = None,
    *,
    quality: Quality | None = None,
    method: Method | None = None,
    time: float | None = None,
    rays: int | None = None,
    **settings: Any,
) -> BakeConfig:
    """`config`, or the settings of a quality, with the arguments of `bake` that are not None.

    Args:
        time, rays: budget of the octree fit; a budget of rays alone has no limit of time.
        settings: other fields of `BakeConfig`.

    Raises:
        LumitreeError: `config` and a quality or a method are given, or a setting is out of range.
    """
    if config is None:
        config = BakeConfig.of(quality, method or "octree")
    elif quality is not None or method is not None:
        given = "method" if quality is None else "quality"
        raise LumitreeError(f"config and {given} are given; leave one of them out")
    _check_kind("config", config, BakeConfig)
    octree = config.octree
    if time is not None or rays is not None:
        octree = dataclasses.replace(octree, time=time, rays=octree.rays if rays is None else rays)
    given = {name: value for name, value in settings.items() if value is not None}
    return dataclasses.replace(config, octree=octree, **given)


def refuse_unused(names: Collection[str], config: BakeConfig, sources: Sequence[object]) -> None:
    """Refuse settings that no source uses; warn of settings that only some sources use.

    Args:
        names: the settings that are given: arguments and options of `bake`, and keys of a file of
            settings, with the keys of its tables after a dot.
        config: all settings.
        sources: what is baked, each in any form that `bake` takes.

    Raises:
        LumitreeError: there are such settings; it states why they are not used.
    """
    unused = [_unused(config, source) for source in sources]
    refused: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        without = [source for source, each in zip(sources, unused, strict=True) if name in each]
        if without and len(without) == len(sources):
            refused.setdefault(unused[0][name], []).append(name)
        elif without:
            more = f" and {len(without) - 1} more" if len(without) > 1 else ""
            message = f"{name}: not used for {shown(without[0], 200)}{more}"
            warnings.warn(message, LumitreeWarning, stacklevel=3)
    if refused:
        reason, found = next(iter(refused.items()))
        raise LumitreeError(f"{', '.join(found)}: {reason}")


def _unused(config: BakeConfig, source: object) -> dict[str, str]:
    """The settings that the bake of a source does not use, and why."""
    if (kind := source_kind(source)) in _UNUSED:
        reason = f"not for {KINDS[kind]} such as {shown(source, 300)}; leave it out"
        unused = dict.fromkeys(_UNUSED[kind], reason)
        if kind == "photometric" and photometric_suffix(str(source)) in RAY_SUFFIXES:
            del unused["light"]
        return unused
    unused = {"octree.views": "only for a dataset; leave it out"}
    if config.method == "network":
        unused |= dict.fromkeys(_FIT, "of the method octree; leave it out")
    else:
        unused["network"] = "for the method network; add the method, or leave it out"
        if "field" not in (config.parts or ()):
            reason = "for the radiance field, which is not made; add the part field"
            unused |= dict.fromkeys(_FIT, reason)
    if "light" not in (config.parts or ("light",)):
        names = ("light",) if config.method == "network" else ("light", *_WORKERS)
        unused |= dict.fromkeys(names, "for the part light, which is not made; leave it out")
    return unused
