"""The state of the paths of `lumitree_path`, and what each iteration of its loop finds.

All classes are PyTrees of Dr.Jit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.deferred_emitter import EmitterSample
from lumitree.rendering.plugins.emitter_selection import Selected
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.proxies import NONE

# Density of directions whose emitters are left to emitter sampling: its square is no denormal.
_LEFT_OUT = 1e-15


@dataclass
class PathState:
    """State of the loop; `si_prev` is the last interaction that was not null, or the camera."""

    # fmt: off
    ray: mi.Ray3f                      # Current ray
    pi: mi.PreliminaryIntersection3f   # What it meets of the surfaces
    medium: mi.MediumPtr               # Medium that it is in
    active: mi.Bool                    # Active SIMD lanes

    L: mi.Spectrum                      # Radiance accumulator
    valid_ray: mi.Bool                 # Whether the camera ray met something
    record: dict[str, Any]             # What is recorded beside the image (`Layers`)

    β: mi.Spectrum                      # Path throughput weight
    η: mi.Float                        # Product of relative indices of refraction
    channel: mi.UInt32                 # Channel for which media that scatter are sampled
    ρ: mi.Spectrum                      # Densities of the path by channel (`medium_paths`)

    depth: mi.UInt32                   # Depth of current vertex
    depth_freed: mi.UInt32             # Part of it that does not count towards `max_depth`
    crossings: mi.UInt32               # Null interactions so far

    si_prev: mi.Interaction3f          # Previous vertex
    bsdf_pdf_prev: mi.Float            # Density of the direction that was sampled there
    bsdf_delta_prev: mi.Bool           # Whether emitter sampling could not have found it
    specular_chain: mi.Bool            # Whether all vertices so far were specular
    self_emission: mi.UInt32           # Lamp on which `si_prev` is, whose shapes' emission counts
    on_lamp: mi.UInt32                 # Lamp on which `si_prev` is, or `NONE`
    bent_by: mi.UInt32                 # Lamps whose glass the ray has crossed since
    skipped: mi.UInt32                 # Lamps without light in the box where the ray starts
    # fmt: on

    @classmethod
    def start(cls, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool) -> PathState:
        """Paths that begin at a camera; `pi` is not found yet."""
        return cls(
            ray=mi.Ray3f(ray),
            pi=dr.zeros(mi.PreliminaryIntersection3f),
            medium=medium,
            active=mi.Bool(active),
            L=mi.Spectrum(0),
            valid_ray=mi.Bool(False),
            record={},
            β=mi.Spectrum(1),
            η=mi.Float(1),
            channel=mi.UInt32(0),
            ρ=mi.Spectrum(1),
            depth=mi.UInt32(0),
            depth_freed=mi.UInt32(0),
            crossings=mi.UInt32(0),
            si_prev=dr.zeros(mi.Interaction3f),
            bsdf_pdf_prev=mi.Float(1),
            bsdf_delta_prev=mi.Bool(True),
            specular_chain=mi.Bool(True),
            self_emission=mi.UInt32(NONE),
            on_lamp=mi.UInt32(NONE),
            bent_by=mi.UInt32(0),
            skipped=mi.UInt32(0),
        )

    @classmethod
    def received(
        cls, receiver: mi.Interaction3f, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool
    ) -> PathState:
        """Paths of the light that surfaces and media send to receivers.

        Light that emitters send there straight is left to emitter sampling.

        Args:
            receiver: where they begin, as on a rough surface.
            ray: from there.
            medium, active: as for `start`.
        """
        path = cls.start(ray, medium, active)
        path.depth = mi.UInt32(1)
        path.si_prev = mi.Interaction3f(receiver)
        path.bsdf_pdf_prev = mi.Float(_LEFT_OUT)
        path.bsdf_delta_prev = mi.Bool(False)
        path.specular_chain = mi.Bool(False)
        return path

    def add_light(
        self,
        scene: PathScene,
        emitter: mi.EmitterPtr,
        light: mi.Spectrum,
        seen: mi.Bool,
        active: mi.Bool,
        shown: mi.Bool | bool = False,
    ) -> None:
        """Add light of an emitter; `seen` and `shown` as for `Layers.add_light`."""
        self.L[active] += light
        scene.layers.add_light(self.record, emitter, light, seen, mi.Bool(shown), active)


@dataclass
class FreeFlight:
    """How far the medium lets a ray go."""

    # fmt: off
    distance: mi.Float   # Where the medium scatters; infinite if it does not
    collides: mi.Bool    # Whether that is before the next surface
    # fmt: on


@dataclass
class Hit:
    """Where a ray ends."""

    # fmt: off
    si: mi.SurfaceInteraction3f   # The next surface, even if the medium scatters before it
    bsdf: mi.BSDFPtr              # Its BSDF
    hit_surface: mi.Bool          # Whether the ray reaches it, or the environment
    hit_medium: mi.Bool           # Whether the medium scatters before it
    owner: mi.UInt32              # Lamp that the surface or the medium belongs to, or `NONE`
    shown: mi.Bool                # Whether the path gets what this lamp's shapes emit
    straight: mi.Bool             # Whether what they emit reaches `si_prev` straight
    # fmt: on


@dataclass
class Vertex:
    """Where a path goes on: an interaction with a surface or a medium."""

    # fmt: off
    si: mi.SurfaceInteraction3f   # The surface, or the point in the medium
    bsdf: mi.BSDFPtr              # Its BSDF
    owner: mi.UInt32              # As of `Hit`
    shown: mi.Bool                # As of `Hit`
    active_surface: mi.Bool       # On a surface, which scatters
    active_medium: mi.Bool        # In a medium, which scatters
    last: mi.Bool                 # Whether only null interactions may follow
    opaque: mi.Bool               # Whether the surface lets no light through
    straight: mi.Bool             # Whether it is glass that bends no ray (`geometry_plugins`)
    behind: mi.Bool               # Whether the ray has met this glass from inside
    # fmt: on


@dataclass
class EmitterChoice:
    """A direction that emitter sampling has chosen."""

    # fmt: off
    emitter: mi.EmitterPtr
    selected: Selected       # Which emitter it is, and with which probability
    sampled: EmitterSample
    active: mi.Bool          # Whether there is one
    # fmt: on


@dataclass
class Scattering:
    """Results of the BSDF or the phase function of a vertex."""

    # fmt: off
    value_em: mi.Spectrum     # BSDF times cosine, or phase function, of the emitter's direction
    pdf_em: mi.Float         # Density with which that direction is sampled
    bs: mi.BSDFSample3f      # Sampled direction; in a medium its `pdf` alone
    weight: mi.Spectrum       # Value over density of it
    phase_wo: mi.Vector3f    # Direction sampled in a medium, in the scene
    # fmt: on
