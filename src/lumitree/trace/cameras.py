"""The camera that renders images of a luminaire."""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import parameter
from lumitree.core.seeds import SeedStream
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.straight_through import straight_through
from lumitree.trace.tracing import PATH_DEPTH, check_finite, path_integrator

# Equal settings give equal images: there is no option for the seed.
_ROOT_SEED = 0
# Paths in flight at once: bounds memory to about 1 GiB.
_MAX_PATHS = 1 << 23


@dataclasses.dataclass(frozen=True)
class ViewImages:
    """The images of one view.

    Attributes:
        radiance: [H, W, 3] in W/(m² sr).
        geometric: [H, W] opacity in [0, 1]: share of the camera rays that hit a surface.
        straight_through: [H, W] opacity in [0, 1]: 1 minus the transmittance of light that crosses
            the luminaire straight through (`trace.straight_through`).
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

    def _ray(self, pose: NDArray[np.float64], position: Any) -> Any:
        """Orthographic ray through an image position in pixels, row 0 at the top."""
        world_from_camera = mi.Transform4f(self._luminaire.scene_frame.world_from_local @ pose)
        half_width = self._luminaire.bounding_radius
        scale = 2 * half_width / self._resolution
        dr.make_opaque(world_from_camera)
        local = mi.Point3f(position.x * scale - half_width, half_width - position.y * scale, 0)
        backward = dr.normalize(world_from_camera @ mi.Vector3f(0, 0, 1))
        return mi.RayDifferential3f(mi.Ray3f(world_from_camera @ local, -backward))
