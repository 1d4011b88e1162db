"""Camera paths of a luminaire: its integrator, straight-through rays, and views of a dataset."""

from __future__ import annotations

import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_count, check_image_settings
from lumitree.core.device import parameter
from lumitree.core.executor import run_tasks
from lumitree.core.files import exclusive
from lumitree.core.frames import FIRST_TEST_INDEX, rows_of, view_pose
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import MANIFEST, MAX_VIEWS, Dataset, Frame, Manifest, Split, View
from lumitree.lamp.luminaire import LampWorkers, Luminaire, received_luminaire
from lumitree.lamp.media import is_coloured, media
from lumitree.trace import medium_paths
from lumitree.trace.spawning import is_smooth, is_transmitted, scene_extent, spawn

# Longest path: of opal glass, 8 % of the light takes more than 32 bounces.
PATH_DEPTH = 128
# Light that leaves within this angle of the direction it came in counts as having passed.
COSINE_OF_CONE = 0.9659258262890683  # cos 15°
# Equal settings give equal images: there is no option for the seed.
_ROOT_SEED = 0
# Paths in flight at once: bounds memory to about 1 GiB.
_MAX_PATHS = 1 << 23


def path_integrator(luminaire: Luminaire, path_depth: int, **options: object) -> Any:
    """The mi.Integrator that traces this luminaire's paths.

    `path` where there are neither media, alpha masks nor null surfaces. Its next-event estimation
    treats these as opaque: the light of a spot light in their shade would seldom be found.
    And it counts no light of rays that meet nothing else.

    `volpath` samples distances by one channel's extinction, so that in coloured media the weights
    of the others have no bound; `volpathmis` weighs all three. But where media scatter, that has
    rare paths that are not a number, and where they are grey it is only slower.

    Args:
        path_depth: longest path, bounces.
        options: more of the integrator's parameters, such as `rr_depth`.
    """
    return mi.load_dict({"type": _integrator_kind(luminaire), "max_depth": path_depth, **options})


def _integrator_kind(luminaire: Luminaire) -> str:
    if luminaire.has_media:
        only_colours = not luminaire.scatters and any(map(is_coloured, media(luminaire.scene)))
        return "volpathmis" if only_colours else "volpath"
    for bsdf in (shape.bsdf() for shape in luminaire.scene.shapes()):
        # Thin glass has the flag too, but is lit as glass is.
        if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null) and bsdf.class_name() != "ThinDielectric":
            return "volpath"
    return "path"


def check_finite(luminaire: Luminaire, values: NDArray[np.floating]) -> None:
    """Refuse traced radiance that is NaN or infinite."""
    if not np.isfinite(values).all():
        raise LumitreeError(
            f"{luminaire.name} renders as NaN or infinity; look for materials or emitters with "
            "invalid values"
        )


@dr.syntax
def straight_through(scene, sampler, ray, path_depth):
    """Follow `ray` along a chain of transmissions: what passes, and which emitters it sees.

    Null, specular and rough transmission continue the chain, interior media attenuate it, a
    reflection or absorption ends it. Both are estimates of one sample, and exact where no
    transmission is rough.

    Args:
        scene: mi.Scene of the luminaire.
        sampler: mi.Sampler, seeded for as many rays.
        ray: mi.Ray3f that starts outside.
        path_depth: longest chain.

    Returns:
        mi.Float, throughput averaged over R, G and B, 0 where the ray is stopped or bent; and
        mi.Color3f, radiance of the emitters met before the first rough transmission.
    """
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
    extent = scene_extent(scene)
    direction = mi.Vector3f(ray.d)
    ray = mi.Ray3f(ray)
    throughput, emitted = mi.Color3f(1), mi.Color3f(0)
    smooth = mi.Bool(True)
    medium = dr.zeros(mi.MediumPtr)
    crossings = mi.UInt32(0)
    active = mi.Bool(True)
    passed = mi.Bool(False)

    while active:
        si = scene.ray_intersect(ray, active)
        throughput *= medium_paths.transmittance(medium, si.t, active & si.is_valid())

        passed |= active & ~si.is_valid()
        active &= si.is_valid()
        light = si.emitter(scene, active).eval(si, active)
        emitted = dr.select(active & smooth, emitted + throughput * light, emitted)
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        active &= is_transmitted(sample.sampled_type)
        throughput[active] = throughput * weight
        smooth &= is_smooth(sample.sampled_type)
        ray = dr.select(active, spawn(si, si.to_world(sample.wo), extent), ray)
        medium = medium_paths.medium_after(si, ray.d, medium, active)
        crossings += 1
        active &= (crossings < path_depth) & (dr.max(throughput) > 0)

    straight = passed & (dr.dot(ray.d, direction) >= COSINE_OF_CONE)
    return dr.select(straight, dr.mean(throughput), 0), emitted


@dataclasses.dataclass(frozen=True)
class ViewImages:
    """The images of one view.

    Attributes:
        radiance: [H, W, 3] in W/(m² sr).
        geometric: [H, W] opacity in [0, 1]: share of the camera rays that hit a surface.
        straight_through: [H, W] opacity in [0, 1]: 1 minus the transmittance of light that crosses
            the luminaire straight through (`straight_through`).
    """

    radiance: NDArray[np.float32]
    geometric: NDArray[np.float32]
    straight_through: NDArray[np.float32]


class Camera:
    """Square orthographic camera fitted to the bounding sphere; its kernel is compiled once.

    The pixel filter is a box.
    """

    def __init__(
        self,
        luminaire: Luminaire,
        resolution: int,
        spp: int,
        path_depth: int = PATH_DEPTH,
    ) -> None:
        self._luminaire = luminaire
        self._resolution, self._samples = resolution, spp
        self._path_depth = path_depth
        self._integrator = path_integrator(luminaire, path_depth)
        self._sampler = mi.load_dict({"type": "independent"})

    def take(self, pose: NDArray[np.float64], stream: SeedStream) -> ViewImages:
        """Render the images of one view.

        Args:
            pose: `local_from_camera` [4, 4], outside the bounding sphere.
            stream: of seeds; views with different streams are independent.

        Raises:
            LumitreeError: a pixel is NaN or infinite.
        """
        resolution, total = self._resolution, self._samples
        batch = max(1, min(total, _MAX_PATHS // resolution**2))
        sums = np.zeros((resolution**2, 5))
        done = 0
        while done < total:
            count = min(batch, total - done)
            sums += self._trace(pose, count, stream.seed(_ROOT_SEED, part=done))
            done += count
        image = (sums / total).astype(np.float32).reshape(resolution, resolution, 5)
        check_finite(self._luminaire, image)
        return ViewImages(
            radiance=image[..., :3],
            geometric=image[..., 3],
            # The noise of the estimate may exceed the range.
            straight_through=np.clip(1 - image[..., 4], 0, 1),
        )

    def _trace(
        self, pose: NDArray[np.float64], samples: int, sampler_seed: int
    ) -> NDArray[np.floating]:
        """Sums over `samples` paths a pixel of radiance, hit and straight throughput [H·W, 5]."""
        resolution = self._resolution
        count = resolution**2 * samples
        self._sampler.seed(sampler_seed, count)
        # Another number of samples does not compile another kernel.
        pixel = dr.arange(mi.UInt32, count) // parameter(mi.UInt32, samples)
        jitter = self._sampler.next_2d()
        ray = self._ray(pose, mi.Point2f(pixel % resolution, pixel // resolution) + jitter)
        hit = self._luminaire.scene.ray_test(ray)
        radiance, _, _ = self._integrator.sample(self._luminaire.scene, self._sampler, ray)
        through, _ = straight_through(self._luminaire.scene, self._sampler, ray, self._path_depth)
        values = (*radiance, dr.select(hit, mi.Float(1), 0), through)
        # A block sum evaluates what it sums: without this, every channel would be traced again.
        dr.eval(values)
        sums = [dr.block_sum(value, samples) for value in values]
        dr.eval(sums)
        return np.stack([np.array(value) for value in sums], axis=-1)

    def _ray(self, pose: NDArray[np.float64], position: mi.Point2f) -> mi.RayDifferential3f:
        """Orthographic ray through an image position in pixels, row 0 at the top."""
        world_from_camera = mi.Transform4f(self._luminaire.scene_frame.world_from_local @ pose)
        half_width = self._luminaire.bounding_radius
        scale = 2 * half_width / self._resolution
        dr.make_opaque(world_from_camera)
        local = mi.Point3f(position.x * scale - half_width, half_width - position.y * scale, 0)
        backward = dr.normalize(world_from_camera @ mi.Vector3f(0, 0, 1))
        return mi.RayDifferential3f(mi.Ray3f(world_from_camera @ local, -backward))


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
        LumitreeError: bad settings, `folder` has another capture, another process works in it,
            or a worker is lost.
    """
    check_count("views", views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=spp)
    first = 1 if split == "train" else FIRST_TEST_INDEX
    # Cameras stand clear of the bounding sphere.
    distance = 2 * luminaire.bounding_radius
    manifest = Manifest(
        luminaire=luminaire.name,
        fingerprint=luminaire.fingerprint,
        split=split,
        resolution=resolution,
        spp=spp,
        path_depth=PATH_DEPTH,
        half_width=luminaire.bounding_radius,
        local_frame=luminaire.frame,
        frames=tuple(
            Frame(
                file=f"view_{index:06d}.exr",
                halton_index=index,
                local_from_camera=rows_of(view_pose(index, distance)),
            )
            for index in range(first, first + views)
        ),
    )
    with exclusive(Path(folder)):
        dataset = _open_or_start(Path(folder), manifest)
        missing, settings = dataset.missing(), (resolution, spp)
        done = views - len(missing)
        with progress(f"capture {luminaire.name}", views, done) as advance:
            if workers is None:
                camera = Camera(luminaire, *settings)
                for frame in missing:
                    dataset.write(View(frame, **vars(_take(camera, frame))))
                    advance(1)
                return dataset
            tasks = [(workers.luminaire, settings, frame) for frame in missing]
            with run_tasks(
                workers.executor, _take_received, tasks, what="views", total=len(tasks)
            ) as results:
                for index, images in results:
                    dataset.write(View(missing[index], **vars(images)))
                    advance(1)
    return dataset


def _take(camera: Camera, frame: Frame) -> ViewImages:
    return camera.take(frame.pose, SeedStream(Purpose.CAPTURE, frame.halton_index))


def _take_received(luminaire: bytes, settings: tuple[int, int], frame: Frame) -> ViewImages:
    """The task of a worker: one view."""
    return _take(_camera(luminaire, settings), frame)


@functools.lru_cache(maxsize=1)
def _camera(luminaire: bytes, settings: tuple[int, int]) -> Camera:
    return Camera(received_luminaire(luminaire), *settings)


def _open_or_start(folder: Path, manifest: Manifest) -> Dataset:
    if not (folder / MANIFEST).exists():
        dataset = Dataset(folder, manifest)
        dataset.save_manifest()
        return dataset
    dataset = Dataset.open(folder)
    if dataset.manifest != manifest:
        raise LumitreeError(
            f"{folder} has a capture of other settings or of another luminaire "
            f"({dataset.manifest.luminaire}); choose another folder with -o, or remove it"
        )
    return dataset
