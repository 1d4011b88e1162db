"""A scene with placed luminaires that is rendered in passes, in this process or by workers."""

import contextlib
import dataclasses
import functools
import hashlib
import os
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.checkpoint import CHECKPOINTS
from lumitree.core.executor import packed, run_tasks, unpacked
from lumitree.core.files import FilePath, WorkFolder
from lumitree.core.reading import read_bytes
from lumitree.core.results import Json, plain
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.luminaire import absolute_source
from lumitree.lamp.source import LuminaireSource, gldf_variant

if TYPE_CHECKING:
    from lumitree.core.checkpoint import Checkpoint
    from lumitree.rendering.layers import Recorded
    from lumitree.rendering.passes import Budget, Renderer, Rendering
    from lumitree.rendering.photograph import Highlights
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire

# Advice for the case that a worker is lost.
_CONTINUE = "the same call continues, or begins again without `work`"
_MAX_LAMP_BYTES = 2**40


@dataclasses.dataclass(frozen=True)
class Described:
    """A render; the first three as for `render`.

    Attributes:
        metres: in a unit of length of the scene.
        box_filter: whether each pixel is the mean of its own samples, as for `load_scene`.
        by_lamp: whether the light of each lamp is recorded separately; None if nothing is recorded
            beside the image.
    """

    scene: Any
    placements: "Sequence[Placement]"
    width: int | None
    metres: float
    box_filter: bool
    by_lamp: bool | None

    def packed(self) -> bytes:
        """Bytes for `_received`, with absolute paths; refused if it cannot be pickled."""
        scene = absolute_source(self.scene)
        placements = [
            dataclasses.replace(each, source=absolute_source(each.source))
            for each in self.placements
        ]
        sent = dataclasses.replace(self, scene=scene, placements=placements)
        # Workers keep the scene of one call. Later its files may have changed.
        call = uuid.uuid4().hex
        expected = "its path, or a dictionary without objects of Mitsuba"
        return packed((sent, call), "the scene", expected)


class RenderJob:
    """A scene with luminaires placed in it."""

    def __init__(self, described: Described) -> None:
        import mitsuba as mi

        from lumitree.rendering.layers import Layers, Seen, records_layers
        from lumitree.rendering.scene import (
            appearance_for,
            camera_view,
            load_scene,
            open_placements,
            place_luminaires,
            placed_ids,
            scene_title,
        )

        self._described = described
        self._placed = placed = open_placements(described.placements, described.metres)
        loaded, self.integrator = load_scene(
            described.scene, placed, box_filter=described.box_filter, width=described.width
        )
        appearance = appearance_for(self.integrator)
        self._whole = place_luminaires(loaded, placed, appearance=appearance)
        self.camera = camera_view(loaded.sensors()[0])
        film = loaded.sensors()[0].film()
        # Channels before the integrator's: R, G and B, and perhaps alpha.
        self._of_film = 4 if mi.has_flag(film.flags(), mi.FilmFlags.Alpha) else 3
        if not self._whole.emitters():
            warnings.warn(
                f"{scene_title(described.scene)} has no light, and its image is black; place a "
                "lamp or add an emitter",
                LumitreeWarning,
                stacklevel=2,
            )
        self._layers: Seen | None = None
        if described.by_lamp is None:
            if records_layers(self.integrator) and not mi.is_spectral:
                self._layers = Seen()
            return
        if not records_layers(self.integrator):
            raise LumitreeError(
                f"{scene_title(described.scene)} is rendered by volpath, because of heterogeneous "
                "media; denoise, layers and aov need lumitree_path: make the media homogeneous, "
                "or render without them"
            )
        self._layers = Layers(self._whole, placed_ids(placed) if described.by_lamp else ())

    def rendered(
        self,
        budget: "Budget",
        seed: int,
        so_far: "Callable[[Rendering], None] | None",
        renderer: "Renderer | None",
        checkpoint: "Checkpoint | None",
    ) -> "tuple[Rendering, Recorded | None]":
        """The image, and what is recorded beside it; arguments as for `render_passes`."""
        from lumitree.rendering.layers import Layers
        from lumitree.rendering.passes import render_passes

        with self._recording():
            rendering = render_passes(
                self._whole,
                self.integrator,
                budget,
                seed=seed,
                so_far=so_far,
                renderer=renderer,
                checkpoint=checkpoint,
            )
        if not isinstance(self._layers, Layers):
            return rendering, None
        return rendering, self._layers.divide(rendering.channels[..., self._of_film :])

    def highlights(self, rendering: "Rendering") -> "Highlights | None":
        """Light of emitters that are seen in an image; None if it was not recorded."""
        if self._layers is None:
            return None
        return self._layers.highlights(rendering.channels[..., self._of_film :])

    def watts(self) -> list[NDArray[np.float64] | None]:
        """Flux [3] of each lamp in the scene, W; None for explicit ones."""
        return [None if each.asset is None else each.watts for each in self._placed]

    def identity(self, seed: int) -> Json:
        """Inputs of the image, as members of a JSON object.

        Raises:
            LumitreeError: the scene or a luminaire is no file, and so cannot be compared later.
        """
        import mitsuba as mi

        from lumitree.lamp.read_source import fingerprint_of
        from lumitree.lamp.scene_file import SceneFile

        described = self._described
        scene = described.scene
        if not isinstance(scene, str | os.PathLike):
            raise LumitreeError(
                f"work is given with a scene of type {type(scene).__name__}; expected the path of "
                "a scene, which a later call can compare"
            )
        return {
            "scene": fingerprint_of(SceneFile(scene), LuminaireSource(os.fspath(scene))),
            "lamps": list(map(_lamp_identity, self._placed)),
            "width": described.width,
            "metres": described.metres,
            "box_filter": described.box_filter,
            "by_lamp": described.by_lamp,
            "channels": [] if self._layers is None else self._layers.channel_names(),
            "seed": seed,
            "variant": mi.variant(),
        }

    def image(self, seed: int, samples: int) -> NDArray[np.float32]:
        """One pass, as `render_pass`."""
        from lumitree.rendering.passes import render_pass

        with self._recording():
            return render_pass(self._whole, self.integrator, seed, samples)

    def _recording(self) -> contextlib.AbstractContextManager[None]:
        from lumitree.rendering.layers import recording

        if self._layers is None:
            return contextlib.nullcontext()
        return recording(self.integrator, self._layers)


def renderer_of(executor: Executor, described: Described) -> "Renderer":
    """The `Renderer` of an executor."""
    job = described.packed()

    @contextlib.contextmanager
    def render(
        passes: Iterable[tuple[int, int]],
    ) -> Iterator[Iterator[NDArray[np.float32]]]:
        tasks = ((job, *each) for each in passes)
        with run_tasks(
            executor,
            _render_pass,
            tasks,
            what="passes",
            in_order=True,
            remedy=_CONTINUE,
        ) as results:
            yield (image for _, image in results)

    return render


def _render_pass(job: bytes, seed: int, samples: int) -> NDArray[np.float32]:
    """The task of a worker: one pass."""
    return _received(job).image(seed, samples)


@functools.lru_cache(maxsize=1)
def _received(job: bytes) -> RenderJob:
    """The scene that was sent; warnings of it are given where it was sent."""
    described, _ = unpacked(job)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        return RenderJob(described)


def _lamp_identity(placed: "PlacedLuminaire") -> Json:
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


def forget_passes(folder: FilePath) -> None:
    """Remove the passes of an unfinished image, and their folder if it is then empty."""
    if os.path.exists(folder):
        with WorkFolder(folder) as work:
            work.remove(CHECKPOINTS)
