"""Rendering the views of a dataset, one by one, so that a capture can be resumed."""

import contextlib
import functools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from lumitree.core.arguments import check_count, check_image_settings
from lumitree.core.dataset import MANIFEST, MAX_VIEWS, Dataset, Frame, Manifest, Split, View
from lumitree.core.directions import FIRST_TEST_INDEX, view_pose
from lumitree.core.executor import run_tasks
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.core.work_folder import alone_in
from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.sent import LampWorkers, received_luminaire
from lumitree.trace.cameras import Camera, ViewImages
from lumitree.trace.tracing import PATH_DEPTH


def capture(
    luminaire: Luminaire,
    folder: str | os.PathLike[str],
    *,
    views: int = 100,
    resolution: int = 256,
    spp: int = 128,
    split: Split = "train",
    workers: LampWorkers | None = None,
) -> Dataset:
    """Capture the views of `luminaire` that are still missing in `folder`.

    Views are orthographic, along Halton(2, 3) directions, fitted to the bounding sphere. Train
    views are Halton indices from 1 on, test views from 100001 on. The pixel filter is a box.

    Args:
        workers: what renders the views. Default: this process. It writes them in any case.

    Raises:
        LumitreeError: bad settings, `folder` holds another capture, another process works in it,
            or a worker is lost.
    """
    manifest = _plan(luminaire, views, resolution, spp, split)
    with alone_in(Path(folder)):
        return _capture(luminaire, _open_or_start(Path(folder), manifest), workers)


def _capture(luminaire: Luminaire, dataset: Dataset, workers: LampWorkers | None) -> Dataset:
    """Render the views that a dataset lacks."""
    manifest = dataset.manifest
    missing = dataset.missing()
    done = len(manifest.frames) - len(missing)
    settings = manifest.resolution, manifest.spp
    if workers is None:
        camera = Camera(luminaire, *settings)
        images = contextlib.nullcontext(enumerate(_take(camera, frame) for frame in missing))
    else:
        images = _taken_by(workers, settings, missing)
    with (
        progress(f"capture {luminaire.name}", len(manifest.frames), done) as advance,
        images as taken,
    ):
        for index, found in taken:
            dataset.write(View(missing[index], **vars(found)))
            advance(1)
    return dataset


def _take(camera: Camera, frame: Frame) -> ViewImages:
    return camera.take(frame.pose, SeedStream(Purpose.CAPTURE, frame.halton_index))


def _taken_by(
    workers: LampWorkers, settings: tuple[int, int], frames: Sequence[Frame]
) -> contextlib.AbstractContextManager[Iterator[tuple[int, ViewImages]]]:
    """Context with the index and the images of each frame, as workers finish them."""
    tasks = [(workers.luminaire, settings, frame) for frame in frames]
    return run_tasks(workers.executor, _take_received, tasks, what="views", total=len(tasks))


def _take_received(luminaire: bytes, settings: tuple[int, int], frame: Frame) -> ViewImages:
    """The task of a worker: one view."""
    return _take(_camera(luminaire, settings), frame)


@functools.lru_cache(maxsize=1)
def _camera(luminaire: bytes, settings: tuple[int, int]) -> Camera:
    return Camera(received_luminaire(luminaire), *settings)


def _plan(luminaire: Luminaire, views: int, resolution: int, spp: int, split: Split) -> Manifest:
    check_count("views", views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=spp)
    first = 1 if split == "train" else FIRST_TEST_INDEX
    # Cameras stand clear of the bounding sphere.
    distance = 2 * luminaire.bounding_radius
    frames = tuple(
        Frame(
            file=f"view_{index:06d}.exr",
            halton_index=index,
            local_from_camera=tuple(map(tuple, view_pose(index, distance).tolist())),
        )
        for index in range(first, first + views)
    )
    return Manifest(
        luminaire=luminaire.name,
        fingerprint=luminaire.fingerprint,
        split=split,
        resolution=resolution,
        spp=spp,
        path_depth=PATH_DEPTH,
        half_width=luminaire.bounding_radius,
        local_frame=luminaire.frame,
        frames=frames,
    )


def _open_or_start(folder: Path, manifest: Manifest) -> Dataset:
    if (folder / MANIFEST).exists():
        dataset = Dataset.open(folder)
        if dataset.manifest != manifest:
            raise LumitreeError(
                f"{folder} holds a capture of other settings or of another luminaire "
                f"({dataset.manifest.luminaire}); choose another folder with -o, or remove it"
            )
        return dataset
    dataset = Dataset(folder, manifest)
    dataset.save_manifest()
    return dataset
