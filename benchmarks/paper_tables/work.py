"""Intermediate data that cells share: captures, training runs and assets, under their parameters.

Each is a folder NAME-HASH of the work folder, with `costs.json`: the seconds spent on it so far,
the largest memory of the processes that did, and whether it is complete. An interrupted one goes on
where it stopped.
"""

import contextlib
import dataclasses
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import lumitree
from benchmarks.equal_error.batches import digest
from benchmarks.paper_tables.scales import Direct, Scale, Views
from lumitree.core.files import write_json
from lumitree.core.interruption import Interrupted
from lumitree.core.results import peak_memory_bytes
from lumitree.fit.config import BakeConfig
from lumitree.fit.network.config import TrainConfig
from lumitree.lamp.dataset import Split

COSTS = "costs.json"
# Steps of training that tell its speed, and the least that is worth starting.
_FIRST_STEPS, _LEAST_STEPS = 500, 200


class OutOfTimeError(Exception):
    """The time is spent; what is done is kept, and the next run goes on with it."""


@dataclasses.dataclass(frozen=True)
class Built:
    """Intermediate data that are complete.

    Attributes:
        path: of the file or folder.
        seconds: wall time that it took, in all runs together.
        peak_memory_bytes: largest memory of the processes that made it, when they had.
        details: further JSON values by name.
    """

    path: Path
    seconds: float
    peak_memory_bytes: int
    details: dict[str, Any]


class Work:
    """The work folder.

    Args:
        folder: of all intermediate data.
        scale: sizes.
        deadline: `time.monotonic()` at which training stops; None for never.
        rooms: folder of rooms, ROOM/room_night.xml; None if there is none.
    """

    def __init__(
        self,
        folder: Path,
        scale: Scale,
        deadline: float | None = None,
        rooms: Path | None = None,
    ) -> None:
        self.folder, self.scale, self.rooms = folder, scale, rooms
        self._deadline = deadline

    def views(self, lamp: str, views: Views, split: Split) -> Built:
        """Captured views of a lamp."""
        at = self._at(f"views-{lamp}-{split}", {"lamp": lamp, "views": views, "split": split})
        if (built := _complete(at, "dataset")) is None:
            with _spending(at):
                lumitree.capture(
                    lamp,
                    at / "dataset",
                    views=views.count,
                    resolution=views.resolution,
                    spp=views.samples,
                    split=split,
                )
            built = _finish(at, "dataset", {})
        return built

    def run(self, lamp: str, config: TrainConfig, seed: int = 0) -> Built:
        """A trained network, from the scale's training views.

        Raises:
            OutOfTimeError: the deadline comes first. The steps so far are kept.
        """
        dataset = self.views(lamp, self.scale.train, "train")
        parameters = {"lamp": lamp, "views": self.scale.train, "config": config, "seed": seed}
        at = self._at(f"run-{lamp}", parameters)
        if (built := _complete(at, "run")) is None:
            with _spending(at):
                details = self._train(dataset.path, at / "run", config, seed)
            built = _finish(at, "run", details)
        return built

    def _train(self, dataset: Path, run: Path, config: TrainConfig, seed: int) -> dict[str, Any]:
        from lumitree.fit.network.train import train

        steps = _FIRST_STEPS
        while True:
            start = time.monotonic()
            result = train(dataset, run, config, seed, resume=run.exists(), stop_after=steps)
            if result.stopped_by is not None:
                raise Interrupted("the same command continues", result.stopped_by)
            if result.steps >= config.num_steps:
                return {"train_seconds": result.seconds, "rays_per_second": result.rays_per_second}
            rate = steps / (time.monotonic() - start)
            steps = config.num_steps
            if self._deadline is not None:
                steps = int(0.9 * rate * (self._deadline - time.monotonic()))
            if steps < _LEAST_STEPS:
                raise OutOfTimeError

    def network_asset(self, lamp: str, config: TrainConfig, seed: int = 0) -> Built:
        """The octree of a trained network."""
        run = self.run(lamp, config, seed)
        depth, samples = self.scale.network_depth, self.scale.samples_per_leaf
        parameters = {"lamp": lamp, "views": self.scale.train, "config": config, "seed": seed}
        parameters |= {"depth": depth, "samples": samples}
        at = self._at(f"octree-{lamp}", parameters)
        if (built := _complete(at, "asset.lumitree")) is None:
            with _spending(at):
                path = at / "asset.lumitree"
                lumitree.extract(run.path, path, tree_depth=depth, samples_per_leaf=samples)
            built = _finish(at, "asset.lumitree", {})
        return built

    def direct_asset(self, lamp: str, direct: Direct, l_max: int = 2) -> Built:
        """The asset of an octree fit, with all parts that the lamp can have."""
        parts = _parts(lamp)
        parameters = {"lamp": lamp, "direct": direct, "l_max": l_max, "parts": parts}
        at = self._at(f"direct-{lamp}", parameters)
        if (built := _complete(at, "asset.lumitree")) is None:
            with _spending(at):
                config = BakeConfig.of(direct.quality)
                octree = dataclasses.replace(
                    config.octree,
                    time=None,
                    rays=direct.rays,
                    tree_depth=direct.tree_depth,
                    l_max=l_max,
                )
                baked = lumitree.bake(
                    lamp,
                    at / "asset.lumitree",
                    dataclasses.replace(config, octree=octree, parts=parts, irradiance_paths=0),
                    work=at / "bake.work",
                )
                if baked.stopped_by is not None:
                    raise Interrupted("the same command continues", baked.stopped_by)
            built = _finish(at, "asset.lumitree", {"stages": baked.seconds})
        return built

    def _at(self, name: str, parameters: dict[str, Any]) -> Path:
        parameters = plain(parameters)
        at = self.folder / f"{name}-{digest(parameters)}"
        at.mkdir(parents=True, exist_ok=True)
        write_json(at / "key.json", parameters)
        return at


def _parts(lamp: str) -> list[Any]:
    """All parts; without the geometry for lamps with media that scatter light.

    No geometry could hold these when the cells were measured.
    """
    from lumitree.lamp.luminaire import load_luminaire

    return ["light", "field", *([] if load_luminaire(lamp).scatters else ["geometry"])]


@contextlib.contextmanager
def _spending(at: Path) -> Iterator[None]:
    """Add the block's wall time and its peak of memory to the costs, also if it ends early."""
    costs, start = _costs(at), time.monotonic()
    try:
        yield
    finally:
        costs["seconds"] += time.monotonic() - start
        costs["peak_memory_bytes"] = max(costs["peak_memory_bytes"], peak_memory_bytes())
        write_json(at / COSTS, costs)


def _costs(at: Path) -> dict[str, Any]:
    path = at / COSTS
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    return {"seconds": 0.0, "peak_memory_bytes": 0, "complete": False}


def _complete(at: Path, name: str) -> Built | None:
    costs = _costs(at)
    return _built(at / name, costs) if costs["complete"] else None


def _finish(at: Path, name: str, details: dict[str, Any]) -> Built:
    costs = {**_costs(at), "complete": True, "details": plain(details)}
    write_json(at / COSTS, costs)
    return _built(at / name, costs)


def _built(path: Path, costs: dict[str, Any]) -> Built:
    return Built(path, costs["seconds"], costs["peak_memory_bytes"], costs["details"])


def plain(value: Any) -> Any:
    """A value as JSON returns it: dataclasses become objects, tuples lists, NaN null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
