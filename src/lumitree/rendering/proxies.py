"""Proxies of baked luminaires, which an integrator tests itself instead of tracing them.

A null shape that every ray may meet costs more time than a lamp's light. Rays are traced in
packets, and a packet takes as long as its longest ray: one ray that crosses a proxy is traced three
times. So `DividedScene` divides a scene into its surfaces, which are traced, and its proxies, which
rays find in a tree of boxes. Nothing traces the scene itself: under OptiX a kernel may trace
one scene only.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.lamp.scene_shapes import build_again, shape_groups
from lumitree.rendering.emitter import PlacedLamp, lamp_of, lamps_of, sampled_only
from lumitree.rendering.objects import make_object, shape_number
from lumitree.rendering.placement_checks import contains_objects, overlapping
from lumitree.rendering.sampling import safe_inverse, slab

# Bound on the null surfaces that a path, or a shadow ray, crosses, so that every kernel terminates.
MAX_CROSSINGS = 1024
# Index of no emitter.
NONE = 0xFFFFFFFF
# Packets of four numbers of a proxy on the device: a point, a matrix, `lights_inside`,
# `sampled_only_radius`, and zeros; and of a node of the tree (`box_tree`).
_PACKETS, _NODE_PACKETS = 4, 2
# Part of the distance by which a ray may miss a node's box, and by which boxes are larger than they
# need be, so that rounding loses none.
_SLACK = 1e-5


class Proxies:
    """The proxies of the baked luminaires of a scene.

    Args:
        emitters: `mi.Scene.emitters()`.
    """

    def __init__(self, emitters: list[mi.Emitter]) -> None:
        rows, boxes, lamps = [], [], lamps_of(emitters)
        for index, lamp in lamps.items():
            matrix, centre = lamp.unit_proxy()
            radius = lamp.sampled_only_radius if emitters[index].sampling_weight() > 0 else 0.0
            rows.append([*centre, *matrix.ravel(), lamp.lights_inside, radius, 0, 0])
            reach = np.abs(np.linalg.inv(matrix)).sum(axis=1)
            boxes.append([centre - reach, centre + reach])
        # Whether there are any, and whether any has a transmittance below 1.
        self.exist, self.attenuate = bool(rows), any(lamp.attenuates for lamp in lamps.values())
        if rows:
            # On the device: numbers of lamps do not compile new kernels.
            nodes = box_tree(*np.moveaxis(np.array(boxes), 1, 0))
            self._count = parameter(mi.UInt32, len(nodes))
            self._nodes = on_device(mi.Float, nodes)
            self._rows = on_device(mi.Float, np.array(rows))
            self._indices = on_device(mi.UInt32, list(lamps))

    def first(
        self,
        ray: mi.Ray3f,
        end: mi.Float,
        active: mi.Bool,
        starts: mi.Bool | bool = False,
        skipped: Sequence[mi.UInt32] = (),
        sampled: tuple[mi.Point3f, mi.Float] | None = None,
    ) -> tuple[mi.Float, mi.UInt32]:
        """As `next`, for the first proxy on a ray."""
        return self.next(ray, mi.Float(-1), mi.UInt32(NONE), end, active, starts, skipped, sampled)

    @dr.syntax
    def next(
        self,
        ray: mi.Ray3f,
        after: mi.Float,
        last: mi.UInt32,
        end: mi.Float,
        active: mi.Bool,
        starts: mi.Bool | bool = False,
        skipped: Sequence[mi.UInt32] = (),
        sampled: tuple[mi.Point3f, mi.Float] | None = None,
    ) -> tuple[mi.Float, mi.UInt32]:
        """The proxy that a ray enters next.

        A proxy in which a ray starts is entered at the origin, if the lamp `lights_inside`,
        or else if the ray is one of `starts`.

        Args:
            after, last: result for the proxy before.
            starts: mask of these rays.
            skipped: lamps whose proxies are not entered at the origin (`Owners.add`).
            sampled: vertex that the ray comes from, and density per steradian with which its BSDF
                sampled the ray. Skipped are proxies whose light next-event estimation alone finds
                there, and which transmit all light (`sampled_only_radius`).

        Returns:
            Distance from the origin of the ray; and index of the emitter in the scene, `NONE` where
            there is no further proxy.
        """
        distance, found = mi.Float(end), dr.full(mi.UInt32, NONE, dr.width(end))
        inverse, node = safe_inverse(ray.d), dr.zeros(mi.UInt32, dr.width(end))
        while active & (node < self._count):
            near, far, behind, proxy = self._cross(node, ray.o, inverse, active)
            meets = active & (near <= far) & (far >= after) & (near <= distance)
            at_proxy = meets & (proxy != NONE)
            index = dr.gather(mi.UInt32, self._indices, proxy, at_proxy)
            entry, enters = self._enter(proxy, index, ray, at_proxy, starts, skipped, sampled)
            # Proxies that are entered at the same distance come in the order of their emitters.
            enters &= (entry > after) | ((entry == after) & (last != NONE) & (index > last))
            first = (entry == distance) & (found != NONE) & (index < found)
            enters &= (entry < distance) | first
            distance[enters] = entry
            found[enters] = index
            node = dr.select(meets, node + 1, behind)
        return distance, found

    def _cross(
        self, node: mi.UInt32, origin: mi.Point3f, inverse: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.UInt32]:
        """Distances at which rays cross the box of a node, no less than they do.

        Then the node that follows if the box is missed, and the proxy that this node is, or `NONE`.
        """
        first, second = (
            dr.gather(mi.Vector4f, self._nodes, _NODE_PACKETS * node + i, active)
            for i in range(_NODE_PACKETS)
        )
        centre, half = (
            mi.Point3f(first.x, first.y, first.z),
            mi.Vector3f(first.w, second.x, second.y),
        )
        near, far = slab(mi.Vector3f(centre - origin), half, inverse)
        near, far = dr.max(near), dr.min(far)
        proxy = dr.select(second.w < 0, NONE, mi.UInt32(dr.maximum(second.w, 0)))
        return near - _SLACK * dr.abs(near), far + _SLACK * dr.abs(far), mi.UInt32(second.z), proxy

    def _enter(
        self,
        proxy: mi.UInt32,
        index: mi.UInt32,
        ray: mi.Ray3f,
        active: mi.Bool,
        starts: mi.Bool | bool,
        skipped: Sequence[mi.UInt32],
        sampled: tuple[mi.Point3f, mi.Float] | None,
    ) -> tuple[mi.Float, mi.Bool]:
        """Distance at which a ray enters a proxy of an emitter's index, and whether it does."""
        packets = [
            dr.gather(mi.Vector4f, self._rows, proxy * _PACKETS + i, active)
            for i in range(_PACKETS)
        ]
        values = [number for packet in packets for number in packet]
        matrix, (lights, radius) = mi.Matrix3f(*values[3:12]), values[12:14]
        if sampled is not None:
            # A little less often than the lamp itself does, whose rounding is another.
            x, pdf = sampled
            x = mi.Point3f(x - mi.Point3f(*values[:3]))
            active &= (radius <= 0) | ~sampled_only(x, radius, pdf * (1 + _SLACK))
        # In these coordinates the proxy is the cube of [-1, 1]³.
        o, d = mi.Vector3f(matrix @ (ray.o - mi.Point3f(*values[:3]))), matrix @ ray.d
        near, far = slab(-o, mi.Vector3f(1), safe_inverse(d))
        entry = dr.max(near)
        crosses = entry <= dr.min(far)
        begins = (dr.max(dr.abs(o)) <= 1) & ((lights > 0) | starts)
        for lamp in skipped:
            begins &= index != lamp
        return dr.select(begins, 0, entry), active & (begins | (crosses & (entry > 0)))


class Divided(NamedTuple):
    """A scene as `DividedScene` divides it.

    Attributes:
        surfaces: the scene that rays are traced against.
        proxies: those that it leaves out.
        outside_lamps: scene that is traced where the surfaces of a lamp do not block: the surfaces
            that belong to no lamp; None if no lamp needs it.
        passes: whether `outside_lamps` is `surfaces`, and rays pass the lamp's surfaces one after
            another: where lamps whose surfaces are traced have boxes that overlap, or where a
            kernel may trace one scene only.
        owners: whose surfaces are whose.
    """

    surfaces: mi.Scene
    proxies: Proxies
    outside_lamps: mi.Scene | None
    passes: bool
    owners: Owners

    def end(
        self, ray: mi.Ray3f, distance: mi.Float, lamp: mi.UInt32, ahead: mi.UInt32, active: mi.Bool
    ) -> mi.Float:
        """Distance at which a ray terminates for a lamp whose proxy it enters (`eval_entered`).

        Args:
            distance: at which it terminates for the integrator.
            ahead: lamp that the surface at `distance` belongs to (`Owners.of`).
        """
        mine = ahead == lamp
        other = mi.Float(dr.inf)
        if self.outside_lamps is not None:
            # Another object in the box may be behind the lamp's surface.
            other = self._behind(self.outside_lamps, ray, lamp, active & mine)
        return dr.select(mine, other, distance)

    @dr.syntax
    def _behind(self, scene: mi.Scene, ray: mi.Ray3f, lamp: mi.UInt32, active: mi.Bool) -> mi.Float:
        """Distance of the first surface that does not belong to a lamp."""
        pi = scene.ray_intersect_preliminary(ray, False, active)
        distance = mi.Float(pi.t)
        if dr.hint(self.passes, mode="scalar"):
            ray, passed, crossings = mi.Ray3f(ray), mi.Float(0), mi.UInt32(0)
            mine = active & pi.is_valid() & (self.owners.of(pi.shape, active) == lamp)
            while mine:
                # In the direction of the ray, whatever the surface.
                step = pi.t * (1 + mi.math.RayEpsilon) + mi.math.RayEpsilon * dr.max(dr.abs(ray.o))
                passed += step
                ray.o = dr.fma(step, ray.d, ray.o)
                pi = scene.ray_intersect_preliminary(ray, False, mine)
                distance[mine] = passed + pi.t
                crossings += 1
                mine &= pi.is_valid() & (self.owners.of(pi.shape, mine) == lamp)
                mine &= crossings < MAX_CROSSINGS
        return distance


class Owners:
    """The lamps, by index of their emitters, that shapes, and media that scatter, belong to.

    A set of lamps that a ray has met is a list of their indices. Boxes are convex, so that a ray
    that has left a box does not come back. Lamps whose boxes do not overlap therefore share a place
    in the list, where the later one takes the place of the one before.

    Args:
        lamps: of the scene, by index of their emitters.
        overlaps: [P, 2] pairs of indices of lamps whose boxes overlap and whose surfaces are
            traced.
    """

    def __init__(
        self, lamps: Mapping[int, PlacedLamp], overlaps: Sequence[tuple[int, int]] = ()
    ) -> None:
        # By the number of a shape.
        self.owner = {
            number: index for index, lamp in lamps.items() for number in lamp.shape_numbers
        }
        owner_of_medium = {
            number: index for index, lamp in lamps.items() for number in lamp.medium_numbers
        }
        cloudy = dict.fromkeys(owner_of_medium.values(), 1)
        # Whether there are shapes, and media that scatter.
        self.exist, self.scatter = bool(self.owner), bool(owner_of_medium)
        self._lamps, self._lamps_of_media = _Numbers(self.owner), _Numbers(owner_of_medium)
        self._cloudy, self._known = _Numbers(cloudy), _Numbers(dict.fromkeys(lamps, 1))
        places: dict[int, int] = {}
        for index in lamps:
            taken = {places.get(i) for pair in overlaps if index in pair for i in pair}
            places[index] = next(place for place in itertools.count() if place not in taken)
        self._num_places = max(places.values(), default=0) + 1
        self._places = _Numbers(places)

    def of(self, shape: mi.ShapePtr, active: mi.Bool) -> mi.UInt32:
        """Index of the emitter whose lamp a shape belongs to, or `NONE`."""
        return self._lamps.look_up(dr.reinterpret_array(mi.UInt32, shape), active)

    def of_medium(self, medium: mi.MediumPtr, active: mi.Bool) -> mi.UInt32:
        """As `of`, for a medium; `NONE` for a medium that only absorbs."""
        return self._lamps_of_media.look_up(dr.reinterpret_array(mi.UInt32, medium), active)

    def is_lamp(self, index: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """Whether the emitter of an index is a lamp."""
        return self._known.look_up(index, active) != NONE

    def no_lamps(self) -> list[mi.UInt32]:
        """An empty set of lamps that a ray has met."""
        return [mi.UInt32(NONE) for _ in range(self._num_places)]

    def add(self, met: list[mi.UInt32], lamp: mi.UInt32, active: mi.Bool) -> None:
        """Add lamps, or none where `lamp` is `NONE`, to a set of lamps that rays have met."""
        known = active & (lamp != NONE)
        if self._num_places == 1:
            met[0][known] = lamp
            return
        of_lamp = self._places.look_up(lamp, known)
        for place, kept in enumerate(met):
            kept[known & (of_lamp == place)] = lamp

    def scatters(self, lamp: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """Whether media of the lamp of this index scatter."""
        return self._cloudy.look_up(lamp, active) != NONE


class _Numbers:
    """Numbers by other numbers, on the device; there may be none."""

    def __init__(self, values: Mapping[int, int]) -> None:
        self._any = bool(values)
        if self._any:
            table = np.full(max(values) + 1, NONE, np.uint32)
            table[list(values)] = list(values.values())
            self._count = parameter(mi.UInt32, len(table))
            self._table = on_device(mi.UInt32, table)

    def look_up(self, number: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """The value of a number, or `NONE`."""
        if not self._any:
            return mi.UInt32(NONE)
        known = active & (number < self._count)
        return dr.select(known, dr.gather(mi.UInt32, self._table, number, known), NONE)


class DividedScene:
    """Divides a scene into a scene of its surfaces, and its proxies.

    An integrator keeps one, so that the surfaces' acceleration structure is built once. It holds
    the shapes of the scene but not the scene, which may hold the integrator.
    """

    def __init__(self) -> None:
        self._shapes: list[mi.Shape] | None = None
        self._parameters: list[list[object]] = []
        # Poses of all lamps, and of those whose surfaces are traced.
        self._poses: tuple[list[bytes], list[bytes]] = [], []
        self._surfaces: mi.Scene | None = None
        self._outside_lamps: mi.Scene | None = None
        # The surfaces that belong to no lamp, and pairs of lamps that overlap.
        self._others: list[mi.Shape] = []
        self._overlaps: list[tuple[int, int]] = []
        # Lamps that light the objects in their boxes, if there are any; not kept alive.
        self._lit: list[weakref.ref[PlacedLamp]] = []

    def of(self, scene: mi.Scene) -> Divided:
        """The surfaces that rays of a scene are traced against, and the proxies that it leaves out.

        The surfaces are the scene itself if it has no proxies.
        """
        shapes, emitters = scene.shapes(), scene.emitters()
        surfaces = [shape for shape in shapes if lamp_of(shape.emitter()) is None]
        lamps = lamps_of(emitters)
        if not lamps:
            return Divided(scene, Proxies([]), None, False, Owners({}))
        groups = shape_groups(scene)
        parameters = [_parameters(shape) for shape in [*groups, *surfaces]]
        poses = [lamp.numbers.tobytes() for lamp in lamps.values()]
        moving = [lamp.numbers.tobytes() for lamp in lamps.values() if lamp.shape_numbers]
        same = surfaces == self._shapes and all(map(_same, parameters, self._parameters))
        same &= moving == self._poses[1]
        # Another scene may have the same surfaces and other lamps.
        lit = [lamp() for lamp in self._lit] == list(lamps.values())
        if not (same and lit and poses == self._poses[0]):
            if not same:
                self._surfaces = _scene_of(groups, surfaces)
            self._outside_lamps = None
            self._shapes, self._parameters, self._poses = surfaces, parameters, (poses, moving)
            owned = {number for lamp in lamps.values() for number in lamp.shape_numbers}
            self._others = [each for each in surfaces if shape_number(each) not in owned]
            self._overlaps = _light_insides(list(lamps.values()), self._others)
            self._lit = [weakref.ref(lamp) for lamp in lamps.values()]
        assert self._surfaces is not None
        indices = list(lamps)
        owners = Owners(lamps, [(indices[i], indices[j]) for i, j in self._overlaps])
        outside_lamps, passes = None, bool(self._overlaps) or _one_scene_only()
        if owners.exist and any(lamp.lights_inside for lamp in lamps.values()):
            if not passes and self._outside_lamps is None:
                self._outside_lamps = _scene_of(groups, self._others)
            outside_lamps = self._surfaces if passes else self._outside_lamps
        return Divided(self._surfaces, Proxies(emitters), outside_lamps, passes, owners)


def _one_scene_only() -> bool:
    """Whether a kernel may trace one scene only, as under OptiX."""
    return dr.backend_v(mi.Float) == dr.JitBackend.CUDA


def _light_insides(lamps: list[PlacedLamp], others: list[mi.Shape]) -> list[tuple[int, int]]:
    """Let lamps light shapes in their boxes; pairs where another lamp's shapes are in one of them.

    Pairs are places in `lamps`.
    """
    boxes = np.array([lamp.scene_from_box for lamp in lamps]).reshape(-1, 4, 4)
    lit, pairs = contains_objects(others, boxes), []
    for i, j in overlapping(boxes).tolist():
        if lamps[i].shows_geometry or lamps[j].shows_geometry:
            lit[[i, j]] = True
            pairs.append((i, j))
    for lamp, lights in zip(lamps, lit, strict=True):
        lamp.light_inside(bool(lights))
    return pairs


def _scene_of(groups: list[mi.Shape], shapes: list[mi.Shape]) -> mi.Scene:
    """A scene of shapes, and of the groups that its instances repeat."""
    build_again(groups)
    described: dict[str, object] = {f"shape_{i}": each for i, each in enumerate([*groups, *shapes])}
    emitters = [shape.emitter() for shape in shapes if shape.is_emitter()]
    if emitters and not any(emitter.sampling_weight() for emitter in emitters):
        # Mitsuba accepts no scene whose emitters are never sampled; this one is not used.
        described["light"] = make_object("point", {})
    # Not by `load_dict`, which would rename the shapes.
    return make_object("scene", described)


def is_instance(shape: mi.Shape) -> bool:
    """Whether a shape repeats others, whose BSDFs are not accessible."""
    return shape.class_name() == "Instance"


def _parameters(shape: mi.Shape) -> list[object]:
    """The parameters of a shape itself, without its BSDF and its emitter."""
    parameters = mi.traverse(shape)
    values = (parameters[name] for name in parameters.properties if "." not in name)
    # Mitsuba returns references to some values, which change with the shape.
    return [type(value)(value) for value in values]


def _same(first: list[object], second: list[object]) -> bool:
    """Whether two lists of `_parameters` have the same numbers."""

    def equal(a: object, b: object) -> bool:
        # As `mitsuba.SceneParameters` compares them: arrays of equal index are one array, which is
        # not changed as long as both refer to it.
        if dr.detail.collect_indices(a) == dr.detail.collect_indices(b) != []:
            return True
        a, b = (getattr(each, "matrix", each) for each in (a, b))
        return np.array_equal(np.array(a), np.array(b))

    return all(map(equal, first, second))


def box_tree(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nodes [2 N - 1, 8] of a binary tree over N ≥ 1 boxes, in depth-first order.

    A row has the centre and the half extents of a box; the row that follows its subtree; and the
    number of the box, -1 for a node with children. A node is followed by its first child, so a ray
    that meets it continues with the next row, and one that misses it with the row that follows its
    subtree.
    """
    rows: list[NDArray[np.float64]] = []

    def add(members: NDArray[np.int64]) -> None:
        corner, other = low[members].min(axis=0), high[members].max(axis=0)
        half = (other - corner) / 2 * (1 + _SLACK)
        box = members[0] if len(members) == 1 else -1
        row = np.array([*(corner + other) / 2, *half, 0, box])
        rows.append(row)
        if len(members) > 1:
            centres = low[members] + high[members]
            axis = np.ptp(centres, axis=0).argmax()
            members = members[np.argsort(centres[:, axis], kind="stable")]
            middle = len(members) // 2
            add(members[:middle])
            add(members[middle:])
        row[6] = len(rows)

    add(np.arange(len(low)))
    return np.array(rows)
