"""Where a bake writes: its asset, and the folder in which it keeps its state."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.asset.file import save
from lumitree.core.files import FilePath, WorkFolder, WriteError, scratch_folder
from lumitree.errors import LumitreeError, shown


def save_asset(asset: Asset, output: FilePath | None) -> Path | None:
    """Write an asset to `output`; returns its path. Does nothing and returns None for None."""
    if output is None:
        return None
    save(asset, output)
    return Path(output)


def work_folder_of(output: FilePath | None) -> Path:
    """The folder in which the bake of an asset keeps its state, if none was chosen."""
    return Path(str(output)).with_suffix(".work")


@contextlib.contextmanager
def open_work_folder(output: FilePath | None, work: FilePath | None) -> Iterator[WorkFolder]:
    """Context with the folder in which a bake keeps its state: `work` if it is given.

    Else it has the name of `output` with the suffix `.work`, or is a temporary one without output.

    Raises:
        LumitreeError: the folder cannot be used; and for a `WriteError` that the block raises if
            the folder then holds state, which it says.
    """
    temporary = work is None and output is None
    with contextlib.ExitStack() as stack:
        if temporary:
            work = stack.enter_context(scratch_folder()) / "work"
        elif work is None:
            work = work_folder_of(output)
        folder = stack.enter_context(WorkFolder(str(work)))
        try:
            yield folder
        except WriteError as error:
            if temporary or folder.is_empty:
                raise
            raise LumitreeError(
                f"{error}; the same command continues from what {shown(folder.path, 300)} holds"
            ) from error
