"""The Mitsuba plugins, and `lumitree.shape`, which makes use of them.

Emitter `lumitree`, BSDF `lumitree_null`, shape `lumitree_proxy` and integrator `lumitree_path`. The
first three take the same properties:

    filename      the asset, or a photometric file or ray file
    to_world      where the luminaire goes, relative to its own file's frame (default: there)
    sampling      "emission" (default), or "uniform" over the proxy
    gain          factor on the emitted light, a number or R, G, B; default 1. The BSDF ignores it
    appearance    "geometry": images show the luminaire itself, for the integrator `lumitree_path`;
                  or "field". Default of `lumitree_proxy`: "geometry" if the asset has it. The
                  emitter and the BSDF alone show the field

`lumitree_proxy` is the proxy, a `lumitree_box`, with the emitter and the BSDF attached, for scene
files. With the appearance "geometry" it is several shapes: the proxy and the
luminaire's.
L_o = gain · L_e + T · L_i (Eq. 2): the emitter returns gain · L_e, the BSDF T. The gain and the
pose are differentiable parameters of `mitsuba.traverse`, `<name of the shape>.emitter.gain` and
`.to_world`; docs/how-to/fit-a-lamp.md states what their derivatives ignore.
"""

import os
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError

if TYPE_CHECKING:
    from lumitree.asset.asset import Asset
    from lumitree.rendering.emitter import Appearance, Sampling

_registered: set[str] = set()
_TOO_MANY = (
    "Mitsuba loads this scene in parallel, and creates more lamps with the appearance 'geometry' "
    "within each other than Python's limit of recursion allows; load it with parallel=False"
)


def register() -> None:
    """Register the plugins with the variant of Mitsuba that is set; harmless when repeated.

    Raises:
        LumitreeError: Mitsuba runs on an unusable libLLVM, or its variant is not RGB.
    """
    mi = load_mitsuba()
    if mi.variant() in _registered:
        return
    # Their classes extend Mitsuba's, which a variant has to be set for.
    from lumitree.lamp import metallic_roughness
    from lumitree.rendering import emitter, integrator, null_bsdf, shapes

    mi.register_emitter("lumitree", emitter.emitter_class())
    mi.register_bsdf("lumitree_null", null_bsdf.null_bsdf_class())
    mi.register_shape("lumitree_box", shapes.box_class())
    mi.register_integrator("lumitree_path", integrator.integrator_class())
    metallic_roughness.register()

    def make_proxy(props):
        try:
            return shapes.make_shapes(props.id(), **emitter.plugin_options(props))
        except (RecursionError, RuntimeError) as error:
            # Mitsuba turns exceptions of the plugins within this one into a RuntimeError.
            if not isinstance(error, RecursionError) and "RecursionError" not in str(error):
                raise
            raise LumitreeError(_TOO_MANY) from None

    mi.register_shape("lumitree_proxy", make_proxy)
    _registered.add(mi.variant())


def shape(
    asset: "Asset | str | os.PathLike[str]",
    to_world: ArrayLike | Any | None = None,
    sampling: "Sampling" = "emission",
    gain: ArrayLike | Any = 1.0,
    appearance: "Appearance | None" = None,
) -> dict[str, Any]:
    """A baked luminaire as a shape dictionary for `mitsuba.load_dict`.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file.
        to_world: [4, 4] matrix or Mitsuba transform that moves the luminaire from its own
            file's frame into the scene; rotation, translation and uniform scale. Default: stay. A
            scale changes neither intensities nor flux of a photometric file, for a scene in metres;
            other lamps keep their radiance. In a scene of another unit a photometric file needs a
            `gain` of one over the square of the metres in that unit.
        sampling: of directions: "emission", about in proportion to it, or "uniform" over the proxy.
        gain: [3] factors on the R, G and B of the emitted light, or one number for all; 0 to 10⁶.
        appearance: shown in images. "geometry": the luminaire itself, if the asset has it; for the
            integrator `lumitree_path`: other integrators also get its light, but show a dark
            lamp behind its light field. "field": the radiance field, or else the light field.
            Default: the geometry if the asset has it, as `render` shows it.

    Returns:
        The proxy shape with the emitter `lumitree` and the BSDF `lumitree_null` attached; and with
        the shapes of the luminaire, if images show it.

    Raises:
        LumitreeError: the asset cannot be read; `to_world` shears or scales non-uniformly; or the
            gain is out of range.
    """
    register()
    from lumitree.rendering.shapes import describe_proxy

    return describe_proxy(asset, to_world, sampling, gain, appearance)
