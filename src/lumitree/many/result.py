"""The lamps of a list, and the result of their bakes."""

import dataclasses
from pathlib import Path
from typing import Literal

from lumitree.asset.asset import Asset
from lumitree.core.results import Result
from lumitree.errors import shown_names

State = Literal["baked", "kept", "failed", "interrupted", "waiting"]


@dataclasses.dataclass(frozen=True)
class BakedLamp:
    """One lamp of `bake_many`.

    Attributes:
        name: of the lamp and of its files.
        source: luminaire that it was baked from; empty in a result of `collect`.
        state: "baked"; "kept", if an earlier call has baked it with these settings; "failed";
            "interrupted", which the same call continues; or "waiting", if the call was
            interrupted before it.
        path: file of the asset; None if none was written.
        error: why it failed; None if it did not.
        seconds: wall time of its bake in this call.
        lumens: luminous flux, lm if lengths are in metres; 0 if there is no asset.
        file_bytes: size of the file; 0 if there is none.
        size: three sides of its box, in the unit of its file.
        irradiance_rms: relative RMS error of the irradiance around it; None if this call has not
            compared it.
    """

    name: str
    source: str
    state: State
    path: Path | None = None
    error: str | None = None
    seconds: float = 0.0
    lumens: float = 0.0
    file_bytes: int = 0
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    irradiance_rms: float | None = None

    def with_asset(self, asset: Asset, path: Path) -> "BakedLamp":
        """The lamp with the figures of its asset in `path`."""
        from lumitree.rendering.asset_flux import asset_lumens

        x, y, z = asset.frame.size.tolist()
        return dataclasses.replace(
            self,
            path=path,
            lumens=asset_lumens(asset),
            file_bytes=path.stat().st_size,
            size=(x, y, z),
        )


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeManyResult(Result):
    """Result of `bake_many` and `collect`.

    Attributes:
        folder: folder of the assets.
        index: index page of the folder.
        lamps: the lamps, in the order of the call; by name in a result of `collect`.
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
        """Whether no lamp remains to be baked. A signal may have arrived afterwards."""
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
