"""Data of a bake: batches of rays with their radiance and transmittance.

Rays are uniform in dA cos(theta) domega, the measure in which flux is the integral of radiance.
The loss of a field is an integral over rays that has the radiance to be learned in first power
only. So the radiance may come in two parts that are summed apart: what a ray sees through smooth
transmission, and light paths, which end outside the luminaire on a ray of their own.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol

from lumitree.core.frames import LocalFrame
from lumitree.core.seeds import SeedStream

# Which rays (origin, direction, local frame) are worth tracing: mi.Bool.
Wanted = Callable[[Any, Any], Any]


@dataclasses.dataclass
class Rays:
    """A batch of rays in the local frame, and the light along them.

    For an f that is 0 on all unwanted rays (light paths are not selected), the integral of
    f(ray) · radiance(ray) over the wanted rays, divided by their measure, is estimated without bias
    by the sum of f · light over the batch; the integral of f(ray) alone by the sum of f · share.

    Attributes:
        origin, direction: mi.Point3f and mi.Vector3f, local frame, direction of travel.
        share: mi.Float, the part of all wanted rays that this one stands for; 0 for a light path.
        light: mi.Color3f, radiance times share; for a light path its flux over the measure.
        transmittance: mi.Float, straight-through throughput; 0 for a light path.
    """

    origin: Any
    direction: Any
    share: Any
    light: Any
    transmittance: Any


@dataclasses.dataclass
class RayPairs:
    """Rays with two independent noisy estimates of all their radiance (mi.Color3f).

    `transmittance` (mi.Float) is the straight-through throughput; the rest is as in `Rays`.
    """

    origin: Any
    direction: Any
    first: Any
    second: Any
    transmittance: Any


@dataclasses.dataclass(frozen=True)
class Subject:
    """Luminaire that the rays show."""

    name: str
    fingerprint: str
    frame: LocalFrame


class RaySource(Protocol):
    """Where a bake gets its rays from.

    Rays depend on the source's own root seed and on the `SeedStream` argument, not on what was
    drawn before: so a bake that was interrupted continues with the same rays.
    """

    @property
    def subject(self) -> Subject:
        """The luminaire that the rays show."""
        ...

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_paths_per_ray: float
    ) -> Rays:
        """The wanted ones of `count` random rays, and light paths.

        Args:
            light_paths_per_ray: light paths traced for each of the `count` rays.
        """
        ...

    def draw_opacity(self, count: int, stream: SeedStream, wanted: Wanted) -> tuple[Any, Any, Any]:
        """Origin, direction and transmittance of the wanted ones of `count` random rays."""
        ...

    def draw_pairs(self, count: int, stream: SeedStream, paths: int) -> RayPairs:
        """`count` random rays, and two independent means of `paths` camera paths for each."""
        ...
