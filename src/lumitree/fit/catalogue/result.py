"""The results of bakes of many lamps."""

import dataclasses
from pathlib import Path

from lumitree.core.results import Result
from lumitree.errors import shown_names
from lumitree.fit.catalogue.record import BakedLamp


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeManyResult(Result):
    """Result of `bake_many`.

    Attributes:
        folder: folder of the assets.
        index: index page of the folder.
        lamps: the lamps, in the order of the call.
        stopped_by: number of the signal that interrupted the call; None if there was none.
    """

    folder: Path
    index: Path
    lamps: list[BakedLamp]
    stopped_by: int | None = None

    @property
    def failed(self) -> list[BakedLamp]:
        """The lamps that failed."""
        return [lamp for lamp in self.lamps if lamp.state == "failed"]

    @property
    def finished(self) -> bool:
        """Whether no lamp is left to be baked. A signal may have arrived afterwards."""
        return all(lamp.state in ("baked", "kept", "failed") for lamp in self.lamps)

    @property
    def problem(self) -> str | None:
        """Errors of lamps, in one line; None if none failed."""
        if not self.failed:
            return None
        names = shown_names(lamp.name for lamp in self.failed)
        return (
            f"{len(self.failed)} of {len(self.lamps)} lamps failed ({names}); the same command "
            "keeps the others and tries again"
        )


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class CollectResult(Result):
    """Result of `collect`.

    Attributes:
        folder: folder of the assets.
        index: index page of the folder.
        lamps: all lamps of the folder, and those of the parts that have begun, by name. Those that
            have been baked have the state "kept".
        missing_tasks: numbers of the parts that have not begun.
    """

    folder: Path
    index: Path
    lamps: list[BakedLamp]
    missing_tasks: list[int]

    @property
    def problem(self) -> str | None:
        """Missing lamps, in one line; None if all have been baked."""
        texts = {"failed": "failed", "interrupted": "interrupted", "waiting": "not baked yet"}
        parts = []
        for state, text in texts.items():
            names = [lamp.name for lamp in self.lamps if lamp.state == state]
            parts += [f"{len(names)} {text} ({shown_names(names)})"] if names else []
        if parts:
            parts = [f"of {len(self.lamps)} lamps {', '.join(parts)}"]
        if self.missing_tasks:
            numbers = shown_names(map(str, self.missing_tasks))
            parts.append(f"tasks that have not begun: {len(self.missing_tasks)} ({numbers})")
        return f"{'; '.join(parts)}; the same tasks bake what is missing" if parts else None
