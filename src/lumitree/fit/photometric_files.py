"""Bakes of photometric files and ray files, and which settings of `bake` apply to them."""

import warnings
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from lumitree.asset.asset import Part
from lumitree.core.files import FilePath
from lumitree.core.progress import ProgressCallback, reporting
from lumitree.core.progress import progress as steps
from lumitree.core.stopwatch import Stopwatch
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.fit.result import BakeResult
from lumitree.fit.work import save_asset
from lumitree.lamp.source import LuminaireSource, as_source, refuse_options, source_kind
from lumitree.trace.light_field_config import EXITANT_QUALITIES

# Settings of `bake` that apply.
_SETTINGS = ("quality", "parts", "lumens", "temperature")


def bake_photometric_file(
    source: Any,
    output: FilePath | None,
    parts: Collection[Part] | None,
    quality: str,
    lumens: float | None,
    temperature: float | None,
    progress: ProgressCallback | None,
    others: dict[str, Any],
) -> BakeResult:
    """`bake` for a photometric file or ray file.

    Args:
        source: path, or a `LuminaireSource` of one.
        output, parts, quality, lumens, temperature, progress: as for `bake`.
        others: arguments of `bake` that do not apply; all must be None or 0.
    """
    described = as_source(source)
    refuse_options(described, "a photometric file")
    path = described.name
    if given := [name for name, value in others.items() if value]:
        raise LumitreeError(
            f"{', '.join(given)}: not for a photometric file such as {shown(path, 300)}, from "
            "which only the exitant light field is made; leave it out"
        )
    if parts is not None and set(parts) != {"exitant"}:
        raise LumitreeError(
            f"parts are {', '.join(parts)}, but {shown(path, 300)} is a photometric file, of which "
            "only the part exitant can be made; leave the others out"
        )
    from lumitree.formats.light_field import bake_file
    from lumitree.rendering.asset_flux import with_light

    watch = Stopwatch()
    with (
        reporting(progress),
        steps(f"light of {shown(Path(path).name)}", 1) as advance,
        watch.stage("exitant"),
    ):
        config = EXITANT_QUALITIES[quality]
        asset = with_light(bake_file(path, config), lumens, temperature)
        advance(1)
    return BakeResult(asset=asset, path=save_asset(asset, output), **watch.costs())


def applicable_settings(settings: dict[str, Any], source: LuminaireSource) -> dict[str, Any]:
    """The settings of a bake of many lamps that apply to one of them."""
    if source_kind(source) != "photometric":
        return settings
    parts = settings["parts"]
    known = {name: settings[name] for name in _SETTINGS}
    return known | {"parts": None if parts is None or "exitant" in parts else parts}


def warn_of_unused(sources: Iterable[LuminaireSource], settings: Mapping[str, Any]) -> None:
    """Say once which settings of a bake of many lamps do not apply to its photometric files.

    Args:
        settings: those that are not the defaults.
    """
    names = [source.name for source in sources if source_kind(source) == "photometric"]
    unused = [name for name, value in settings.items() if name not in _SETTINGS and value]
    unused += [f"part {part}" for part in settings.get("parts") or () if part != "exitant"]
    if names and unused:
        warnings.warn(
            f"{shown_names(names)}: {', '.join(unused)} not used for photometric files, from which "
            "only the exitant light field is made",
            LumitreeWarning,
            stacklevel=4,
        )
