"""Faults that exported models often have: faces that are there more than once, and likely mistakes.

A face counts once, however many copies are in one place: every copy would emit and absorb light.
Faults that do not show by themselves are warned of, each with its remedy.
"""

import dataclasses
import operator
import warnings
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.materials import (
    Image,
    Material,
    MetallicRoughness,
    Parameter,
    Texture,
    ThinDielectric,
    VertexColours,
)
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeWarning, shown
from lumitree.lamp.importers.overrides import Overrides, setting
from lumitree.lamp.importers.topology import Indices, has_body, probes, reach, repeats, weld
from lumitree.lamp.meshes import Floats, Mesh, area_normals, selected, with_backs
from lumitree.lamp.parts import Geometry, Names, Part

# Largest difference of two surfaces that are the same, as a fraction of the area: quads may not be
# flat.
_ALIKE = 0.01
# Most copies of different surfaces in one box that others are compared with.
_COMPARED = 8


def kept_faces(
    corners: Floats, within: float, sided: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which faces [F] are used, and which of these [F] need a reversed copy.

    `corners` and `within` are as in `repeats`. If the two sides of the material differ, both
    windings of a face are used, the second as a copy of the first.
    """
    first, turned = repeats(corners, within)
    both = np.zeros(len(first), np.bool_)
    both[first[turned & sided]] = True
    return first == np.arange(len(first)), both


def with_reversed(mesh: Mesh, both: NDArray[np.bool_], within: float) -> Mesh:
    """The mesh with the reversed copies that `kept_faces` asks for."""
    # Farther than one face from another, so that they are not taken for one.
    return with_backs(mesh, both, 2 * within) if both.any() else mesh


def warn_of_repeated(file: str, count: int) -> None:
    """Say how many faces of a model are not used, if there are any."""
    if count:
        warnings.warn(
            f"{shown(file, 300)}: {count:,} faces repeat others of the same material in the same "
            "place; each is used once",
            LumitreeWarning,
            stacklevel=3,
        )


def without_repeated(model: Geometry, sided: Collection[str], file: str) -> Geometry:
    """The model with every face once, also where copies of parts are in one place.

    `sided` are the titles of the materials whose two sides differ, such as those that emit.
    """
    copies: dict[str, list[tuple[Part, int]]] = defaultdict(list)
    for part in model.parts:
        copies[model.material(part).title] += [(part, at) for at in range(len(part.places))]
    used: dict[tuple[str, int], tuple[NDArray[np.bool_], NDArray[np.bool_]]] = {}
    within, dropped = {}, 0
    for name, placements in copies.items():
        placed = [(part.placed(at), part.mesh.faces) for part, at in placements]
        within[name] = reach(np.concatenate([vertices for vertices, _ in placed]))
        twice = _repeated_surfaces(placed, within[name], name in sided)
        single = [copy[0][copy[1]] for copy, again in zip(placed, twice, strict=True) if not again]
        keep, both = kept_faces(np.concatenate(single), within[name], name in sided)
        dropped += int((~keep).sum() - both.sum())
        splits = np.cumsum([len(corners) for corners in single])[:-1]
        masks = iter(zip(np.split(keep, splits), np.split(both, splits), strict=True))
        for (part, at), again in zip(placements, twice, strict=True):
            nothing = np.zeros(len(part.mesh.faces), np.bool_)
            used[part.name, at] = (nothing, nothing) if again else next(masks)
            dropped += len(nothing) * again
    warn_of_repeated(file, dropped)
    names, parts = Names("_"), []
    for part in model.parts:
        names.unique(part.name)
    for part in model.parts:
        alike: dict[bytes, list[int]] = defaultdict(list)
        for at in range(len(part.places)):
            alike[np.stack(used[part.name, at]).tobytes()].append(at)
        name = part.name
        for places in alike.values():
            keep, both = used[part.name, places[0]]
            if keep.any():
                scale = np.cbrt(abs(np.linalg.det(part.places[places[0]][:3, :3])))
                mesh = with_reversed(part.mesh, both, within[model.material(part).title] / scale)
                if not keep.all():
                    mesh = selected(mesh, np.concatenate([keep, np.ones(both.sum(), np.bool_)]))
                parts.append(dataclasses.replace(part.copies(places), name=name, mesh=mesh))
                name = names.unique(part.name)
    return dataclasses.replace(model, parts=tuple(parts))


def _repeated_surfaces(
    copies: Sequence[tuple[Floats, Indices]], within: float, sided: bool
) -> list[bool]:
    """Which copies (vertices [V, 3], faces) are the surface of an earlier one, cut in any way.

    An example is a sphere and its mirror image, whose quads have the other diagonal.
    """
    # Boxes, whose corners are in the same places.
    low = weld(np.stack([vertices.min(axis=0) for vertices, _ in copies]), within)
    high = weld(np.stack([vertices.max(axis=0) for vertices, _ in copies]), within)
    earlier: dict[tuple[int, int], list[int]] = defaultdict(list)
    repeated = []
    for at, (copy, *box) in enumerate(zip(copies, low.tolist(), high.tolist(), strict=True)):
        others = earlier[box[0], box[1]]
        sides = [_side(copies[other], copy, within) for other in others[:_COMPARED]]
        repeated.append(any(side == 1 or (side == -1 and not sided) for side in sides))
        if not repeated[-1]:
            others.append(at)
    return repeated


def _side(one: tuple[Floats, Indices], other: tuple[Floats, Indices], within: float) -> int:
    """1 where two surfaces are the same, -1 where one is the other turned round, 0 otherwise.

    The same surfaces have vertices in the same places, and the same areas by their normals.
    """
    split = len(one[0])
    places = weld(np.concatenate([one[0], other[0]]), within)
    count = int(places.max()) + 1
    fields, moments = [], []
    for (vertices, faces), used in zip((one, other), np.split(places, [split]), strict=True):
        if len(np.unique(used)) < count:
            return 0
        normals = area_normals(vertices, faces)
        corners = used[faces].ravel()
        fields.append([np.bincount(corners, np.repeat(axis, 3), count) for axis in normals.T])
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        moments.append((normals / lengths[:, None]).T @ normals)
    if np.abs(moments[1] - moments[0]).max() > _ALIKE * np.trace(moments[0]):
        return 0
    return int(np.sign((np.array(fields[0]) * np.array(fields[1])).sum()))


def warn_of_likely_faults(model: Geometry, overrides: Overrides, file: str, toml: str) -> None:
    """Warn of emission in other units than lights, and of solid glass that the file makes thin.

    Materials whose overrides already say it are left out. The model is without its overrides, which
    the warning says to write to `toml`.
    """
    for fault, line in (*_two_units(model, overrides), *_thin_bodies(model, overrides)):
        warnings.warn(
            f"{shown(file, 300)}: {fault}: put first into {shown(toml, 100)}: {line}",
            LumitreeWarning,
            stacklevel=3,
        )


def _two_units(model: Geometry, overrides: Overrides) -> Iterator[tuple[str, str]]:
    """Emission of surfaces beside lights in candela: Blender writes its W/(m² sr) as cd/m²."""
    used = {part.material: part.in_metres for part in model.parts}
    if not any(used.values()):
        return
    for material in model.materials:
        change = overrides.of(material)
        overridden = change is not None and change.emission is not None
        if used.get(material.name) is False and material.radiance is not None and not overridden:
            luminance = LUMENS_PER_WATT * _mean(material.radiance, model.images)
            yield (
                f"material {shown(material.title)!r} emits {luminance.max():.4g} cd/m² beside "
                "lights in candela; if Blender wrote this number as W/(m² sr), the surface is "
                f"{LUMENS_PER_WATT:g} times too dark beside them",
                setting(material.title, f"emitter = {{ radiance = {_toml(luminance)} }}"),
            )


def _thin_bodies(model: Geometry, overrides: Overrides) -> Iterator[tuple[str, str]]:
    """Closed bodies of glass that is thin for want of a volume, as Blender writes it."""
    copies = [
        (part.name, at, model.material(part).title, probes(part.placed(at)))
        for part in model.parts
        for at in range(len(part.places))
    ]
    warned: set[str] = set()
    for part in model.parts:
        material = model.material(part)
        title, change = material.title, overrides.of(material)
        solid = _as_solid(material.surface, model.images)
        overridden = change is not None and change.surface is not None
        if title in warned or solid is None or overridden:
            continue
        alike, others = (
            [p for *copy, name, p in copies if copy != [part.name, 0] and keep(name, title)]
            for keep in (operator.eq, operator.ne)
        )
        if has_body(dataclasses.replace(part.mesh, vertices=part.placed(0)), alike, others):
            warned.add(title)
            yield (
                f"material {shown(title)!r} is glass without a volume, a thin sheet in glTF, but "
                "its mesh is closed; if it is solid, or a wall with both sides",
                setting(title, solid),
            )


def _as_solid(surface: Material, images: Sequence[Image]) -> str | None:
    """TOML of the solid glass of which a file has thin sheets; None for other surfaces."""
    match surface:
        case ThinDielectric():
            ior, roughness, transmission = surface.int_ior, 0.0, 1.0
            colour = _mean(surface.specular_transmittance or 1.0, images)
        case MetallicRoughness(thin=True):
            ior, colour = surface.eta, _mean(surface.base_color, images)
            roughness = float(_mean(surface.roughness, images)[0])
            transmission = float(_mean(surface.spec_trans, images)[0])
        case _:
            return None
    if transmission == 0:
        return None
    shared = f"ior = {ior:.4g}, roughness = {roughness:.4g}"
    if transmission < 1:
        base = f"base_color = {_toml(colour)}, transmission = {transmission:.4g}"
        return f"principled = {{ {shared}, {base} }}"
    # Light crosses both sides of a solid.
    return f"glass = {{ {shared}, tint = {_toml(np.sqrt(colour))}, thin = false }}"


def _mean(value: Parameter, images: Sequence[Image]) -> Floats:
    """The channels of a parameter; of an image their means, of vertex colours white."""
    if isinstance(value, Texture):
        return value.linear(images).mean(axis=(0, 1), dtype=np.float64)
    return np.atleast_1d(np.array(1.0 if isinstance(value, VertexColours) else value, np.float64))


def _toml(colour: ArrayLike) -> str:
    channels = [f"{channel:.4g}" for channel in np.ravel(colour)]
    return channels[0] if len(set(channels)) == 1 else f"[{', '.join(channels)}]"
