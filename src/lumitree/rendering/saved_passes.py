"""The passes of an unfinished image, from which the same call continues."""

import dataclasses
import hashlib
import json
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree._version import __version__
from lumitree.core.arguments import MAX_SAMPLES
from lumitree.core.files import FilePath, WorkFolder, WriteError, atomic_path
from lumitree.core.reading import expect, expect_arrays, read_arrays, read_bytes
from lumitree.core.results import plain
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.source import LuminaireSource, gldf_variant

if TYPE_CHECKING:
    from lumitree.rendering.scene import PlacedLuminaire

_STATE = "passes.npz"
# Raised whenever the arrays of a state or their meaning change.
_VERSION = 1
# Time of rendering after which a state is worth a file, and between two, s; and the largest part of
# the time that saving them takes.
_SECONDS_BETWEEN_STATES, _MOST_TIME_OF_STATES = 30.0, 0.02
_MAX_LAMP_BYTES = 2**40


@dataclasses.dataclass(frozen=True)
class PassSums:
    """Sums over the passes of an image.

    Attributes:
        radiance: float32 [H, W, C], of samples per pixel times channels of the image.
        grey, squares: float64 [H, W], of samples per pixel times the mean of R, G and B of a pass,
            and times its square.
        samples, passes: samples per pixel, and number of passes.
        seconds: time of rendering, s.
    """

    radiance: NDArray[np.float32]
    grey: NDArray[np.float64]
    squares: NDArray[np.float64]
    samples: int
    passes: int
    seconds: float

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The same as arrays."""
        return {name: np.asarray(value) for name, value in vars(self).items()}


class SavedPasses:
    """The file in which the passes of one image are kept."""

    def __init__(self, folder: Path, identity: dict[str, Any]) -> None:
        self._path, self._identity = folder / _STATE, identity
        self._record = ""
        self._next, self._warned = 0.0, False

    def load(self, batch: int, limit: int) -> PassSums | None:
        """The sums so far; None if there are none.

        Warns if they are of another image, or damaged.
        """
        self._record = json.dumps({**self._identity, "batch": batch}, sort_keys=True)
        self._next = time.perf_counter() + _SECONDS_BETWEEN_STATES
        if not self._path.exists():
            return None
        try:
            arrays = read_arrays(self._path)
            if str(arrays.pop("record", None)) != self._record:
                raise LumitreeError("they are of another image")
            return _checked(arrays, batch, limit)
        except LumitreeError as error:
            warnings.warn(
                f"the passes in {shown(self._path.parent, 300)} are not continued: {error}; the "
                "image starts again",
                LumitreeWarning,
                stacklevel=2,
            )
            return None

    def offer(self, sums: PassSums) -> None:
        """Save the sums if that has not been done for half a minute."""
        now = time.perf_counter()
        if now < self._next:
            return
        self.save(sums)
        taken = time.perf_counter() - now
        self._next = now + max(_SECONDS_BETWEEN_STATES, taken / _MOST_TIME_OF_STATES)

    def save(self, sums: PassSums) -> None:
        """Save the sums if they took half a minute.

        Warns, once, where that fails: the image itself can go on.
        """
        if sums.seconds < _SECONDS_BETWEEN_STATES:
            return
        try:
            with atomic_path(self._path) as temporary, open(temporary, "wb") as file:
                arrays = {"record": np.array(self._record), **sums.arrays()}
                np.savez(file, **arrays)  # type: ignore[arg-type]
        except WriteError as error:
            if not self._warned:
                self._warned = True
                warnings.warn(
                    f"cannot save the passes of the image in {shown(self._path.parent, 300)}: "
                    f"{error.reason}; it goes on, but cannot be continued if it is killed",
                    LumitreeWarning,
                    stacklevel=2,
                )


def forget_passes(folder: FilePath) -> None:
    """Remove what `SavedPasses` wrote into a folder, and the folder if it is then empty."""
    if os.path.exists(folder):
        with WorkFolder(folder) as work:
            work.remove([_STATE])


def image_identity(
    scene: Any, placed: "Sequence[PlacedLuminaire]", settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Inputs of an image, as members of a JSON object; equal for images that are continued.

    Raises:
        LumitreeError: the scene or a luminaire is no file, and so cannot be compared later.
    """
    from lumitree.lamp.read_source import fingerprint_of
    from lumitree.lamp.scene_file import SceneFile

    if not isinstance(scene, str | os.PathLike):
        raise LumitreeError(
            f"work is given with a scene of type {type(scene).__name__}; expected the path of a "
            "scene, which a later call can compare"
        )
    return {
        "version": _VERSION,
        "lumitree": __version__,
        "scene": fingerprint_of(SceneFile(scene), LuminaireSource(os.fspath(scene))),
        "lamps": [_lamp_identity(each) for each in placed],
        **settings,
    }


def _lamp_identity(placed: "PlacedLuminaire") -> dict[str, Any]:
    placement = placed.placement
    values = {field.name: getattr(placement, field.name) for field in dataclasses.fields(placement)}
    source = values.pop("source")
    fields = plain(values)
    if placed.luminaire is not None:
        return {**fields, "content": placed.luminaire.fingerprint}
    source = source.name if isinstance(source, LuminaireSource) else source
    if not isinstance(source, str | os.PathLike):
        raise LumitreeError(
            f"work is given with {placement.name} as a loaded asset; expected the path of its "
            "file, which a later call can compare"
        )
    path, variant = gldf_variant(source)
    content = read_bytes(path, "an asset", _MAX_LAMP_BYTES)
    return {**fields, "content": hashlib.sha256(content).hexdigest(), "variant": variant}


def _checked(arrays: Mapping[str, NDArray[Any]], batch: int, limit: int) -> PassSums:
    """The sums of arrays; refused if one is missing, or has a wrong type, shape or range."""
    kinds: dict[str, tuple[type[np.generic], int]] = {
        "radiance": (np.float32, 3),
        "grey": (np.float64, 2),
        "squares": (np.float64, 2),
        "samples": (np.int64, 0),
        "passes": (np.int64, 0),
        "seconds": (np.float64, 0),
    }
    expect("state", arrays.keys() == kinds.keys(), "it has other arrays")
    size = arrays["radiance"].shape[:2]
    for name, (kind, axes) in kinds.items():
        found = arrays[name]
        shape = found.shape if axes == 3 and found.ndim == 3 else size[:axes]
        expect_arrays("state", {name: (found, kind, shape)})
    # Single pixels of an image may be NaN.
    expect("state", bool(np.isfinite(arrays["seconds"])), "seconds is not finite")
    samples, passes, seconds = (arrays[each].item() for each in ("samples", "passes", "seconds"))
    expect("state", 0 < passes <= samples <= MAX_SAMPLES and seconds >= 0, "it has no passes")
    # Else the passes to come would have other seeds than in an image that was never stopped.
    whole = samples % batch == 0 or samples == limit
    expect("state", whole, "its last pass has fewer samples than are asked for")
    expect("state", samples <= limit, f"it has {samples} samples per pixel, more than asked for")
    sums = {name: arrays[name] for name in ("radiance", "grey", "squares")}
    return PassSums(**sums, samples=samples, passes=passes, seconds=seconds)
