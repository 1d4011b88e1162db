"""Luminaires: built in, from files, from Mitsuba scenes."""

import dataclasses
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import MANIFEST
from lumitree.errors import LumitreeError, LumitreeWarning, explained
from lumitree.luminaire.source import LuminaireSource

if TYPE_CHECKING:
    from lumitree.luminaire.luminaire import Luminaire, LuminaireLike

# A file whose glass is wrong throughout is not to fill the terminal.
MAX_FAULTS = 5


def builtin_luminaires() -> dict[str, dict[str, Any]]:
    """Built-in luminaires by name: a description and figures of each.

    Returns:
        For each name `description`, `triangles`, `emitters`, `emitted_radiance` (the largest
        channel, W/(m² sr)), `size` (m) and `has_media`.
    """
    from lumitree.builtin.registry import BUILTIN
    from lumitree.model.figures import figures

    return {
        name: {"description": item.description, **dataclasses.asdict(figures(item.build()))}
        for name, item in BUILTIN.items()
    }


@explained
def load_luminaire(
    luminaire: "LuminaireLike",
    *,
    materials: str | os.PathLike[str] | None = None,
    keep: Sequence[str] = (),
    drop: Sequence[str] = (),
    variant: str | None = None,
) -> "Luminaire":
    """Load a luminaire once, for several calls that take one.

    Args:
        luminaire: name of a built-in luminaire; path of a Mitsuba 3 scene (`.xml`) or of a model
            (`.obj`, `.gltf`, `.glb`); a dictionary as for `mitsuba.load_dict`; or a `mi.Scene`.
        materials: TOML file of overrides of a model's materials, unit and up axis; by default the
            one beside the model, if there is one.
        keep: patterns with * and ? of the shapes (by id) or parts (by name or material) to take.
        drop: patterns of what to leave out.
        variant: Mitsuba variant, as for `bake`.

    Raises:
        LumitreeError: unknown name, unreadable file, or no luminaire: without geometry, without
            area emitters, or with lights that cannot be baked.
    """
    load_mitsuba(variant)
    from lumitree.luminaire.luminaire import load_luminaire as load

    if materials is None and not keep and not drop:
        return load(luminaire)
    if not isinstance(luminaire, str | os.PathLike):
        raise LumitreeError("materials, keep and drop are for built-in names and files")
    chosen = None if materials is None else os.fspath(materials)
    source = LuminaireSource(os.fspath(luminaire), chosen, tuple(keep), tuple(drop))
    return load(source)


def dataset_folder(source: "LuminaireLike") -> Path | None:
    """The folder of a dataset that a source names; None if it names something else.

    Raises:
        LumitreeError: it names a dataset, with options for reading a luminaire.
    """
    if not isinstance(source, str | os.PathLike | LuminaireSource):
        return None
    folder = Path(source.name if isinstance(source, LuminaireSource) else source)
    if not os.path.isfile(folder / MANIFEST):
        return None
    if isinstance(source, LuminaireSource) and (source.materials or source.keep or source.drop):
        raise LumitreeError(
            f"{folder} is a dataset, which --materials, --keep and --drop cannot change; give the "
            "luminaire itself"
        )
    return folder


def warn_of_faults(luminaire: "Luminaire") -> list[str]:
    """Warn of glass that cannot be rendered correctly; returns what was found."""
    from lumitree.luminaire.diagnosis import diagnose

    faults = diagnose(luminaire.scene)
    for fault in faults[:MAX_FAULTS]:
        warnings.warn(f"{luminaire.name}: {fault}", LumitreeWarning, stacklevel=3)
    if len(faults) > MAX_FAULTS:
        more = f"{luminaire.name}: {len(faults) - MAX_FAULTS} more faults of this kind"
        warnings.warn(more, LumitreeWarning, stacklevel=3)
    return faults
