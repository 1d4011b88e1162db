"""The two ways to render a pair, with the explicit lamp and with the baked one."""

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import lumitree
from benchmarks.equal_error.batches import LongRun, digest, ladder, remember
from benchmarks.equal_error.error_against_time import Floats, Pace, noise
from benchmarks.equal_error.pairs import Pair
from lumitree.core.backend import load_mitsuba

if TYPE_CHECKING:
    from lumitree.rendering.sampling.emitter_sampling import Sampling

# What a picture of the baked lamp depends on, besides its asset and the room.
_SOURCES = ("rendering", "octree", "asset", "core")


@dataclasses.dataclass(frozen=True)
class Way:
    """How the baked lamp is rendered: `sampling` as for `place_luminaires`, and thresholds.

    The thresholds are the arguments of `lumitree.octree.field.Field`. Images show the geometry of a
    lamp, if its asset has one.
    """

    sampling: "Sampling" = "emission"
    min_density: float = 0.0
    max_opacity: float = 1.0


class Method:
    """One way to render the pair: its long run and its ladder, and how to extend both."""

    def __init__(
        self, pair: Pair, baked: bool, options: argparse.Namespace, way: Way | None = None
    ) -> None:
        from lumitree.lamp.loading import load_luminaire
        from lumitree.lamp.scene_file import SceneFile
        from lumitree.rendering.passes import Budget, render_passes
        from lumitree.rendering.placement import Placement
        from lumitree.rendering.plugins.placed import shows_geometry
        from lumitree.rendering.scene import (
            PlacedLuminaire,
            load_scene,
            place_luminaires,
            set_film_width,
        )

        room, _ = load_scene(pair.room)
        set_film_width(room, options.width)
        source = pair.asset if baked else pair.luminaire
        way = Way() if way is None else way
        lamp = PlacedLuminaire(Placement(source, at=pair.at, size=pair.size))
        scene = place_luminaires(room, [lamp], sampling=way.sampling, appearance="geometry")
        set_thresholds(scene, way)
        # Whether it converges to the explicit lamp's image, but for the illumination's error.
        self.converges = lamp.field is None or shows_geometry(lamp.field.asset, "geometry")
        mi = load_mitsuba()
        # Not `path` or `volpath`, which start rays so far from surfaces that thin glass emits too
        # much (docs/decisions/media.md), and find no light through thin glass and alpha masks by
        # next-event estimation.
        self.kind = "lumitree_path" if baked else options.explicit
        key = {
            "room": digest(Path(pair.room), *SceneFile(pair.room).references()),
            "lamp": digest(Path(source)) if baked else load_luminaire(source).fingerprint,
            "way": dataclasses.asdict(way) if baked else None,
            "at": pair.at,
            "size": pair.size,
            "integrator": self.kind,
            "path_depth": options.path_depth,
            "width": options.width,
            "mitsuba": mi.__version__,
            "code": code_digest() if baked or self.kind == "lumitree_path" else "",
        }
        self.folder = Path(options.cache) / f"{pair.name}-{digest(key)}"
        self.folder.mkdir(parents=True, exist_ok=True)
        remember(self.folder, {"source": source, **key})
        pixels = int(np.prod(room.sensors()[0].film().size()))
        self.long = LongRun(self.folder / "long.npz", self.folder.name, first_samples(pixels))
        self.rungs: list[dict] = []

        def render_pair(samples: int, seed: int) -> Any:
            integrator = mi.load_dict({"type": self.kind, "max_depth": options.path_depth})
            return render_passes(
                scene, integrator, Budget(samples), seed=seed, name=f"{pair.name}, {self.kind}"
            ).radiance

        self.render, self.scene = render_pair, scene

    def spend(self, long_seconds: float, ladder_seconds: float) -> None:
        """Climb the ladder and extend the long run for so many seconds by the wall."""
        self.rungs = ladder(self.folder, self.render, ladder_seconds)
        self.long.extend(self.render, long_seconds)

    def variance(self) -> Floats:
        """Variance [H, W, 3] of a sample, from the long run."""
        return self.long.batches.var(0, ddof=1) * self.long.samples

    def pace(self, seconds: float, bias: float, weights: Any) -> Pace:
        """With the variance of the long run."""
        variance = noise(self.long.batches, weights) * self.long.samples_per_pixel
        return Pace(variance, seconds, bias)


def set_thresholds(scene: Any, way: Way) -> None:
    """Give the lamps of a scene fields with the thresholds of `way`; exact fields stay."""
    if (way.min_density, way.max_opacity) == (0.0, 1.0):
        return
    from lumitree.octree.field import Field
    from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter

    lamps: list[Any] = [each for each in scene.emitters() if isinstance(each, DeferredEmitter)]
    for lamp in lamps:
        field = Field(lamp.placed.asset, way.min_density, way.max_opacity)
        lamp.placed.field = lamp.get_shape().bsdf().placed.field = field
        # The sampler was made of the exact field.
        del lamp.sampler


def first_samples(pixels: int) -> int:
    """Samples a pixel with which a long run begins: enough to hide the fixed cost of a pass."""
    return max(4, min(64, (1 << 18) // pixels))


def code_digest() -> str:
    """Hash of the package's code that renders a baked lamp."""
    package = Path(lumitree.__file__).parent
    return digest(*sorted(file for part in _SOURCES for file in (package / part).rglob("*.py")))
