"""Kinds of sources of light: an asset, a photometric file, a dataset or a luminaire."""

import dataclasses
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, cast

from lumitree.asset.asset import Asset
from lumitree.core.file_kinds import TM33, what_it_is
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.dataset import MANIFEST

# Files that are assets once they are opened, see `rendering.asset_cache.open_asset`.
ASSET_SUFFIX = ".lumitree"
RAY_SUFFIXES = (".ray", ".tm25ray")
# Files that are written, too; and files that are only read.
WRITTEN_SUFFIXES = (".ies", ".ldt", *RAY_SUFFIXES)
PHOTOMETRIC_SUFFIXES = (*WRITTEN_SUFFIXES, ".gldf", ".tm33")
_VARIANT = re.compile(r"(.*\.gldf)#(.*)", re.IGNORECASE | re.DOTALL)
Kind = Literal["asset", "photometric", "dataset", "luminaire"]


@dataclasses.dataclass(frozen=True)
class LuminaireSource:
    """A luminaire that has not been loaded yet.

    Attributes:
        name: built-in name, or path of a .xml, .obj, .gltf or .glb file.
        materials: TOML file of overrides for a model. By default it is the file with the model's
            name and the suffix .toml, if there is one.
        keep: patterns with * and ? of what belongs to the luminaire: ids of shapes or of their
            BSDFs, or numbers of shapes such as "#3", in a Mitsuba scene; or names of parts or
            materials in a model; empty for everything.
        drop: patterns of what does not belong to the luminaire.
        title: its name, and the name of its files, in a list of luminaires. Default: the name of
            the file without its ending, or the built-in name.

    Raises:
        LumitreeError: the patterns are no texts, or a single one; or the title is no name of a
            file.
    """

    name: str
    materials: str | None = None
    keep: Sequence[str] = ()
    drop: Sequence[str] = ()
    title: str | None = None

    def __post_init__(self) -> None:
        title = self.title
        if title is not None and not (
            title.isprintable() and title.strip(".") and title == Path(title).name
        ):
            raise LumitreeError(f"title is {shown(repr(title), 60)}; expected the name of a file")
        for name in ("keep", "drop"):
            patterns = getattr(self, name)
            if isinstance(patterns, str) or not all(isinstance(each, str) for each in patterns):
                raise LumitreeError(
                    f"{name} is {shown(repr(patterns), 60)}; expected a list of texts"
                )
            object.__setattr__(self, name, tuple(patterns))

    def __str__(self) -> str:
        return self.name

    @property
    def options(self) -> list[str]:
        """Names of the options for reading a luminaire that are given."""
        return [name for name in ("materials", "keep", "drop") if getattr(self, name)]


def as_source(source: str | os.PathLike[str] | LuminaireSource) -> LuminaireSource:
    """`source` itself, or a `LuminaireSource` with this name and defaults."""
    return source if isinstance(source, LuminaireSource) else LuminaireSource(os.fspath(source))


def source_kind(source: object) -> Kind:
    """The kind of a source of light: by the suffix of a path, and by the beginning of .xml files.

    "asset": an `Asset` or a `.lumitree` file. "photometric": a photometric file or a ray file,
    which is an asset once it is opened. "dataset": the folder of one. "luminaire": all else.
    """
    if isinstance(source, Asset):
        return "asset"
    name = source.name if isinstance(source, LuminaireSource) else source
    if not isinstance(name, str | os.PathLike):
        return "luminaire"
    if not str(name):
        raise LumitreeError("a source is ''; expected a built-in name or the path of a file")
    suffix = Path(name).suffix.lower()
    if suffix == ASSET_SUFFIX:
        return "asset"
    if photometric_suffix(name) is not None:
        return "photometric"
    return "dataset" if os.path.isfile(Path(name) / MANIFEST) else "luminaire"


def photometric_suffix(name: str | os.PathLike[str]) -> str | None:
    """Suffix of a photometric file or ray file in lower case; None for other files.

    A file .xml is one if it begins as a file of IES TM-33 does.
    """
    path = gldf_variant(name)[0]
    suffix = Path(path).suffix.lower()
    if suffix in PHOTOMETRIC_SUFFIXES:
        return suffix
    try:
        return suffix if suffix == ".xml" and what_it_is(path) == TM33 else None
    except OSError:
        # The function that opens it says why it cannot be read.
        return None


def gldf_variant(name: str | os.PathLike[str]) -> tuple[str, str | None]:
    """Path of a file, and the variant that follows the path of a GLDF file after #."""
    name = os.fspath(name)
    match = _VARIANT.fullmatch(name)
    if match is None or os.path.exists(name):
        return name, None
    return match[1], match[2]


def refuse_options(source: LuminaireSource, kind: str) -> None:
    """Refuse options for reading a luminaire that are given for a source of another kind."""
    if source.options:
        raise LumitreeError(
            f"{', '.join(source.options)}: not for {kind} such as {shown(source.name, 300)}; leave "
            "it out"
        )


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
