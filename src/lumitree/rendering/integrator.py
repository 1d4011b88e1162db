"""The integrator `lumitree_path`: Mitsuba's `path`, which also walks through null surfaces.

A null interaction (a baked luminaire's proxy, a hole of an alpha mask) bends no ray. So it counts
neither towards `max_depth` nor for Russian roulette, it keeps the state of multiple importance
sampling (the vertex before it and the density of the direction sampled there), and shadow rays
cross it with the transmittance that its BSDF states.

Homogeneous media attenuate and scatter light along each segment (`medium_paths`). A scattering is a
vertex like one on a rough surface. Heterogeneous media need `volpath`, and are refused.

Opaque BSDFs do not scatter light through the geometric surface (`spawning`), as `path`
lets them do where shading normals are smooth.

Proxies are not traced. The integrator traces a scene of the other shapes, and finds the proxies
that a ray enters by itself (`proxies.DividedScene`).

Where images show the geometry of a lamp, its shapes are in the scene, and each path gets its light
once. As long as all vertices since the camera are specular or on surfaces of this lamp, the path
gets the emission of the lamp's shapes (`self_emission`). A scattering in a medium of the lamp's
geometry counts as a vertex on the lamp. Vertices elsewhere, inside its box too, get the straight
light of the shapes, and the light field, which contains all light that the lamp's surfaces bend or
scatter: so these surfaces get none of it again. After the first vertex that is not specular, the
lamp's glass bends no ray (`geometry`), and a crossing of it is a null interaction.

`trace_paths` is the loop. Its blocks stand below it, in this order: segments of a path (media, and
proxies that a ray enters), light (emitters that a ray hits, emitter sampling, shadow rays), and
vertices. They read a `PathScene` and change a `PathState`. docs/emitter-samples.md follows a sample
through them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from lumitree.errors import LumitreeError
from lumitree.lamp.media import absorption, media
from lumitree.rendering.emitter import EmitterSample, lamp_of
from lumitree.rendering.geometry import CROSSED_STRAIGHT, GeometryEmitter
from lumitree.rendering.lamps import EmitterSelection, LampChoices, LampKinds, Selected
from lumitree.rendering.layers import Layers, Record, Unrecorded
from lumitree.rendering.null_bsdf import without_proxies
from lumitree.rendering.proxies import MAX_CROSSINGS, NONE, Divided, DividedScene, is_instance
from lumitree.rendering.sampling import mis_weight
from lumitree.trace import medium_paths
from lumitree.trace.spawning import is_opaque, offset, on_opposite_sides, scene_extent, spawn

# Density of directions whose emitters only emitter sampling finds: its square is no denormal.
_SAMPLED_ONLY = 1e-15
# Part of its length by which a shadow ray ends before its goal, at least.
_MARGIN = 2.0**-17


@dataclass
class PathState:
    """State of the loop; `si_prev` is the last interaction that was not null, or the camera."""

    # fmt: off
    ray: mi.Ray3f                      # Current ray
    pi: mi.PreliminaryIntersection3f   # Its intersection with the surfaces
    medium: mi.MediumPtr               # Medium that it is in
    active: mi.Bool                    # Active SIMD lanes

    L: mi.Spectrum                      # Radiance accumulator
    valid_ray: mi.Bool                 # Whether the camera ray met something
    record: Record             # Layers beside the image (`Layers`)

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
    bent_by: list[mi.UInt32]           # Lamps whose glass the ray has crossed since (`Owners.add`)
    skipped: list[mi.UInt32]           # Lamps without light in the box where the ray starts
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
            bent_by=[],
            skipped=[],
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
        path.bsdf_pdf_prev = mi.Float(_SAMPLED_ONLY)
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
    shown: mi.Bool                # Whether the path gets the emission of this lamp's shapes
    straight: mi.Bool             # Whether their emission reaches `si_prev` straight
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
    straight_glass: mi.Bool       # Whether it is glass that bends no ray (`geometry`)
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


class PathScene:
    """A scene as `lumitree_path` renders it. No PyTree: loops do not have it in their state.

    Args:
        scene: as it was loaded.
        divided: the same, as `DividedScene` divides it.
        media: those that rays may cross.
        hide_emitters: whether the camera does not see emitters.
        layers: recorded beside the image.
        choices: keeps tables for the choice of a lamp.
        sums: whether of a path its light alone has derivatives, so that these are sums over its
            vertices, and not its throughput.
    """

    def __init__(
        self,
        scene: mi.Scene,
        divided: Divided,
        media: Sequence[mi.Medium] = (),
        *,
        hide_emitters: bool = False,
        layers: Unrecorded | None = None,
        choices: LampChoices | None = None,
        sums: bool = False,
    ) -> None:
        self.whole = scene
        self.divided = divided
        self.hide_emitters = hide_emitters
        self.layers = Unrecorded() if layers is None else layers
        self.extent = scene_extent(scene)
        self.bsdf_ctx = mi.BSDFContext()
        # These select the code of a kernel: no scene pays for features that it does not have.
        self.has_null_surfaces = any(
            is_instance(shape) or mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null)
            for shape in divided.surfaces.shapes()
        )
        self.has_media = bool(media)
        self.has_scattering = any(absorption(medium) is None for medium in media)
        self.shows_geometry = any(
            isinstance(emitter, GeometryEmitter) for emitter in scene.emitters()
        )
        self.selection = EmitterSelection(scene, LampChoices() if choices is None else choices)
        self.lamps = LampKinds(scene.emitters(), scene.emitters_dr())
        self.max_iterations = -1 if sums else None

    def emitter(self, index: mi.UInt32, active: mi.Bool) -> mi.EmitterPtr:
        """The emitter of an index in the scene."""
        return dr.gather(mi.EmitterPtr, self.whole.emitters_dr(), index, active)


def lamps_alone(params) -> bool:
    """Whether no parameters but lamps' have derivatives: these enter the light of paths alone."""
    attached = (value for key, value in params.properties.items() if dr.grad_enabled(params[key]))
    return all(lamp_of(node) is not None for _, _, node, _ in attached)


DEFAULT_RR_DEPTH = 5


def integrator_class() -> type:
    """Class of `lumitree_path` for the variant of Mitsuba that is set.

    It has the properties of `path`: `max_depth` (-1: no limit), `rr_depth` and `hide_emitters`,
    which hides baked luminaires from the camera as other area lights.
    """

    class LumitreePath(mi.SamplingIntegrator):
        # Other integrators cannot divide the light of a lamp whose geometry is in the scene.
        shows_geometry = True

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.max_depth = int(props.get("max_depth", -1))
            self.rr_depth = int(props.get("rr_depth", DEFAULT_RR_DEPTH))
            self.layers: Layers | Unrecorded = Unrecorded()
            self._divided = DividedScene()
            self._choices = LampChoices()
            self._sums = False
            if self.max_depth < -1 or self.rr_depth < 1:
                raise LumitreeError(
                    f"lumitree_path has max_depth {self.max_depth} and rr_depth {self.rr_depth}; "
                    "expected max_depth of -1 (no limit) or more and rr_depth of 1 or more"
                )

        def sample(
            self,
            scene: mi.Scene,
            sampler: mi.Sampler,
            ray: mi.RayDifferential3f,
            medium: mi.Medium | None = None,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Spectrum, mi.Bool, Sequence[mi.Float]]:
            if not scene.emitters():
                nothing = [mi.Float(0) for _ in self.aov_names()]
                return mi.Spectrum(0), scene.ray_test(ray, active), nothing
            crossed = [*media(scene), *([] if medium is None else [medium])]
            if not all(each.is_homogeneous() for each in crossed):
                raise LumitreeError(
                    "a medium is heterogeneous; lumitree_path expects homogeneous media: use "
                    "volpath"
                )
            paths = PathScene(
                scene,
                self._divided.of(scene),
                crossed,
                hide_emitters=self.hide_emitters,
                layers=self.layers,
                choices=self._choices,
                sums=self._sums,
            )
            inside = dr.zeros(mi.MediumPtr) if medium is None else mi.MediumPtr(medium)
            path = PathState.start(ray, inside, mi.Bool(active))
            return trace_paths(paths, path, sampler, self.max_depth, self.rr_depth)

        def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
            if not lamps_alone(params):
                super().render_backward(scene, params, grad_in, sensor, seed, spp)
                return
            # In one kernel, and not in one for each vertex of the longest path.
            self._sums = True
            try:
                image = self.render(scene, sensor, seed, spp, develop=True, evaluate=False)
                dr.backward(image * grad_in)
            finally:
                self._sums = False

        def aov_names(self):
            return self.layers.channel_names()

        def to_string(self) -> str:
            return f"LumitreePath[max_depth={self.max_depth}, rr_depth={self.rr_depth}]"

    return LumitreePath


@without_proxies()
@dr.syntax
def trace_paths(
    scene: PathScene, path: PathState, sampler: mi.Sampler, max_depth: int, rr_depth: int
) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
    """Radiance along rays, whether they met something (for the film's alpha), and layers.

    Args:
        scene: the scene.
        path: as `PathState.start` or `PathState.received` return it.
        sampler: of as many samples as there are paths.
        max_depth, rr_depth: as of Mitsuba's `path`.
    """
    surfaces = scene.divided.surfaces
    largest_depth = mi.UInt32(max_depth % (1 << 32))  # no limit: the largest number
    path.record = scene.layers.start()
    path.bent_by, path.skipped = (scene.divided.owners.no_lamps() for _ in range(2))
    path.valid_ray |= scene.whole.environment() is not None and not scene.hide_emitters
    if dr.hint(scene.has_scattering, mode="scalar"):
        path.channel = medium_paths.draw_channel(sampler)
    path.active &= path.depth < largest_depth
    path.pi = surfaces.ray_intersect_preliminary(path.ray, coherent=True, active=path.active)

    while dr.hint(path.active, max_iterations=scene.max_iterations):
        # ---------------------- Media along the ray ----------------------

        free_flight = sample_free_flight(scene, path, sampler)

        # ---------------------- Hide area emitters ----------------------

        if dr.hint(scene.hide_emitters, mode="scalar"):
            skip_emitters(scene, path, free_flight, sampler)

        # ---------------------- Proxies along the ray ----------------------

        if dr.hint(scene.divided.proxies.exist, mode="scalar"):
            add_entered_light(scene, path, free_flight)

        # ---------------------- Direct emission ----------------------

        hit = end_segment(scene, path, free_flight)
        add_emission(scene, path, hit)

        # ---------------------- Emitter sampling ----------------------

        vertex = find_vertex(scene, path, hit, free_flight, largest_depth)
        choice = sample_emitter(scene, path, vertex, sampler)
        # One call evaluates the BSDF for the emitter's direction and samples the next.
        scattering = sample_scattering(scene, path, vertex, choice.sampled.ds.d, sampler)
        add_emitter_light(scene, path, vertex, choice, scattering)

        # ---- Update loop variables based on current interaction -----

        bounces = scatter(scene, path, vertex, scattering)

        # ---------------------- Russian roulette ----------------------

        roulette(path, bounces, rr_depth, sampler)

        # ----------------- Find the next interaction -----------------

        path.pi = surfaces.ray_intersect_preliminary(path.ray, coherent=False, active=path.active)

    return path.L, path.valid_ray, scene.layers.channels(path.record)


# ---------------------- Segments of a path ----------------------


def sample_free_flight(scene: PathScene, path: PathState, sampler: mi.Sampler) -> FreeFlight:
    """Where the medium scatters, if it does before the ray meets anything."""
    if not scene.has_scattering:
        return FreeFlight(mi.Float(dr.inf), mi.Bool(False))
    distance = medium_paths.free_flight(
        path.medium, path.channel, sampler, path.active, path.ray.wavelengths
    )
    return FreeFlight(distance, path.active & (distance < path.pi.t))


@dr.syntax
def skip_emitters(
    scene: PathScene, path: PathState, free_flight: FreeFlight, sampler: mi.Sampler
) -> None:
    """Let camera rays go on behind emitters, which the camera does not see."""
    # Not Mitsuba's `skip_area_emitters`, whose distance belongs to another ray.
    surfaces = scene.divided.surfaces
    skip = path.active & ~free_flight.collides & (path.depth == 0) & _emits(path.pi)
    while skip:
        if dr.hint(scene.has_media, mode="scalar"):
            _attenuate(path, path.pi.t, skip)
        si = path.pi.compute_surface_interaction(path.ray, mi.RayFlags.Minimal, skip)
        path.ray[skip] = spawn(si, path.ray.d, scene.extent)
        path.pi[skip] = surfaces.ray_intersect_preliminary(path.ray, coherent=True, active=skip)
        path.crossings[skip] += 1
        path.active &= path.crossings < MAX_CROSSINGS
        if dr.hint(scene.has_scattering, mode="scalar"):
            free_flight.distance[skip] = medium_paths.free_flight(
                path.medium, path.channel, sampler, skip, path.ray.wavelengths
            )
            free_flight.collides |= skip & (free_flight.distance < path.pi.t)
        skip &= path.active & ~free_flight.collides & _emits(path.pi)


def _emits(pi: mi.PreliminaryIntersection3f) -> mi.Bool:
    """Whether a preliminary intersection is with an emitter."""
    return pi.is_valid() & (pi.shape.emitter() != None)  # noqa: E711 (a vector comparison)


@dr.syntax
def add_entered_light(scene: PathScene, path: PathState, free_flight: FreeFlight) -> None:
    """Add light of the lamps whose proxies a ray enters before it ends, and attenuate it there."""
    divided, proxies = scene.divided, scene.divided.proxies
    active = mi.Bool(path.active)
    if dr.hint(scene.hide_emitters, mode="scalar"):
        active &= path.depth > 0
    end = dr.minimum(path.pi.t, free_flight.distance)
    # Rays without a density, and rays of images, find all light: emitter sampling does not.
    by_rays = path.bsdf_delta_prev | path.specular_chain
    sampled = path.si_prev.p, dr.select(by_rays, dr.inf, path.bsdf_pdf_prev)
    distance, lamp = proxies.first(
        path.ray, end, active, path.specular_chain, path.skipped, sampled
    )
    active &= lamp != NONE
    # A lamp's light comes whole, whether or not the medium scatters the ray in its box.
    ahead = divided.owners.of(path.pi.shape, active & path.pi.is_valid())
    while dr.hint(active, max_iterations=scene.max_iterations):
        far = divided.end(path.ray, path.pi.t, lamp, ahead, active)
        emitter = scene.emitter(lamp, active)
        emitter_pmf = scene.selection.pmf(emitter, path.si_prev, active)
        emitter_pmf = dr.select(path.bsdf_delta_prev, 0, emitter_pmf)
        light, through = scene.lamps.call(
            "eval_entered",
            emitter,
            path.ray,
            distance,
            path.si_prev,
            path.specular_chain,
            path.bsdf_pdf_prev,
            emitter_pmf,
            far,
            active,
        )
        light *= path.β
        if dr.hint(scene.has_media, mode="scalar"):
            light *= medium_paths.segment_weight(
                path.medium, distance, path.ρ, active, path.ray.wavelengths
            )[0]
        path.add_light(scene, emitter, light, path.specular_chain, active)
        path.β[active] *= through
        path.valid_ray |= active & (dr.max(light) > 0)
        distance, lamp = proxies.next(
            path.ray, distance, lamp, end, active, path.specular_chain, path.skipped, sampled
        )
        active &= lamp != NONE


def end_segment(scene: PathScene, path: PathState, free_flight: FreeFlight) -> Hit:
    """The end of the ray; the medium before it attenuates the path."""
    si = path.pi.compute_surface_interaction(path.ray, mi.RayFlags.All, path.active)
    hit_surface, hit_medium = path.active & ~free_flight.collides, free_flight.collides
    if scene.has_media:
        _attenuate(path, si.t, hit_surface)
    if scene.has_scattering:
        weight, densities = medium_paths.scattering_weight(
            path.medium, free_flight.distance, path.ρ, hit_medium, path.ray.wavelengths
        )
        path.β[hit_medium] *= weight
        path.ρ[hit_medium] = densities
    # The lamp that the surface belongs to, and whether the path gets the emission of its shapes.
    owner, shown, straight = mi.UInt32(NONE), mi.Bool(path.specular_chain), mi.Bool(False)
    if scene.shows_geometry:
        owners = scene.divided.owners
        owner = owners.of(si.shape, hit_surface & si.is_valid())
        if owners.scatter:
            owner = dr.select(hit_medium, owners.of_medium(path.medium, hit_medium), owner)
        shown |= (owner == path.self_emission) & (owner != NONE)
        # The light field has the straight light of lamps with derivatives by their pose.
        straight = (owner != path.on_lamp) & (not scene.lamps.tracked)
        for lamp in path.bent_by:
            straight &= owner != lamp
    return Hit(si, si.bsdf(path.ray), hit_surface, hit_medium, owner, shown, straight)


def _attenuate(path: PathState, distance: mi.Float, active: mi.Bool) -> None:
    """Multiply a path by the weight of a segment of its medium."""
    weight, densities = medium_paths.segment_weight(
        path.medium, distance, path.ρ, active, path.ray.wavelengths
    )
    path.β[active] *= weight
    path.ρ[active] = densities


# ---------------------- Light of emitters ----------------------


def add_emission(scene: PathScene, path: PathState, hit: Hit) -> None:
    """Add light of the emitter that the ray has hit."""
    seen = mi.Bool(hit.hit_surface)
    if scene.hide_emitters:
        seen &= path.depth > 0
    ds = mi.DirectionSample3f(scene.whole, hit.si, path.si_prev)
    # Emitter sampling chooses a lamp, and then a point of its shapes.
    sampled = ds.emitter
    if scene.shows_geometry:
        of_lamp = seen & (hit.owner != NONE)
        sampled = dr.select(of_lamp, scene.emitter(hit.owner, of_lamp), sampled)
    emitter_pmf = scene.selection.pmf(sampled, path.si_prev, seen)
    emitter_pmf = dr.select(path.bsdf_delta_prev, 0, emitter_pmf)
    light, emitter_pdf = scene.lamps.call(
        "eval_hit", ds.emitter, hit.si, path.si_prev, ds, hit.shown, hit.straight, hit.hit_surface
    )
    # A density may be infinite, as of a point in the plane of the surface at `si_prev`.
    emitter_pdf = dr.select(emitter_pmf > 0, emitter_pdf * emitter_pmf, 0)
    weight = mis_weight(path.bsdf_pdf_prev, emitter_pdf)
    contribution = path.β * weight * light
    path.add_light(scene, ds.emitter, contribution, path.specular_chain, seen, hit.shown)


def sample_emitter(
    scene: PathScene, path: PathState, vertex: Vertex, sampler: mi.Sampler
) -> EmitterChoice:
    """Sample an emitter, and a direction towards it. Nothing costly is evaluated yet."""
    active = vertex.active_surface & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Smooth)
    scene.layers.add_surface(path.record, vertex.si, path.β, active)
    active = (active | vertex.active_medium) & ~vertex.last
    # An opaque surface transmits no light, on either side of its horizon.
    n = mi.Vector3f(vertex.si.n)
    normal = dr.select(vertex.opaque, n * -dr.sign(dr.dot(n, path.ray.d)), 0)
    # A lamp lights its surfaces where the path shows them; else its light field has this light.
    without = dr.select(vertex.shown, NONE, vertex.owner)
    selected = scene.selection.sample(vertex.si, normal, without, sampler, active)
    active &= (selected.weight > 0) & (selected.index != without)
    emitter = scene.emitter(selected.index, active)
    self_light = active & (selected.index == vertex.owner)
    sampled = scene.lamps.call(
        "sample_target", emitter, vertex.si, normal, selected.sample, self_light, active
    )
    active &= sampled.valid
    return EmitterChoice(emitter, selected, sampled, active)


def add_emitter_light(
    scene: PathScene,
    path: PathState,
    vertex: Vertex,
    choice: EmitterChoice,
    scattering: Scattering,
) -> None:
    """Add light of a sampled emitter.

    Visibility is evaluated before the light of a baked luminaire, which costs more.
    """
    si, ds, active = vertex.si, dr.detach(choice.sampled.ds), choice.active
    active &= ~(vertex.opaque & on_opposite_sides(si, path.ray.d, ds.d))
    light = path.β * scattering.value_em
    active &= dr.max(light) > 0
    # A lamp's surfaces get nothing of its light field, which has the light that passes its glass:
    # this glass attenuates here instead of blocking.
    self_light = choice.selected.index == vertex.owner
    lamp = dr.select(self_light, NONE, choice.selected.index)
    light *= visible(scene, si, ds, choice.sampled.beyond, lamp, path.medium, active)
    active &= dr.max(light) > 0
    emitter_pmf = choice.selected.emitter_pmf
    weight = scene.lamps.call(
        "eval_target", choice.emitter, si, choice.sampled, scattering.pdf_em, emitter_pmf, active
    )
    light *= weight * choice.selected.weight
    path.add_light(scene, choice.emitter, light, mi.Bool(False), active, self_light)


# ---------------------- Shadow rays ----------------------


@dr.syntax
def visible(
    scene: PathScene,
    si: mi.SurfaceInteraction3f,
    ds: mi.DirectionSample3f,
    beyond: mi.Float,
    goal_lamp: mi.UInt32,
    medium: mi.MediumPtr,
    active: mi.Bool,
) -> mi.Spectrum:
    """Transmittance from a surface to a sampled point: 0 behind surfaces that are not null.

    For a length `beyond` after the point, surfaces block that do not belong to the sampled lamp,
    whose index in the scene is `goal_lamp`, or `NONE`.
    """
    surfaces, proxies, outside_lamps, passes, _ = scene.divided
    # A shadow ray ends before its goal, by no less than it starts after its origin: rounding
    # does not bring it there. But far nearer to it than Mitsuba's, since filaments are thin.
    margin = dr.maximum(ds.dist * _MARGIN, offset(si, scene.extent))
    ray, left = _spawn_to(si, ds.p, ds.d, margin, scene.extent, active)
    if dr.hint(scene.has_media, mode="scalar"):
        medium = medium_paths.medium_after(si, ds.d, medium, left)
    through = _transmittance(scene, surfaces, False, goal_lamp, margin, ray, ds.p, medium, left)
    if dr.hint(outside_lamps is not None, mode="scalar"):
        assert outside_lamps is not None
        onwards = active & (beyond > 0) & (dr.max(through) > 0)
        rest = mi.Ray3f(ray)
        rest.o = dr.select(left, ds.p, ray.o)
        rest.d, rest.maxt = ds.d, beyond
        goal = dr.fma(beyond, ds.d, rest.o)
        none = dr.zeros(mi.MediumPtr)
        through *= _transmittance(
            scene, outside_lamps, passes, goal_lamp, mi.Float(0), rest, goal, none, onwards
        )
    if dr.hint(proxies.attenuate, mode="scalar"):
        crossed = left & (dr.max(through) > 0)
        distance, lamp = proxies.first(ray, ray.maxt, crossed)
        crossed &= lamp != NONE
        # Lamps that overlap attenuate all light of each other, as along rays that enter both.
        whole = mi.Ray3f(ray)
        whole.maxt = dr.select(scene.divided.owners.is_lamp(goal_lamp, active), dr.inf, ray.maxt)
        while crossed:
            emitter = scene.emitter(lamp, crossed)
            attenuated = scene.lamps.call("transmittance", emitter, whole, distance, crossed)
            # The lamp's light already contains its attenuation.
            through *= dr.select(crossed & (lamp != goal_lamp), attenuated, 1)
            distance, lamp = proxies.next(ray, distance, lamp, ray.maxt, crossed)
            crossed &= lamp != NONE
    return through


@dr.syntax
def _transmittance(
    scene: PathScene,
    traced: mi.Scene,
    passes: bool,
    goal_lamp: mi.UInt32,
    margin: mi.Float,
    ray: mi.Ray3f,
    goal: mi.Point3f,
    medium: mi.MediumPtr,
    active: mi.Bool,
) -> mi.Spectrum:
    """Transmittance of surfaces (`traced`), and of media, along a ray towards a sampled point.

    Glass of the lamp `goal_lamp` blocks: the lamp's light contains the light that passes it. With
    `passes` none of its surfaces blocks.
    """
    through, ray, direction = mi.Spectrum(1), mi.Ray3f(ray), mi.Vector3f(ray.d)
    if dr.hint(not (scene.has_null_surfaces or passes), mode="scalar"):
        # A ray of a length below 0 is reported as a hit although it is not active.
        through[active & traced.ray_test(ray, active)] = 0
        if dr.hint(scene.has_media, mode="scalar"):
            through *= medium_paths.transmittance(medium, ray.maxt, active, ray.wavelengths)
    else:
        owners = scene.divided.owners
        crossings = mi.UInt32(0)
        while active:
            pi = traced.ray_intersect_preliminary(ray, coherent=False, active=active)
            hit = active & pi.is_valid()
            if dr.hint(scene.has_media, mode="scalar"):
                length = dr.minimum(pi.t, ray.maxt)
                through *= medium_paths.transmittance(medium, length, active, ray.wavelengths)
            bsdf = pi.shape.bsdf()
            flags = bsdf.flags()
            null = hit & mi.has_flag(flags, mi.BSDFFlags.Null)
            passed = mi.Bool(False)
            if dr.hint(owners.exist, mode="scalar"):
                passed = hit & (owners.of(pi.shape, hit) == goal_lamp)
                if dr.hint(passes, mode="scalar"):
                    null |= passed
                else:
                    null &= ~(passed & ((flags & CROSSED_STRAIGHT) != 0))
                    passed = mi.Bool(False)
            crossing = pi.compute_surface_interaction(ray, mi.RayFlags.All, null)
            attenuation = dr.select(
                passed, 1, bsdf.eval_null_transmission(crossing, null & ~passed)
            )
            through[hit] *= dr.select(null, attenuation, 0)
            crossings += 1
            through[null & (crossings >= MAX_CROSSINGS)] = 0
            null &= dr.max(through) > 0
            if dr.hint(scene.has_media, mode="scalar"):
                medium = medium_paths.medium_after(crossing, direction, medium, null & ~passed)
            extent = scene.extent
            ray[null], active = _spawn_to(crossing, goal, direction, margin, extent, null)
    return through


def _spawn_to(
    si: mi.SurfaceInteraction3f,
    goal: mi.Point3f,
    direction: mi.Vector3f,
    margin: mi.Float,
    extent: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Ray3f, mi.Bool]:
    """Ray from a surface towards a point in a direction, and whether anything of it is left.

    Where an offset has brought it past the point, a ray that turned round would meet the same
    surface for ever.
    """
    origin = spawn(si, direction, extent).o
    segment = goal - origin
    length = dr.norm(segment)
    left = dr.dot(segment, direction) > margin
    ray = mi.Ray3f(origin, segment / length, length - margin, si.time, si.wavelengths)
    return ray, active & left


# ---------------------- Vertices ----------------------


def find_vertex(
    scene: PathScene,
    path: PathState,
    hit: Hit,
    free_flight: FreeFlight,
    max_depth: mi.UInt32,
) -> Vertex:
    """The vertex where a ray has ended."""
    si, bsdf = hit.si, hit.bsdf
    active = path.active & (si.is_valid() | hit.hit_medium)
    # Null interactions do not count: light may come through them.
    last = path.depth - path.depth_freed + 1 >= max_depth
    if scene.has_null_surfaces:
        passes = hit.hit_surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        active &= ~last | passes
    else:
        active &= ~last
    if scene.has_scattering:
        si[hit.hit_medium] = medium_paths.scattering_point(path.ray, free_flight.distance)
    active_surface, active_medium = active & ~hit.hit_medium, active & hit.hit_medium

    straight_glass, behind = mi.Bool(False), mi.Bool(False)
    if scene.shows_geometry:
        # Glass that light crosses straight is seen from outside on both sides.
        straight_glass = (
            active_surface & ~path.specular_chain & ((bsdf.flags() & CROSSED_STRAIGHT) != 0)
        )
        behind = straight_glass & (si.wi.z < 0)
        si.wi.z = dr.select(behind, -si.wi.z, si.wi.z)
    opaque = active_surface & is_opaque(bsdf)
    return Vertex(
        si,
        bsdf,
        hit.owner,
        hit.shown,
        active_surface,
        active_medium,
        last,
        opaque,
        straight_glass,
        behind,
    )


def sample_scattering(
    scene: PathScene, path: PathState, vertex: Vertex, d_em: mi.Vector3f, sampler: mi.Sampler
) -> Scattering:
    """Evaluate the BSDF or phase function for the emitter's direction, and sample another one."""
    si, active_medium = vertex.si, vertex.active_medium
    wo = si.to_local(d_em)
    value, pdf, bs, weight = vertex.bsdf.eval_pdf_sample(
        scene.bsdf_ctx,
        si,
        dr.detach(wo),
        sampler.next_1d(),
        sampler.next_2d(),
        vertex.active_surface,
    )
    if scene.lamps.tracked:
        # The direction follows the lamp; apart, since the sampled direction does not.
        value = vertex.bsdf.eval(scene.bsdf_ctx, si, wo, vertex.active_surface)
    phase_wo = mi.Vector3f(0)
    if scene.has_scattering:
        phase = medium_paths.eval_phase(path.medium, path.ray, d_em, active_medium)
        value[active_medium], pdf[active_medium] = phase
        phase_wo, *phase = medium_paths.sample_phase(path.medium, path.ray, sampler, active_medium)
        weight[active_medium], bs.pdf[active_medium] = phase
    return Scattering(value, pdf, bs, weight, phase_wo)


def scatter(scene: PathScene, path: PathState, vertex: Vertex, scattering: Scattering) -> mi.Bool:
    """Update paths for the sampled direction.

    Returns:
        Whether the vertex counts as a bounce: whether it is not a null interaction.
    """
    si, bs, owners = vertex.si, scattering.bs, scene.divided.owners
    active = vertex.active_surface | vertex.active_medium
    null = vertex.active_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
    if scene.shows_geometry:
        crossed = vertex.straight_glass & mi.has_flag(
            bs.sampled_type, mi.BSDFFlags.DeltaTransmission
        )
        null |= crossed
        # Radiance is not compressed, as it would be in a denser medium.
        path.β[crossed] *= dr.square(bs.eta)
        bs.wo.z = dr.select(vertex.behind, -bs.wo.z, bs.wo.z)
        owners.add(path.bent_by, vertex.owner, crossed)
    bounces = active & ~null
    path.β[active] *= scattering.weight
    path.η[bounces & vertex.active_surface] *= bs.eta

    # Information about the current vertex needed by the next iteration
    path.si_prev[bounces] = mi.Interaction3f(si)
    path.bsdf_pdf_prev[bounces] = bs.pdf
    delta = vertex.active_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    path.bsdf_delta_prev[bounces] = delta
    path.specular_chain &= ~bounces | path.bsdf_delta_prev
    # A ray that goes on behind a surface of a lamp has the lamp's light already.
    for lamp in path.skipped:
        lamp[bounces] = NONE
    if scene.shows_geometry:
        path.self_emission[bounces] = dr.select(vertex.shown, vertex.owner, NONE)
        path.on_lamp[bounces] = vertex.owner
        for lamp in path.bent_by:
            lamp[bounces] = NONE
        owners.add(path.skipped, vertex.owner, bounces | null)
    path.depth[bounces] += 1
    path.crossings[null] += 1
    if owners.scatter:
        # Light that scatters in a lamp is shown whatever the largest depth: as the light that the
        # lamp sends elsewhere.
        freed = bounces & vertex.shown & owners.scatters(vertex.owner, bounces)
        path.depth_freed[freed & (path.depth_freed < MAX_CROSSINGS)] += 1
    path.valid_ray |= bounces
    path.active = _next_ray(scene, path, vertex, scattering, null) & ~(bounces & vertex.last)
    return bounces


def _next_ray(
    scene: PathScene, path: PathState, vertex: Vertex, scattering: Scattering, null: mi.Bool
) -> mi.Bool:
    """Set the ray that leaves a vertex, and its medium; returns whether there is one."""
    si, arriving = vertex.si, path.ray.d
    # A null ray keeps its direction to the last bit.
    direction = dr.select(null, arriving, si.to_world(scattering.bs.wo))
    if scene.has_scattering:
        direction[vertex.active_medium] = scattering.phase_wo
    leaks = vertex.opaque & ~null & on_opposite_sides(si, arriving, direction)
    path.ray = spawn(si, direction, scene.extent)
    if scene.has_media:
        path.medium = medium_paths.medium_after(si, path.ray.d, path.medium, vertex.active_surface)
    return (vertex.active_surface | vertex.active_medium) & ~leaks


def roulette(path: PathState, bounces: mi.Bool, rr_depth: int, sampler: mi.Sampler) -> None:
    """End paths with a probability that depends on their throughput, as `path` does."""
    β_max = dr.max(path.β)
    rr_prob = dr.minimum(β_max * dr.square(path.η), 0.95)
    rr_active = bounces & (path.depth >= rr_depth)
    path.active &= ~rr_active | (sampler.next_1d() < rr_prob)
    path.β[rr_active] *= dr.rcp(rr_prob)
    path.active &= (β_max != 0) & (path.crossings < MAX_CROSSINGS)
