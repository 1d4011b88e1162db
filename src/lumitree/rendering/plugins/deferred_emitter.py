"""What an integrator may ask of an emitter whose radiance is costly."""

from typing import Any, Protocol, runtime_checkable

from lumitree.rendering.plugins.placed import Placed


@runtime_checkable
class DeferredEmitter(Protocol):
    """An emitter on a see-through proxy, whose radiance and density cost a traversal.

    `mi.Emitter` returns a direction together with its radiance, so that the radiance is computed
    for directions that turn out to be occluded; and it returns radiance, transmittance and density
    in three calls that make the same traversal. An integrator that knows this protocol saves both.
    Emitters that do not follow it are used through `mi.Emitter` alone. All quantities are those of
    the methods of `mi.Emitter` and `mi.BSDF` that are named.

    Attributes:
        placed: its proxy, and where it stands.
    """

    placed: Placed

    def light_inside(self) -> None:
        """Light what is in the box from now on, if it can (`placed.holds`)."""
        ...

    def sample_target(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """First half of `sample_direction`: a direction towards the proxy.

        Args:
            it: mi.Interaction3f, the reference point.
            sample: mi.Point2f in the unit square.
            active: mi.Bool mask.

        Returns:
            mi.DirectionSample3f, whose `pdf` is 1 where there is a direction and 0 elsewhere, and
            whose `delta` says that `eval_target` returns a weight that includes multiple importance
            sampling; what `eval_target` needs of the sample, a `Target`; and mi.Float, how far the
            way goes on beyond the sample's point, through the lamp's own surfaces.
        """
        ...

    def eval_target(
        self, it: Any, ds: Any, target: Any, pdf: Any, chance: Any, active: Any
    ) -> tuple[Any, Any]:
        """Second half of `sample_direction`: what a sampled direction is worth.

        Args:
            it: as for `sample_target`.
            ds, target: what `sample_target` returned.
            pdf: mi.Float, density per steradian with which the BSDF samples the direction.
            chance: mi.Float, probability with which this emitter was chosen.
            active: mi.Bool mask.

        Returns:
            mi.Color3f, radiance over density; mi.Float, density per steradian, 0 where the sampled
            point turns out to be hidden within the luminaire.
        """
        ...

    def eval_entered(
        self,
        ray: Any,
        distance: Any,
        it: Any,
        sees: Any,
        pdf: Any,
        chance: Any,
        ends: tuple[Any, Any],
        active: Any,
    ) -> tuple[Any, Any, Any]:
        """`eval`, `eval_null_transmission` and `pdf_direction` in one traversal.

        Args:
            ray: mi.Ray3f that enters the proxy.
            distance: mi.Float, from its origin to the proxy.
            it: mi.Interaction3f, the vertex that the ray comes from.
            sees: mi.Bool, whether the ray belongs to an image of the emitter: it comes from the
                camera, directly or by specular reflections and refractions alone.
            pdf: mi.Float, density per steradian with which the BSDF sampled the ray.
            chance: mi.Float, probability with which next-event estimation chooses this emitter; 0
                if it could not have found the ray.
            ends: mi.Float, distances from the ray's origin of the first surface that belongs to
                the emitter's lamp, and of the first other one.
            active: mi.Bool mask.

        Returns:
            mi.Color3f, radiance; mi.Float, transmittance; mi.Float, density with which
            `sample_direction` gives this direction from `it`, 0 if the radiance includes the weight
            of multiple importance sampling.
        """
        ...

    def sample_own(self, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """A shape of the lamp's model that emits, as `OwnLights.sample`."""
        ...

    def transmittance(self, ray: Any, distance: Any, active: Any) -> Any:
        """Transmittance (mi.Float) for a shadow ray that enters the proxy.

        Args:
            ray, distance, active: as for `eval_entered`.
        """
        ...
