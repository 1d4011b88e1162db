"""Protocol of an emitter whose radiance is costly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.rendering.plugins.placed import Placed
from lumitree.rendering.sampling.emitter_sampling import Target


@dataclass
class EmitterSample:
    """A direction sampled towards an emitter by next-event estimation (a PyTree of Dr.Jit).

    Attributes:
        ds: the direction and its end; its `pdf` is of no use before `eval_target`. `delta` is as
            Mitsuba has it: rays sampled by BSDFs do not find this light.
        weight: radiance over density; `eval_target` of a `DeferredEmitter` replaces it.
        valid: whether a direction was sampled.
        includes_mis: whether the weight that `eval_target` returns includes the weight of multiple
            importance sampling.
        target: the sampled point in a lamp.
        beyond: how far the shadow ray goes on beyond `ds.p`, through the lamp's own surfaces.
    """

    ds: mi.DirectionSample3f
    weight: mi.Spectrum
    valid: mi.Bool
    includes_mis: mi.Bool
    target: Target
    beyond: mi.Float


class DeferredEmitter(ABC):
    """An emitter on a see-through proxy, whose radiance and density cost a traversal.

    `mi.Emitter` returns a direction together with its radiance, so that the radiance is computed
    for directions that turn out to be occluded; and it returns radiance, transmittance and density
    in three calls that make the same traversal. An integrator that knows this protocol saves both.
    Emitters that do not follow it are used through `mi.Emitter` alone. All quantities are those of
    the methods of `mi.Emitter` and `mi.BSDF` that are named.

    A class follows it if it has the methods. It is no `typing.Protocol`, for which Python looks at
    each emitter of a large scene again.

    Attributes:
        placed: its proxy, and where it stands.
    """

    placed: Placed

    @classmethod
    def __subclasshook__(cls, kind: type) -> bool:
        return all(hasattr(kind, name) for name in ("light", "sample_target", "eval_entered"))

    @abstractmethod
    def light(self) -> Any:
        """The `LampLight` of its methods that cost."""

    @abstractmethod
    def light_inside(self) -> None:
        """Light what is in the box from now on, if it can (`placed.holds`)."""

    @abstractmethod
    def axis_intensities(self) -> NDArray[np.float64]:
        """Luminous intensity [6] towards x, y and z of the scene and against them, smoothed."""

    @abstractmethod
    def sampled_alone_radius(self) -> float:
        """Radius of `divided_sampling.left_out`, scene; 0 where rays of a BSDF always count.

        Rays for which `left_out` is true get neither light from the lamp nor are they attenuated.
        """

    @abstractmethod
    def is_summed(self, point: mi.Point3f, active: mi.Bool) -> mi.Bool:
        """Whether `irradiance` has the stored light that receivers at points of the scene get."""

    @abstractmethod
    def irradiance(
        self, point: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool
    ) -> mi.Color3f:
        """Irradiance by stored light that nothing in the scene shadows, without sampled directions.

        Straight light that is traced is not in it. Points and unit normals are in the scene. Only
        receivers of `is_summed` may be active.
        """

    @abstractmethod
    def sample_target(
        self, it: mi.Interaction3f, sample: mi.Point2f, own: mi.Bool, active: mi.Bool
    ) -> EmitterSample:
        """First half of `sample_direction`: a direction to stored light, or to the lamp's emitters.

        From vertices on the lamp's `own` surfaces, and in its media, it leads to the emitters.
        """

    @abstractmethod
    def eval_target(
        self,
        it: mi.Interaction3f,
        sampled: EmitterSample,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Second half of `sample_direction`: what a sampled direction is worth.

        Args:
            bsdf_pdf: density per steradian with which the BSDF samples the direction.
            emitter_pmf: probability with which this emitter was chosen.

        Returns:
            Radiance over density; and density per steradian, 0 where the sampled point turns out to
            be hidden within the luminaire.
        """

    @abstractmethod
    def eval_entered(
        self,
        ray: mi.Ray3f,
        distance: mi.Float,
        it: mi.Interaction3f,
        specular_chain: mi.Bool,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        end: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
        """`eval`, `eval_null_transmission` and `pdf_direction` in one traversal.

        Args:
            distance: from its origin to the proxy.
            it: the vertex that the ray comes from.
            specular_chain: whether all vertices between the camera and the ray are specular, so
                that the ray belongs to an image of the emitter.
            bsdf_pdf: density per steradian with which the BSDF sampled the ray.
            emitter_pmf: probability with which next-event estimation chooses this emitter; 0 if it
                could not have found the ray.
            end: distance from the ray's origin of the first surface that does not belong to the
                emitter's lamp.

        Returns:
            Radiance; transmittance; and density with which `sample_direction` gives this direction
            from `it`, 0 if the radiance includes the weight of multiple importance sampling.
        """

    @abstractmethod
    def transmittance(self, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool) -> mi.Float:
        """Transmittance for a shadow ray that enters the proxy.

        Its part behind the end of the ray does not count.
        """
