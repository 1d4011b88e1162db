"""Pictures that are rendered once: kept in a folder, under the hash of all they depend on."""

import hashlib
import json
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lumitree
from benchmarks.common.timing import Clock, ClockName
from lumitree.core.files import atomic_path

Floats = NDArray[np.float32]
# render(samples a pixel, seed) -> picture [H, W, 3]
Render = Callable[[int, int], Floats]

MIN_BATCHES, MAX_BATCHES = 8, 32
MIN_RUNGS = 6
# Packages of the code that an image of a baked lamp depends on.
_SOURCES = ("rendering", "octree", "asset", "core")
# Seeds of long runs start here; seeds of ladders stay below. Each run may have so many images.
_LONG_SEEDS, _RUN_SEEDS, _RUNS = 1 << 14, 1 << 15, 1 << 15


def digest(*parts: Any) -> str:
    """Short hash of JSON values and of the bytes of files (paths)."""
    hasher = hashlib.sha256()
    for part in parts:
        whole = part.read_bytes() if isinstance(part, Path) else json.dumps(part).encode()
        hasher.update(hashlib.sha256(whole).digest())
    return hasher.hexdigest()[:16]


class LongRun:
    """Independent batches of equally many samples, which grow as long as time is spent.

    Whenever there are 32, neighbours are averaged: 16 batches of twice as many samples. So the
    file stays small, and the noise of the whole can always be told from the batches' spread.

    Args:
        path: of the file.
        name: of what is rendered. Runs with different names have different seeds, so that what is
            told from two of them is not told from common random numbers.
        first_samples: samples a pixel of a batch at the beginning.
    """

    def __init__(self, path: Path, name: str, first_samples: int = 4) -> None:
        self._path = path
        self._first_seed = _LONG_SEEDS + zlib.crc32(name.encode()) % _RUNS * _RUN_SEEDS
        self.batches: Floats = np.zeros((0, 0, 0, 3), np.float32)
        self.samples, self._next = first_samples, 0
        self.seconds: dict[ClockName, float] = {"wall": 0.0, "cpu": 0.0}
        if path.exists():
            with np.load(path) as saved:
                self.batches = saved["batches"]
                self.samples, self._next = int(saved["samples"]), int(saved["next"])
                self.seconds = {name: float(saved[name]) for name in self.seconds}

    @property
    def spp(self) -> int:
        """Samples per pixel of all batches together."""
        return self.samples * len(self.batches)

    @property
    def mean(self) -> Floats:
        """[H, W, 3] the best picture there is."""
        return self.batches.mean(0)

    @property
    def next_seeds(self) -> range:
        """Seeds of the images that may follow until neighbours are averaged."""
        first = self._first_seed + self._next
        return range(first, first + MAX_BATCHES - len(self.batches))

    def extend(self, render: Render, budget: float) -> None:
        """Render until `budget` seconds by the wall are spent and there are 8 batches."""
        start = saved = time.perf_counter()
        while len(self.batches) < MIN_BATCHES or time.perf_counter() - start < budget:
            self.add(render)
            if time.perf_counter() - saved > 20:
                self.save()
                saved = time.perf_counter()
        self.save()

    def add(self, render: Render) -> None:
        """Render one more batch."""
        clock = Clock()
        image = render(self.samples, self.next_seeds[0])
        self.append(image, clock.read())

    def append(self, image: Floats, seconds: Mapping[ClockName, float]) -> None:
        """Append the image [H, W, 3] of the first of `next_seeds`, and the seconds it took."""
        self.seconds = {name: self.seconds[name] + seconds[name] for name in self.seconds}
        one = image[None]
        self.batches = np.concatenate([self.batches, one]) if len(self.batches) else one
        self._next += 1
        if len(self.batches) == MAX_BATCHES:
            self.batches = (self.batches[::2] + self.batches[1::2]) * np.float32(0.5)
            self.samples *= 2

    def save(self) -> None:
        """Write the file."""
        with atomic_path(self._path) as temporary, open(temporary, "wb") as file:
            counts = {"samples": self.samples, "next": self._next}
            values: dict[str, Any] = {"batches": self.batches, **counts, **self.seconds}
            np.savez(file, **values)


def ladder(folder: Path, render: Render, budget: float, max_rungs: int = 14) -> list[dict]:
    """Pictures with 1, 2, 4, ... samples a pixel until `budget` seconds of wall time are spent.

    There are six rungs at least, up to the 32 samples of the paper's comparison. Rungs are kept as
    they finish; a later call with more time goes on where this one stopped.

    Returns:
        For every rung `samples`, `images` [R, H, W, 3] and `seconds` by clock, [R] of each
        picture; cheap rungs have R = 4 pictures, to tell their scatter.
    """
    rungs, spent, warm = [], 0.0, False
    for index in range(max_rungs):
        samples = 1 << index
        path = folder / f"rung-{samples}.npz"
        if path.exists():
            with np.load(path) as saved:
                rungs.append(_rung(samples, saved["images"], saved["wall"], saved["cpu"]))
            spent += float(rungs[-1]["seconds"]["wall"].sum())
            continue
        last = rungs[-1]["seconds"]["wall"].mean() if rungs else 0.0
        if spent + 2 * last > budget and index >= MIN_RUNGS:
            break
        if not warm:  # compiling is no part of a picture's time
            render(1, 0)
            render(2, 0)
            warm = True
        count = 4 if spent + 8 * last < budget / 4 else 1
        images, seconds = [], []
        for replica in range(count):
            clock = Clock()
            images.append(render(samples, 1 + 4 * index + replica))
            seconds.append(clock.read())
        wall, cpu = ([each[name] for each in seconds] for name in ("wall", "cpu"))
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, images=np.array(images), wall=wall, cpu=cpu)
        rungs.append(_rung(samples, np.array(images), np.array(wall), np.array(cpu)))
        spent += sum(wall)
    return rungs


def _rung(samples: int, images: Floats, wall: Any, cpu: Any) -> dict:
    return {"samples": samples, "images": images, "seconds": {"wall": wall, "cpu": cpu}}


def code_digest() -> str:
    """Hash of the package's code that renders a baked lamp."""
    package = Path(lumitree.__file__).parent
    return digest(*sorted(file for part in _SOURCES for file in (package / part).rglob("*.py")))
