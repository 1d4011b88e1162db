"""A method of rendering, and the images that it has made so far."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.timing import ClockName
from benchmarks.equal_error.batches import MIN_BATCHES, LongRun, digest
from lumitree.core.files import write_json
from lumitree.errors import LumitreeError

# Longest path, segments.
PATH_DEPTH = 64


@dataclasses.dataclass(frozen=True)
class TimedImage:
    """One image and what it cost.

    Attributes:
        radiance: float32 [H, W, 3], W/(m² sr).
        seconds: by the wall and of the processor, of all cores together, without preparation.
    """

    radiance: NDArray[np.float32]
    seconds: dict[ClockName, float]


class Renderer(Protocol):
    """Renders independent images of one lamp in the room."""

    def images(self, samples: int, seeds: Sequence[int]) -> Iterator[TimedImage]:
        """An image of each seed.

        Args:
            samples: per pixel of each image.
            seeds: of the images.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Method:
    """One row of the tables.

    Attributes:
        name: for files and options.
        label: in tables.
        renderer: makes the images; created by what is needed first.
        whole_image: whether the lamp itself and mirror images are shown.
        first_samples: samples per pixel of the first images.
        key: what the images depend on besides the lamp and their width; JSON values.
        lost: one line for each property of the lamp that the renderer has no equal for.
    """

    name: str
    label: str
    renderer: Renderer
    whole_image: bool = True
    first_samples: int = 4
    key: dict[str, Any] = dataclasses.field(default_factory=dict)
    lost: tuple[str, ...] = ()


def opened_run(method: Method, folder: Path, key: dict[str, Any]) -> LongRun:
    """The images of a method that are kept in a folder.

    Args:
        folder: of all methods of one lamp.
        key: what the images of all methods depend on, JSON values.
    """
    whole = {**key, **method.key, "method": method.name}
    own = folder / f"{method.name}-{digest(whole)}"
    own.mkdir(parents=True, exist_ok=True)
    write_json(own / "key.json", whole)
    return LongRun(own / "long.npz", method.name, method.first_samples)


def extend(run: LongRun, method: Method, seconds: float) -> None:
    """Render until the images have cost so much, and there are 8 at least.

    Each image is saved as it comes, so that a run that is ended loses one at most. For 0 seconds
    nothing is rendered.

    Args:
        seconds: CPU seconds of all images together, those kept from before included.

    Raises:
        LumitreeError: an image is black, or the images of a call have cost no time; they are not
            kept.
    """
    while seconds and (len(run.batches) < MIN_BATCHES or run.seconds["cpu"] < seconds):
        count = MIN_BATCHES - len(run.batches)
        if count <= 0:
            cost = run.seconds["cpu"] / len(run.batches)
            count = math.ceil((seconds - run.seconds["cpu"]) / cost)
        seeds = run.next_seeds[:count]
        before = run.seconds["cpu"]
        for image in method.renderer.images(run.samples, seeds):
            if not image.radiance.any():
                raise LumitreeError(f"{method.label} has rendered a black image")
            run.append(image.radiance, image.seconds)
            if run.seconds["cpu"] > before:
                run.save()
        if run.seconds["cpu"] <= before:
            # A small image of one sample, whose time is subtracted, may have taken as long.
            raise LumitreeError(f"{method.label} has rendered images in no measurable time")
