"""The index page of lamps that were baked in parts."""

from pathlib import Path

from lumitree.core.files import FilePath
from lumitree.core.stopwatch import Stopwatch, peak_memory_bytes
from lumitree.errors import LumitreeError, explained, shown
from lumitree.fit.catalogue.folder import check_folder, mark_folder, read_parts
from lumitree.fit.catalogue.index import FolderIndex, check_index
from lumitree.fit.catalogue.page import INDEX
from lumitree.fit.catalogue.record import INDEX_FILES
from lumitree.fit.catalogue.result import CollectResult


@explained
def collect(folder: FilePath) -> CollectResult:
    """Write the index page of a folder of lamps that `bake_many` has baked in parts.

    It bakes nothing and loads no asset. It may be called while parts are still baked.

    Args:
        folder: folder of the assets, as for `bake_many`.

    Returns:
        What became of each lamp (`lamps`), and which parts have not begun (`missing_tasks`).

    Raises:
        LumitreeError: it is no such folder, is of a later version, or holds an `index.html` that
            is not lumitree's.

    Example:
        >>> for number in (1, 2):
        ...     lumitree.bake_many(["bulbs", "star"], "lamps", task=(number, 2))
        >>> lumitree.collect("lamps").problem is None
        True
    """
    root = Path(folder)
    if not (root / INDEX_FILES).is_dir():
        raise LumitreeError(
            f"{shown(root, 300)} is not a folder of baked lamps; give the FOLDER of `lumitree bake "
            "LAMPS -o FOLDER/ --task K/N`"
        )
    check_index(root / INDEX)
    check_folder(root)
    mark_folder(root)
    watch = Stopwatch()
    with watch.stage("collect"):
        lamps = FolderIndex(root).write(())
        _, missing, _ = read_parts(root)
    return CollectResult(
        folder=root,
        index=root / INDEX,
        lamps=lamps,
        missing_tasks=missing,
        seconds=watch.seconds,
        peak_memory_bytes=peak_memory_bytes(),
    )
