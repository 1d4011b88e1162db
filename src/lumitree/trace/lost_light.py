"""Where the light of a luminaire is lost or created, for messages."""

import warnings
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.overrides import setting
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.scene_shapes import SceneShape, shapes_of_scene
from lumitree.trace.emitted_rays import as_rows, seeded_sampler
from lumitree.trace.light_paths import emit, emitted_flux
from lumitree.trace.medium_paths import coefficients, medium_after
from lumitree.trace.spawning import scene_extent, spawn
from lumitree.trace.tracing import PATH_DEPTH

# Part of the light of the emitters below which the luminaire is said to enclose them.
_ENCLOSED = 1e-3
# Standard errors by which the light that leaves must exceed the light of the emitters; and this
# part of it, for what shading normals add.
_CERTAIN, _CREATED = 3, 2e-3
_PATHS, _BARE_PATHS = 1 << 13, 1 << 18
# Shapes that a message names have at least this part of what the first has.
_COMPARABLE, _NAMED = 0.5, 3


def check_output(luminaire: Luminaire, lumens: NDArray[np.float64], seed: int) -> None:
    """Refuse a luminaire that no light leaves; warn of one that encloses or creates light.

    Args:
        lumens: [B] independent estimates of the luminous flux that leaves it, local units.
        seed: root seed.

    Raises:
        LumitreeError: all are 0; the message names what encloses the emitters.
    """
    sampler = seeded_sampler(SeedStream(Purpose.FLUX, draw=1).seed(seed), _BARE_PATHS)
    bare = luminance(as_rows(emitted_flux(luminaire, sampler, _BARE_PATHS)[0])) * _BARE_PATHS
    emitted, leaving = bare.mean(), lumens.mean()
    if emitted == 0:
        raise LumitreeError(f"no light leaves {luminaire.name}; its emitters are black")
    share = leaving / emitted
    if share < _ENCLOSED:
        how_much = f"only {100 * share:.2g} % of the" if leaving > 0 else "no"
        message = f"{how_much} light leaves {luminaire.name}: {_enclosing(luminaire, seed)}"
        if leaving == 0:
            raise LumitreeError(message)
        warnings.warn(message, LumitreeWarning, stacklevel=3)
    # One batch has no error.
    spread = lumens.std(ddof=1) if len(lumens) > 1 else np.inf
    noise = spread / len(lumens) ** 0.5 / emitted, share * bare.std() / len(bare) ** 0.5 / emitted
    error = float(np.hypot(*noise))
    if share - 1 > max(_CERTAIN * error, _CREATED):
        warnings.warn(
            f"{100 * share:.4g} ± {100 * error:.2g} % of the light of the emitters leaves "
            f"{luminaire.name}: {_creating(luminaire, seed)}",
            LumitreeWarning,
            stacklevel=3,
        )


def lost_light(luminaire: Luminaire, seed: int) -> NDArray[np.float64]:
    """Part of the emitted luminous flux that is lost at each shape of a luminaire's scene.

    From a few thousand light paths. Light that a medium absorbs is lost at the shape where the
    segment ends. Less than 0 where a material creates light.
    """
    scene, context = luminaire.scene, mi.BSDFContext(mi.TransportMode.Importance)
    sampler = seeded_sampler(SeedStream(Purpose.FLUX, draw=2).seed(seed), _PATHS)
    ids = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
    lost = dr.zeros(mi.Float, int(ids.max()) + 1)
    extent = scene_extent(scene)
    ray, flux, _ = emit(luminaire.emitting_surfaces, sampler, extent)
    total = dr.sum(mi.luminance(flux))
    medium, active = dr.zeros(mi.MediumPtr), mi.Bool(True)
    for depth in range(PATH_DEPTH):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid() & (dr.max(flux) > 0)
        if not dr.any(active):
            break
        sample, weight = si.bsdf().sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        scattering, extinction = coefficients(medium, active)
        left = flux * weight * dr.exp(-(extinction - scattering) * dr.select(active, si.t, 0))
        left = dr.select(depth < PATH_DEPTH - 1, left, 0)
        shape = dr.select(si.instance != None, si.instance, si.shape)  # noqa: E711
        index = dr.reinterpret_array(mi.UInt32, shape)
        dr.scatter_add(lost, mi.luminance(flux - left), index, active)
        towards = si.to_world(sample.wo)
        medium = medium_after(si, towards, medium, active)
        ray, flux = spawn(si, towards, extent), mi.Color3f(left)
        dr.eval(ray, flux, medium, active, lost)
    return np.array(lost, np.float64)[ids] / float(total[0])


def _enclosing(luminaire: Luminaire, seed: int) -> str:
    """The shapes that enclose the emitters, and the way to mend it."""
    lost = lost_light(luminaire, seed)
    emits = np.array([shape.is_emitter() for shape in luminaire.scene.shapes()])
    if (lost[~emits] > 0).any():
        # The surfaces of emitters are often black, and get light back from what encloses them.
        lost = np.where(emits, 0.0, lost)
    shapes = _largest(luminaire, lost)
    names = " and ".join(_described(shape) for shape in shapes)
    if shapes[0].number is not None or not shapes[0].materials:
        return f"it ends on {names}; leave an opening, or give it a BSDF that transmits light"
    toml, line = Path(luminaire.name).name, setting(shapes[0].materials[0], "glass = {}")
    return (
        f"it ends on {names}; if this is glass, which Blender writes into OBJ files as opaque "
        f"(d 1), put first into {shown(toml, 100)}.toml: {line}"
    )


def _creating(luminaire: Luminaire, seed: int) -> str:
    shapes = _largest(luminaire, -lost_light(luminaire, seed))
    names = " and ".join(_described(shape) for shape in shapes)
    return f"the material of {names} creates light; its reflectance and transmittance exceed 1"


def _largest(luminaire: Luminaire, parts: NDArray[np.float64]) -> list[SceneShape]:
    """The shapes with the largest parts."""
    shapes = shapes_of_scene(luminaire.scene, luminaire.shapes)
    order = np.argsort(-parts, kind="stable")[:_NAMED]
    return [shapes[at] for at in order if parts[at] >= _COMPARABLE * parts[order[0]]]


def _described(shape: SceneShape) -> str:
    material = [shown(repr(each), 60) for each in shape.materials[:1]]
    surface = " ".join([shape.bsdf, *material]) or "no BSDF"
    return f"{shape.label} ({surface})"
