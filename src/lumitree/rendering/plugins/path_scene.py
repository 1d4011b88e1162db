"""State that all paths of an image share."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from lumitree.lamp.media import absorption
from lumitree.rendering.layers import Unrecorded
from lumitree.rendering.plugins.emitter_selection import EmitterSelection
from lumitree.rendering.plugins.geometry_plugins import GeometryEmitter
from lumitree.rendering.plugins.lamp_kinds import LampKinds
from lumitree.rendering.plugins.proxies import Divided, is_instance
from lumitree.rendering.sampling.lamp_choice import LampChoices
from lumitree.trace.spawning import scene_extent


class PathScene:
    """A scene as `lumitree_path` renders it. No PyTree: loops do not have it in their state.

    Args:
        scene: as it was loaded.
        divided: the same, as `DividedScene` divides it.
        media: those that rays may cross.
        hide_emitters: whether the camera does not see emitters.
        layers: what is recorded beside the image.
        choices: keeps tables for the choice of a lamp.
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
    ) -> None:
        self.whole = scene
        self.divided = divided
        self.hide_emitters = hide_emitters
        self.layers = Unrecorded() if layers is None else layers
        self.extent = scene_extent(scene)
        self.bsdf_ctx = mi.BSDFContext()
        # These select the code of a kernel: a scene does not pay for what it does not have.
        self.has_null_surfaces = _has_null_surfaces(divided.surfaces)
        self.has_media = bool(media)
        self.has_scattering = any(absorption(medium) is None for medium in media)
        self.shows_geometry = any(
            isinstance(emitter, GeometryEmitter) for emitter in scene.emitters()
        )
        self.selection = EmitterSelection(scene, LampChoices() if choices is None else choices)
        self.lamps = LampKinds(scene.emitters(), scene.emitters_dr())

    def emitter(self, index: mi.UInt32, active: mi.Bool) -> mi.EmitterPtr:
        """The emitter of an index in the scene."""
        return dr.gather(mi.EmitterPtr, self.whole.emitters_dr(), index, active)


def _has_null_surfaces(scene: mi.Scene) -> bool:
    """Whether light may pass some shape of the scene without being bent."""
    for shape in scene.shapes():
        if is_instance(shape) or mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null):
            return True
    return False
