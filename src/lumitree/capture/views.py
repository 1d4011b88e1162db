"""Rendering the views of a dataset, one by one, so that a capture can be resumed."""

import os
from pathlib import Path

<<<<<<< HEAD
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

=======
from lumitree.capture.camera import PATH_DEPTH, Camera, check_settings
>>>>>>> preview
from lumitree.core.dataset import MANIFEST, Dataset, Frame, Manifest, Split, View
from lumitree.core.progress import progress
from lumitree.core.sampling import FIRST_TEST_INDEX, view_pose
from lumitree.errors import LumitreeError
from lumitree.luminaires.luminaire import Luminaire
from lumitree.luminaires.straight_through import straight_through


def capture(
    luminaire: Luminaire,
    folder: str | os.PathLike[str],
    *,
    num_views: int = 100,
    resolution: int = 256,
    samples_per_pixel: int = 128,
    split: Split = "train",
) -> Dataset:
    """Capture the views of `luminaire` that are still missing in `folder`.

    Views are orthographic, along Halton(2, 3) directions, fitted to the bounding sphere. Train
    views are Halton indices from 1 on, test views from 100001 on. The pixel filter is a box.

    Raises:
        LumitreeError: bad settings, or `folder` holds another capture.
    """
    manifest = _plan(luminaire, num_views, resolution, samples_per_pixel, split)
    dataset = _open_or_start(Path(folder), manifest)
    missing = dataset.missing()
    camera = Camera(luminaire, resolution, samples_per_pixel)
    done = len(manifest.frames) - len(missing)
    with progress(f"capture {luminaire.name}", len(manifest.frames), done) as advance:
        for frame in missing:
            picture = camera.take(frame.pose, frame.halton_index)
            dataset.write(View(frame, **vars(picture)))
            advance(1)
    return dataset


def _plan(
    luminaire: Luminaire, num_views: int, resolution: int, samples_per_pixel: int, split: Split
) -> Manifest:
    check_settings(views=num_views, resolution=resolution, spp=samples_per_pixel)
    first = 1 if split == "train" else FIRST_TEST_INDEX
    # Cameras stand clear of the bounding sphere.
    distance = 2 * luminaire.bounding_radius
    frames = tuple(
        Frame(
            file=f"view_{index:06d}.exr",
            halton_index=index,
            proxy_from_camera=tuple(map(tuple, view_pose(index, distance).tolist())),
        )
        for index in range(first, first + num_views)
    )
    return Manifest(
        luminaire=luminaire.name,
        fingerprint=luminaire.fingerprint,
        split=split,
        resolution=resolution,
        samples_per_pixel=samples_per_pixel,
        path_depth=PATH_DEPTH,
        half_width=luminaire.bounding_radius,
        half_extents=tuple(luminaire.half_extents.tolist()),
        world_from_proxy=tuple(map(tuple, luminaire.world_from_proxy.tolist())),
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
<<<<<<< HEAD


class _Camera:
    """Takes the views of one manifest; their kernel is compiled once."""

    def __init__(self, luminaire: Luminaire, manifest: Manifest) -> None:
        self._luminaire, self._manifest = luminaire, manifest
        self._integrator = mi.load_dict(
            {
                "type": "volpath" if luminaire.has_media else "path",
                "max_depth": manifest.path_depth,
            }
        )
        self._sampler = mi.load_dict({"type": "independent"})

    def take(self, frame: Frame) -> View:
        resolution, total = self._manifest.resolution, self._manifest.samples_per_pixel
        batch = max(1, min(total, _MAX_PATHS // resolution**2))
        sums = np.zeros((resolution**2, 5))
        done = 0
        while done < total:
            count = min(batch, total - done)
            sums += self._trace(frame, count, done)
            done += count
        image = (sums / total).astype(np.float32).reshape(resolution, resolution, 5)
        if not np.isfinite(image).all():
            raise LumitreeError(
                f"{self._luminaire.name} renders as NaN or infinity; look for materials or "
                "emitters with invalid values"
            )
        return View(
            frame=frame,
            radiance=image[..., :3],
            geometric=image[..., 3],
            # Transmission is estimated; noise may carry it a little past 1.
            straight_through=np.clip(1 - image[..., 4], 0, 1),
        )

    def _trace(self, frame: Frame, samples: int, offset: int) -> NDArray[np.floating]:
        """Sums over `samples` paths a pixel of radiance, hit and straight throughput [H·W, 5]."""
        resolution = self._manifest.resolution
        count = resolution**2 * samples
        # Distinct for all views and batches of a dataset: offset is below 2**20 samples.
        self._sampler.seed((frame.halton_index << 12) ^ (offset >> 3), count)
        pixel = dr.arange(mi.UInt32, count) // samples
        jitter = self._sampler.next_2d()
        ray = self._ray(frame, mi.Point2f(pixel % resolution, pixel // resolution) + jitter)
        hit = self._luminaire.scene.ray_test(ray)
        radiance, _, _ = self._integrator.sample(self._luminaire.scene, self._sampler, ray)
        through = straight_through(
            self._luminaire.scene, self._sampler, ray, self._manifest.path_depth
        )
        values = (*radiance, dr.select(hit, mi.Float(1), 0), through)
        # A block sum evaluates what it sums: without this, every channel would be traced again.
        dr.eval(values)
        sums = [dr.block_sum(value, samples) for value in values]
        dr.eval(sums)
        return np.stack([np.array(value) for value in sums], axis=-1)

    def _ray(self, frame: Frame, position: Any) -> Any:
        """Orthographic ray through an image position in pixels, row 0 at the top."""
        pose = self._luminaire.world_from_proxy @ frame.pose
        half_width = self._manifest.half_width
        scale = 2 * half_width / self._manifest.resolution
        world_from_camera = mi.Transform4f(pose)
        dr.make_opaque(world_from_camera)
        local = mi.Point3f(position.x * scale - half_width, half_width - position.y * scale, 0)
        backward = dr.normalize(world_from_camera @ mi.Vector3f(0, 0, 1))
        return mi.RayDifferential3f(mi.Ray3f(world_from_camera @ local, -backward))
=======
>>>>>>> preview
