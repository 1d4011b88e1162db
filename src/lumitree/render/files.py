"""Files of the functions of `lumitree`: assets, and the work folder of a bake."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.asset.file import save
from lumitree.core.files import WriteError
from lumitree.core.work_folder import WorkFolder, scratch_folder
from lumitree.errors import LumitreeError, explained, shown
from lumitree.lamp.source import LuminaireSource, source_kind
from lumitree.render.asset_cache import open_asset

FilePath = str | os.PathLike[str]


@explained
def load(path: FilePath) -> Asset:
    """Read an asset from a file, and check it. Nothing in the file is executed.

    Args:
        path: path of a `.lumitree` file; or of a photometric file (`.ies`, `.ldt`) or a ray file
            (`.ray`, `.tm25ray`), of which an asset is made as by `bake`. While an asset is in use,
            further calls for its file return the same one.

    Returns:
        The asset.

    Raises:
        LumitreeError: the file is missing, damaged or not an asset, or breaks an invariant.
    """
    return open_asset(path)


def asset_of(source: object) -> Asset | None:
    """The asset that a source is once it is opened; None for a luminaire or a dataset.

    Raises:
        LumitreeError: the asset cannot be read, or there are options for reading a luminaire.
    """
    if source_kind(source) not in ("asset", "photometric"):
        return None
    if isinstance(source, LuminaireSource):
        refuse_options(source, "an asset or a photometric file")
        source = source.name
    assert isinstance(source, Asset | str | os.PathLike)
    return open_asset(source)


def refuse_options(source: LuminaireSource, kind: str) -> None:
    """Refuse options for reading a luminaire that are given for a source of another kind."""
    if source.options:
        raise LumitreeError(
            f"{', '.join(source.options)}: not for {kind} such as {shown(source.name, 300)}; leave "
            "it out"
        )


def save_asset(asset: Asset, output: FilePath | None) -> Path | None:
    """Write an asset to `output`; returns its path. Does nothing and returns None for None."""
    if output is None:
        return None
    save(asset, output)
    return Path(output)


@contextlib.contextmanager
def open_work_folder(output: FilePath | None, work: FilePath | None) -> Iterator[WorkFolder]:
    """Context with the folder in which a bake keeps its state.

    Args:
        output: the `.lumitree` file of the bake, or None.
        work: the folder that the user chose. If it is None, the folder has the name of `output`
            with the suffix `.work`, or is a temporary one if `output` is None too.

    Raises:
        LumitreeError: the folder cannot be used; and for a `WriteError` that the block raises if
            the folder then holds state, which it says.
    """
    temporary = work is None and output is None
    with contextlib.ExitStack() as stack:
        if temporary:
            work = stack.enter_context(scratch_folder()) / "work"
        elif work is None:
            work = Path(str(output)).with_suffix(".work")
        folder = stack.enter_context(WorkFolder(str(work)))
        try:
            yield folder
        except WriteError as error:
            if temporary or folder.is_empty:
                raise
            raise LumitreeError(
                f"{error}; the same command continues from what {shown(folder.path, 300)} holds"
            ) from error
