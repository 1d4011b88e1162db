"""Loading and diagnosis of luminaires: built-in ones, files, and Mitsuba scenes."""

import dataclasses
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError, LumitreeWarning, explained
from lumitree.lamp.source import LuminaireSource, as_source, refuse_options, source_kind

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire, LuminaireLike

# Largest number of warnings per luminaire.
MAX_FAULTS = 5


def builtin_luminaires() -> dict[str, dict[str, Any]]:
    """Describe the built-in luminaires.

    Returns:
        Dictionary from the name to a dictionary with `description`; the numbers of `triangles`
        and of `emitters`; `emitted_radiance`, the largest radiance of any emitter and channel,
        W/(m² sr); `size`, the sides of the bounding box, m; and `has_media`, whether there are
        participating media.
    """
    from lumitree.lamp.builtin.registry import BUILTIN
    from lumitree.lamp.figures import figures

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
    """Load and check a luminaire, to use it in several calls or to select its parts.

    Args:
        luminaire: name of a built-in luminaire; path of a Mitsuba 3 scene (`.xml`) or of a model
            (`.obj`, `.gltf`, `.glb`); a dictionary as for `mitsuba.load_dict`; or a
            `mitsuba.Scene`.
        materials: path of a TOML file that overrides materials, unit and up axis of a model.
            Default: the file with the model's name and the suffix `.toml`, if there is one.
        keep: patterns, with `*` and `?`, of the shapes to take: ids of shapes or of their BSDFs in
            a Mitsuba scene, names of parts or of materials in a model. In a Mitsuba scene "#3" is
            the shape with this number, as `preview` lists it. Default: all.
        drop: patterns of the shapes to leave out. Default: none.
        variant: Mitsuba variant; see `bake`.

    Returns:
        The luminaire, which all functions accept in place of a name or file.

    Raises:
        LumitreeError: the name is unknown; a file cannot be read; a pattern matches nothing; or
            there is no geometry, no area emitter, or an emitter that is not a surface.
    """
    load_mitsuba(variant)
    from lumitree.lamp.luminaire import load_luminaire as load

    if materials is None and not keep and not drop:
        return load(luminaire)
    if not isinstance(luminaire, str | os.PathLike):
        raise LumitreeError("materials, keep and drop are for built-in names and files")
    chosen = None if materials is None else os.fspath(materials)
    source = LuminaireSource(os.fspath(luminaire), chosen, tuple(keep), tuple(drop))
    return load(source)


def dataset_folder(source: object) -> Path | None:
    """Folder of the dataset that `source` names; None if it does not name a dataset.

    Raises:
        LumitreeError: `source` names a dataset and has options for reading a luminaire.
    """
    if source_kind(source) != "dataset":
        return None
    described = as_source(cast(Any, source))
    refuse_options(described, "a dataset")
    return Path(described.name)


def warn_of_faults(luminaire: "Luminaire") -> list[str]:
    """Warn of glass that cannot be rendered correctly; returns one line per fault."""
    from lumitree.lamp.diagnosis import diagnose

    faults = diagnose(luminaire.scene)
    for fault in faults[:MAX_FAULTS]:
        warnings.warn(f"{luminaire.name}: {fault}", LumitreeWarning, stacklevel=3)
    if len(faults) > MAX_FAULTS:
        more = f"{luminaire.name}: {len(faults) - MAX_FAULTS} more faults of this kind"
        warnings.warn(more, LumitreeWarning, stacklevel=3)
    return faults
