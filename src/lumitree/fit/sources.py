"""A bake of a source of any kind, by the function for its kind."""

import dataclasses
import warnings
from collections.abc import Iterable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from lumitree.asset.asset import Part
from lumitree.core.files import FilePath
from lumitree.core.progress import ProgressCallback, show_progress
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.fit.bake import bake, bake_views
from lumitree.fit.config import QUALITIES, BakeConfig
from lumitree.fit.photometric_files import bake_photometric
from lumitree.fit.result import BakeResult
from lumitree.lamp.source import RAY_SUFFIXES, LuminaireSource, source_kind

# Fields of `BakeConfig` that photometric files use.
PHOTOMETRIC_SETTINGS = ("light_field", "lumens", "temperature")


def bake_source(
    source: Any,
    output: FilePath,
    config: BakeConfig,
    *,
    work: FilePath | None = None,
    variant: str | None = None,
    executor: Executor | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Bake what `bake`, `bake_views` or `bake_photometric` take.

    Args:
        source: a luminaire, the folder of a dataset, or a photometric file.
        output, work, variant, progress: as for `bake`.
        config: settings, of which those are used that apply to the source; see
            `inapplicable`.
        executor: as for `bake`; not used for other sources, of which no light paths are traced.

    Raises:
        LumitreeError: the parts of `config` cannot be made of the source; or as for the function.
    """
    lumens, temperature = config.lumens, config.temperature
    match source_kind(source):
        case "photometric":
            if config.parts not in (None, ("light",)):
                raise _parts_error(config, source, "a photometric file", "light")
            return bake_photometric(
                source,
                output,
                light_field=config.light_field,
                lumens=lumens,
                temperature=temperature,
                variant=variant,
                progress=progress,
            )
        case "dataset":
            if config.parts not in (None, ("field",)):
                raise _parts_error(config, source, "a dataset", "field")
            return bake_views(
                source,
                output,
                config.octree_fit,
                lumens=lumens,
                temperature=temperature,
                work=work,
                variant=variant,
                progress=progress,
            )
        case _:
            return bake(
                source,
                output,
                config,
                work=work,
                variant=variant,
                executor=executor,
                progress=progress,
            )


def _parts_error(config: BakeConfig, source: Any, kind: str, part: Part) -> LumitreeError:
    return LumitreeError(
        f"parts are {', '.join(config.parts or ())}, but {shown(source, 300)} is {kind}, of which "
        f"only the part {part} can be made; leave the others out"
    )


def inapplicable(source: Any) -> tuple[str, ...]:
    """Names of the fields of `BakeConfig`, and of groups in them, that a source does not use."""
    match source_kind(source):
        case "photometric":
            used: tuple[str, ...] = ("parts", "lumens", "temperature")
            if Path(str(source)).suffix.lower() in RAY_SUFFIXES:
                used += ("light_field",)
            return tuple(name for name in vars(BakeConfig.standard()) if name not in used)
        case "dataset":
            return ("irradiance_paths", "light_field", "octree.estimate")
        case _:
            return ("octree.views",)


def applicable(config: BakeConfig, source: LuminaireSource) -> BakeConfig:
    """Settings of a list of lamps for one of them: of a photometric file, the part it can have."""
    if source_kind(source) != "photometric" or "light" not in (config.parts or ()):
        return config
    return dataclasses.replace(config, parts=None)


def warn_of_unused(sources: Iterable[LuminaireSource], config: BakeConfig) -> None:
    """Say once which settings of a bake of many lamps do not apply to its photometric files.

    Settings that a quality has are not named, since a quality is for lamps of all kinds.
    """
    names = [source.name for source in sources if source_kind(source) == "photometric"]
    own = [
        name
        for name, value in vars(config).items()
        if all(value != getattr(quality, name) for quality in QUALITIES.values())
    ]
    unused = [name for name in own if name not in (*PHOTOMETRIC_SETTINGS, "parts")]
    unused += [f"part {part}" for part in config.parts or () if part != "light"]
    if names and unused:
        warnings.warn(
            f"{shown_names(names)}: {', '.join(unused)} not used for photometric files, from which "
            "only the light field is made",
            LumitreeWarning,
            stacklevel=4,
        )
