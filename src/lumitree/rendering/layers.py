"""Components of an image: the light of each lamp, buffers that describe surfaces, and denoising.

`lumitree_path` accumulates these along its paths, and its film stores them as further channels.
Every image has the light of emitters that are seen, and its square, by which photographs clamp it.

Intel Open Image Denoise filters the noise out. Emitters that are seen directly, or by mirrors and
glass, have little noise, and the filter would blur filaments and highlights: they are not filtered.
Light that a lamp shows on its own rough glass and shades is found by few, bright samples, which the
filter takes for outliers: after 2 samples it leaves 0.6 to 0.9 of the light. So this light is
filtered separately, and keeps its local means.
"""

from __future__ import annotations

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.photometry import LUMA
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.rendering.photograph import Highlights

# Buffers of the first surface that is not specular, as Open Image Denoise expects them.
BUFFERS = ("albedo", "normal")
# Kinds of light that are recorded separately in each group, as the attributes of `Recorded`.
KINDS = ("seen", "self_emission", "lit")
_CHANNELS = {"albedo": "RGB", "normal": "XYZ"}
_SEEN = ("seen.R", "seen.G", "seen.B", "seen.square")
# Largest radiance whose square is finite in single precision.
_MAX_RADIANCE = 1e15
# Standard deviation of the window in which filtered self-emission keeps its mean, pixels.
_WINDOW = 8.0
# Dr.Jit variables of the paths, by name: what `Layers` record.
Record = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Recorded:
    """Buffers recorded beside an image of H rows and W columns.

    Attributes:
        seen: [groups, H, W, 3], radiance of emitters that reaches the camera by specular surfaces
            only, W/(m² sr).
        self_emission: [groups, H, W, 3], radiance of emitters of a lamp that reaches the camera by
            surfaces and media of this lamp's geometry only, not all of them specular.
        lit: [groups, H, W, 3], their other radiance: illumination.
        squares: [groups, H, W], mean over samples of the mean of R, G and B of `seen`, times this
            mean of all groups; they add up to `Highlights.square`.
        albedo: [H, W, 3], diffuse reflectance of the first surface that is not specular, times the
            throughput up to it.
        normal: [H, W, 3], its shading normal in the frame of the scene.
    """

    seen: NDArray[np.float32]
    self_emission: NDArray[np.float32]
    lit: NDArray[np.float32]
    squares: NDArray[np.float32]
    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]

    @property
    def radiance(self) -> NDArray[np.float32]:
        """All light of the groups, [groups, H, W, 3]."""
        return self.seen + self.self_emission + self.lit

    @property
    def highlights(self) -> list[Highlights]:
        """Light of emitters that are seen, of each group."""
        return [Highlights(*each) for each in zip(self.seen, self.squares, strict=True)]


class Unrecorded:
    """Nothing is recorded beside the image."""

    def channel_names(self) -> list[str]:
        return []

    def start(self) -> Record:
        return {}

    def add_light(
        self,
        record: Record,
        emitter: mi.EmitterPtr,
        radiance: mi.Spectrum,
        seen: mi.Bool,
        shown: mi.Bool,
        active: mi.Bool,
    ) -> None:
        pass

    def add_surface(
        self, record: Record, si: mi.SurfaceInteraction3f, β: mi.Spectrum, active: mi.Bool
    ) -> None:
        pass

    def channels(self, record: Record) -> list[mi.Float]:
        return []


class Seen(Unrecorded):
    """Light of emitters that reaches the camera by specular surfaces only, and its square."""

    def channel_names(self) -> list[str]:
        return list(_SEEN)

    def start(self) -> Record:
        return {"seen": [mi.Color3f(0)]}

    def add_light(
        self,
        record: Record,
        emitter: mi.EmitterPtr,
        radiance: mi.Spectrum,
        seen: mi.Bool,
        shown: mi.Bool,
        active: mi.Bool,
    ) -> None:
        record["seen"][0] += radiance & (active & seen)

    def channels(self, record: Record) -> list[mi.Float]:
        return [*record["seen"][0], *_squares(record)]

    def highlights(self, channels: NDArray[np.float32]) -> Highlights:
        """The light of emitters that are seen, in the film's further channels [H, W, C]."""
        return Highlights(channels[..., :3], channels[..., 3])


def _squares(record: Record) -> list[mi.Float]:
    """As `Recorded.squares`, of paths."""
    greys = [dr.minimum(dr.mean(colour), _MAX_RADIANCE) for colour in record["seen"]]
    whole = dr.minimum(sum(greys, mi.Float(0)), _MAX_RADIANCE)
    return [grey * whole for grey in greys]


class EmitterGroups:
    """Groups of the emitters of a scene.

    Args:
        scene: mi.Scene.
        shapes: for each group but the first, the prefix of the ids of its shapes. All emitters in
            no other group belong to the first one.

    Attributes:
        count: number of groups.
        of_emitters: [E] group of each emitter, in the order of the scene.
    """

    def __init__(self, scene: mi.Scene, shapes: Sequence[str] = ()) -> None:
        self.count = 1 + len(shapes)
        self.of_emitters = np.zeros(len(scene.emitters()), np.uint32)
        for index, emitter in enumerate(scene.emitters()):
            shape = emitter.get_shape()
            for group, start in enumerate(shapes, 1):
                if shape is not None and shape.id().startswith(start):
                    self.of_emitters[index] = group
        numbers = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
        # By the number of an emitter among all emitters of the process.
        group_of = np.zeros(numbers.max(initial=0) + 1, np.uint32)
        group_of[numbers] = self.of_emitters
        self._group_of = on_device(mi.UInt32, group_of)

    def of(self, emitter: mi.EmitterPtr, active: mi.Bool) -> mi.UInt32:
        """Groups of emitters of the scene."""
        number = dr.reinterpret_array(mi.UInt32, emitter)
        return dr.gather(mi.UInt32, self._group_of, number, active)


class PathSums(Unrecorded):
    """Light of each group that each path brings, in memory of the device: for any number of groups.

    Attributes:
        groups: of emitters.
        sums: [groups x paths] luminance / `LUMENS_PER_WATT`; of each group, all paths in
            succession.
    """

    def __init__(self, groups: EmitterGroups) -> None:
        self.groups, self.sums = groups, mi.Float(0)

    def clear(self, count: int) -> None:
        """Begin with other paths, `count` of them."""
        self.sums = dr.zeros(mi.Float, self.groups.count * count)
        # A parameter: another number does not compile new kernels.
        self._path, self._count = dr.arange(mi.UInt32, count), parameter(mi.UInt32, count)

    def add_light(
        self,
        record: Record,
        emitter: mi.EmitterPtr,
        radiance: mi.Spectrum,
        seen: mi.Bool,
        shown: mi.Bool,
        active: mi.Bool,
    ) -> None:
        brought = dr.dot(radiance, mi.Color3f(LUMA))
        found = active & (brought > 0)
        place = self.groups.of(emitter, found) * self._count + self._path
        # No two paths have a place in common, so the sums do not depend on the order of threads.
        dr.scatter_add(self.sums, brought, place, found, mode=dr.ReduceMode.NoConflicts)


class Layers(Seen):
    """Groups of emitters whose light is recorded separately, by `KINDS`.

    Args:
        scene, shapes: as for `EmitterGroups`.
    """

    def __init__(self, scene: mi.Scene, shapes: Sequence[str] = ()) -> None:
        self._groups = EmitterGroups(scene, shapes)
        self.groups = self._groups.count

    def channel_names(self) -> list[str]:
        """Names of the film's further channels, in the order of `channels`."""
        light = [f"{kind}{g}.{c}" for kind in KINDS for g in range(self.groups) for c in "RGB"]
        buffers = [f"{buffer}.{c}" for buffer in BUFFERS for c in _CHANNELS[buffer]]
        return [*light, *buffers, *(f"seen{g}.square" for g in range(self.groups))]

    def start(self) -> Record:
        """Buffers of paths at their start."""
        return {
            **{kind: [mi.Color3f(0) for _ in range(self.groups)] for kind in KINDS},
            "albedo": mi.Color3f(0),
            "normal": mi.Color3f(0),
            "found": mi.Bool(False),
        }

    def add_light(
        self,
        record: Record,
        emitter: mi.EmitterPtr,
        radiance: mi.Spectrum,
        seen: mi.Bool,
        shown: mi.Bool,
        active: mi.Bool,
    ) -> None:
        """Record light of an emitter.

        Args:
            record: buffers of the paths, which are changed.
            emitter: one for each path.
            radiance: its part of the pixel.
            seen: whether there are only specular surfaces between it and the camera.
            shown: whether there are only specular surfaces and its lamp's geometry between.
        """
        group = self._groups.of(emitter, active)
        for kind, mask in zip(KINDS, (seen, shown & ~seen, ~(seen | shown)), strict=True):
            for index in range(self.groups):
                record[kind][index] += radiance & (active & mask & (group == index))

    def add_surface(
        self, record: Record, si: mi.SurfaceInteraction3f, β: mi.Spectrum, active: mi.Bool
    ) -> None:
        """Record the first surface of each path that is not specular."""
        first = active & ~record["found"]
        record["found"] |= first
        bsdf = si.bsdf()
        record["albedo"] += β * bsdf.eval_diffuse_reflectance(si, first) & first
        record["normal"] += mi.Color3f(si.sh_frame.n) & first

    def channels(self, record: Record) -> list[mi.Float]:
        """Values of the film's further channels."""
        colours = [each for kind in KINDS for each in record[kind]]
        colours += [record[buffer] for buffer in BUFFERS]
        return [*(colour[i] for colour in colours for i in range(3)), *_squares(record)]

    def highlights(self, channels: NDArray[np.float32]) -> Highlights:
        recorded = self.divide(channels)
        return Highlights(recorded.seen.sum(axis=0), recorded.squares.sum(axis=0))

    def divide(self, channels: NDArray[np.float32]) -> Recorded:
        """Buffers in the film's further channels [H, W, C]."""
        height, width = channels.shape[:2]
        images = channels[..., : -self.groups].reshape(height, width, -1, 3)
        squares = np.moveaxis(channels[..., -self.groups :], -1, 0)
        light = images[:, :, : -len(BUFFERS)].transpose(2, 0, 1, 3)
        kinds = dict(zip(KINDS, np.split(light, len(KINDS)), strict=True))
        albedo, normal = images[:, :, -2], images[:, :, -1]
        return Recorded(**kinds, squares=squares, albedo=albedo, normal=normal)


def records_layers(integrator: mi.Integrator) -> bool:
    """Whether an integrator can record layers: whether it is `lumitree_path`."""
    return isinstance(getattr(integrator, "layers", None), Unrecorded)


@contextlib.contextmanager
def recording(integrator: Any, layers: Seen) -> Iterator[None]:
    """Context in which `lumitree_path` records layers; the integrator may be the user's."""
    before, integrator.layers = integrator.layers, layers
    try:
        yield
    finally:
        integrator.layers = before


def check_denoiser() -> None:
    """Refuse to denoise without the package, before any work is done."""
    _open_image_denoise()


def denoised(recorded: Recorded) -> Recorded:
    """The recorded buffers, with illumination and self-emission that have less noise.

    The image has to be rendered with a box filter: the noise of pixels that share samples is taken
    for a texture.

    Raises:
        LumitreeError: the package is not installed.
    """
    lit = np.stack([_filter(image, recorded) for image in recorded.lit])
    shown = [_with_means(_filter(image, recorded), image) for image in recorded.self_emission]
    return dataclasses.replace(recorded, lit=lit, self_emission=np.stack(shown))


def _filter(radiance: NDArray[np.float32], recorded: Recorded) -> NDArray[np.float32]:
    if not radiance.any():
        return radiance
    filtered = _open_image_denoise().denoise(
        np.ascontiguousarray(radiance),
        np.ascontiguousarray(np.clip(recorded.albedo, 0, 1)),
        np.ascontiguousarray(np.clip(recorded.normal, -1, 1)),
        hdr=True,
    )
    return np.maximum(np.array(filtered, np.float32), 0)


def denoised_pixels(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """sRGB bytes [H, W, 3] with less noise; unchanged, with a warning, without the package."""
    try:
        filter_with = _open_image_denoise().denoise
    except LumitreeError:
        warnings.warn(
            "the photograph is not denoised, since the package mitsuba-oidn is not installed; "
            "install it with `pip install 'lumitree[denoise]'`",
            LumitreeWarning,
            stacklevel=2,
        )
        return pixels
    encoded = np.ascontiguousarray(pixels / 255, np.float32)
    filtered = np.array(filter_with(encoded, srgb=True), np.float32)
    return np.round(255 * np.clip(filtered, 0, 1)).astype(np.uint8)


def _with_means(filtered: NDArray[np.float32], noisy: NDArray[np.float32]) -> NDArray[np.float32]:
    """A filtered image [H, W, 3], scaled to the local means of the noisy one."""
    from scipy.ndimage import gaussian_filter

    means = [
        gaussian_filter(each.mean(axis=-1), _WINDOW, mode="constant") for each in (noisy, filtered)
    ]
    scale = np.divide(*means, out=np.zeros_like(means[0]), where=means[1] > 0)
    return filtered * scale[..., None]


def _open_image_denoise() -> Any:
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise LumitreeError(
            f"denoising needs the package mitsuba-oidn ({error}); install it with "
            "`pip install 'lumitree[denoise]'`, or render without --denoise"
        ) from None
    return mitsuba_oidn
