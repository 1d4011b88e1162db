"""The first evaluation of a scene's BSDFs and emitters, by which Mitsuba's exceptions are found.

Some plugins accept when they are created what they cannot evaluate: a bump map of a procedural
texture, a curve that emits, or an image with pixels that are not numbers. Nothing is compiled here:
the functions of the plugins run, and what they compute is dropped.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError, LumitreeWarning, renderer_reason, shown
from lumitree.lamp.scene_shapes import SceneShape, shapes_of_scene


def check_evaluates(
    scene: Any, shapes: Sequence[SceneShape], where: str, *, rays: bool = True
) -> None:
    """Refuse a scene with a BSDF or an emitter that Mitsuba cannot evaluate to numbers.

    Warns of mesh attributes that a shape lacks.

    Args:
        scene: mi.Scene.
        shapes: of the file that the scene was made from.
        where: name of the scene, for messages.
        rays: whether rays are also sampled from emitters, as for light paths.

    Raises:
        LumitreeError: the message names the shape, the plugin, and Mitsuba's reason.
    """
    tried: dict[int, Any] = {}
    described = shapes_of_scene(scene, shapes)
    for shape, names in zip(scene.shapes(), described, strict=True):
        bsdf, emitter = shape.bsdf(), shape.emitter()
        if bsdf is not None and id(bsdf) not in tried:
            what = f"the BSDF of shape {names.label}, {names.bsdf or bsdf.class_name()},"
            _check_finite(bsdf, f"{where}: {what}")
            _try(_bsdf_calls(bsdf, shape), f"{where}: {what}")
            # Kept: another object could get the number of one that is freed.
            tried[id(bsdf)] = bsdf
        if emitter is not None:
            what = f"the emitter of shape {names.label}, {names.emitter or emitter.class_name()},"
            _check_finite(emitter, f"{where}: {what}")
            _try(_emitter_calls(emitter, shape, rays), f"{where}: {what}")
        for name in names.attributes:
            if not all(shape.has_attribute(name)):
                warnings.warn(
                    f"{where}: shape {names.label} has no attribute {shown(name, 60)!r}, which its "
                    "BSDF or emitter uses; it is 0 there",
                    LumitreeWarning,
                    stacklevel=3,
                )
    for emitter in scene.emitters():
        if emitter.get_shape() is None:
            what = f"{where}: the emitter {emitter.id() or emitter.class_name()}"
            _check_finite(emitter, what)
            _try(_emitter_calls(emitter, None, False), what)


def _check_finite(plugin: Any, what: str) -> None:
    """Refuse a plugin with pixels or colours that are not finite."""
    params = load_mitsuba().traverse(plugin)
    for key in params.keys():  # noqa: SIM118, it is no dictionary
        # Others may have no value that could be read.
        if key.rpartition(".")[2] not in ("data", "value"):
            continue
        values = np.asarray(params[key])
        wrong = values.size - np.count_nonzero(np.isfinite(values))
        if wrong:
            raise LumitreeError(
                f"{what} has {wrong:,} of {values.size:,} values in {shown(repr(key), 100)} that "
                "are not finite numbers, nor would images be: replace the image or the colour"
            )


def _try(calls: Iterator[Callable[[], Any]], what: str) -> None:
    for call in calls:
        try:
            call()
        except RuntimeError as error:
            reason = renderer_reason(error)
            if reason is None:
                raise
            raise LumitreeError(
                f"{what} cannot be evaluated by Mitsuba in {load_mitsuba().variant()}: "
                f"{shown(reason, 300)}; replace it, or its texture or shape; images and colours as "
                "textures, and meshes and spheres as shapes can be evaluated"
            ) from error


def _bsdf_calls(bsdf: Any, shape: Any) -> Iterator[Callable[[], Any]]:
    mi = load_mitsuba()
    context, out = mi.BSDFContext(), mi.Vector3f(0, 0, 1)
    si = _point(shape)
    yield lambda: bsdf.eval(context, si, out)
    yield lambda: bsdf.pdf(context, si, out)
    yield lambda: bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5))
    yield lambda: bsdf.eval_null_transmission(si)


def _emitter_calls(emitter: Any, shape: Any | None, rays: bool) -> Iterator[Callable[[], Any]]:
    # Not at the top: Dr.Jit looks for its library when it is imported.
    import drjit as dr

    mi = load_mitsuba()
    si, seen_from = _point(shape), dr.zeros(mi.Interaction3f)
    seen_from.p = mi.Point3f(1, 2, 3)
    half = mi.Point2f(0.5)
    yield lambda: emitter.eval(si)
    yield lambda: emitter.sample_direction(seen_from, half)
    yield lambda: emitter.pdf_direction(seen_from, dr.zeros(mi.DirectionSample3f))
    if rays:
        yield lambda: emitter.sample_ray(0, mi.Float(0.5), half, half)


def _point(shape: Any | None) -> Any:
    """A mi.SurfaceInteraction3f that is seen from the front."""
    import drjit as dr

    mi = load_mitsuba()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    if shape is not None:
        si.shape = mi.ShapePtr(shape)
    return si
