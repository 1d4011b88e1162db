"""Methods of Table 5: their images, and the time of each at equal `rmse_display`."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.equal_error.batches import LongRun, code_digest, digest, ladder
from benchmarks.equal_error.errors import display_rows, noise_of_mean, time_to_reach
from benchmarks.equal_error.pairs import Pair
from benchmarks.paper_tables.scales import EqualQuality
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import write_json

if TYPE_CHECKING:
    from lumitree.rendering.emitter import Sampling


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
    """One way to render a pair: its long run and its ladder, and how to extend both.

    Args:
        baked: whether the asset is rendered, and not the luminaire.
        size: of the images, and the longest path.
        cache: folder of the images.
        way: of a baked lamp.
    """

    def __init__(
        self, pair: Pair, baked: bool, size: EqualQuality, cache: Path, way: Way | None = None
    ) -> None:
        from lumitree.lamp.luminaire import load_luminaire
        from lumitree.lamp.scene_file import SceneFile
        from lumitree.rendering.passes import Budget, render_passes
        from lumitree.rendering.placement import Placement
        from lumitree.rendering.scene import (
            PlacedLuminaire,
            load_scene,
            place_luminaires,
            set_film_width,
        )

        room, _ = load_scene(pair.room)
        set_film_width(room, size.width)
        source = pair.asset if baked else pair.luminaire
        way = Way() if way is None else way
        lamp = PlacedLuminaire(Placement(source, at=pair.at, size=pair.size))
        scene = place_luminaires(room, [lamp], sampling=way.sampling, appearance="geometry")
        set_thresholds(scene, way)
        mi = load_mitsuba()
        # Not `path` or `volpath`, which start rays so far from surfaces that thin glass emits too
        # much (docs/decisions/media.md), and find no light through thin glass and alpha masks by
        # next-event estimation.
        kind = "lumitree_path"
        key = {
            "room": digest(Path(pair.room), *SceneFile(pair.room).references()),
            "lamp": digest(Path(source)) if baked else load_luminaire(source).fingerprint,
            "way": dataclasses.asdict(way) if baked else None,
            "at": pair.at,
            "size": pair.size,
            "integrator": kind,
            "path_depth": size.path_depth,
            "width": size.width,
            "mitsuba": mi.__version__,
            "code": code_digest(),
        }
        self.folder = cache / f"{pair.name}-{digest(key)}"
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self.folder / "key.json", {"source": source, **key})
        pixels = int(np.prod(room.sensors()[0].film().size()))
        self.long = LongRun(self.folder / "long.npz", self.folder.name, first_samples(pixels))
        self.rungs: list[dict] = []

        def render_pair(samples: int, seed: int) -> Any:
            integrator = mi.load_dict({"type": kind, "max_depth": size.path_depth})
            return render_passes(
                scene, integrator, Budget(samples), seed=seed, name=f"{pair.name}, {kind}"
            ).radiance

        self.render, self.scene = render_pair, scene

    def spend(self, long_seconds: float, ladder_seconds: float) -> None:
        """Climb the ladder and extend the long run for so many seconds by the wall."""
        self.rungs = ladder(self.folder, self.render, ladder_seconds)
        self.long.extend(self.render, long_seconds)


def set_thresholds(scene: Any, way: Way) -> None:
    """Give the lamps of a scene fields with the thresholds of `way`; exact fields stay."""
    if (way.min_density, way.max_opacity) == (0.0, 1.0):
        return
    from lumitree.octree.field import Field
    from lumitree.rendering.emitter import lamp_of

    for emitter in scene.emitters():
        lamp = lamp_of(emitter)
        if lamp is not None:
            lamp.field = Field(lamp.asset, way.min_density, way.max_opacity)
            emitter.get_shape().bsdf().placed.field = lamp.field


def first_samples(pixels: int) -> int:
    """Samples a pixel with which a long run begins: enough to hide the fixed cost of a pass."""
    return max(4, min(64, (1 << 18) // pixels))


def pace(method: Method) -> float:
    """CPU seconds of a sample a pixel, from the long run."""
    return method.long.seconds["cpu"] / method.long.spp


def _paced(method: Method) -> list[dict[str, Any]]:
    """Rungs whose time is the time of their samples in the long run.

    The fixed cost of a small image, about a second, is more than the cost of its first samples. It
    does not grow with the size of an image.
    """
    own = pace(method)
    return [
        {**rung, "seconds": {"cpu": np.array([rung["samples"] * own])}} for rung in method.rungs
    ]


def readings(
    methods: dict[str, Method], levels: tuple[float, ...], weights: Any, reference: str
) -> dict[str, Any]:
    """For each method its bias, and its CPU seconds and samples at each level.

    A level below `floor`, or below the bias of a method, has none.

    Args:
        levels: of `rmse_display`.
        weights: [H, W, 1] of squared errors, of mean 1.
        reference: name of the method whose long run is the reference.

    Returns:
        `levels`; `reference`, its own error; `floor`, twice that: below it, an error is not known
        well enough, since a noisy reference is darker, encoded, than its mean; and `methods`, by
        name. With another reference than the explicit lamp, the explicit lamp's time is the time of
        its long run where this has not reached a level, and `at_least` is true.
    """
    runs = {
        name: (_paced(method), method.long.batches, method.long.seconds["cpu"])
        for name, method in methods.items()
    }
    rows, own = display_rows(runs, "cpu", weights, reference)
    floor = 2 * own
    found: dict[str, Any] = {"reference": own, "floor": floor, "levels": list(levels)}
    found["methods"] = {}
    for name, method in methods.items():
        noise = noise_of_mean(method.long.batches, weights)
        last, spent = rows[name][-1]["rmse"], method.long.seconds["cpu"]
        unbiased = name in ("explicit", reference)
        bias = 0.0 if unbiased else float(np.sqrt(max(last**2 - noise**2, 0.0)))
        beyond = [name == "explicit" != reference and level < last for level in levels]
        times = [
            spent if short else seconds_at(level, rows[name], bias, floor, spent, noise)
            for level, short in zip(levels, beyond, strict=True)
        ]
        own_pace = pace(method)
        found["methods"][name] = {
            "bias": bias,
            "seconds": times,
            "samples": [None if time is None else time / own_pace for time in times],
            "at_least": beyond,
            "points": rows[name],
        }
    return found


def seconds_at(
    level: float,
    points: list[dict[str, float]],
    bias: float,
    floor: float,
    long_seconds: float,
    noise: float,
) -> float | None:
    """CPU seconds for an error of `level`; None where it is below `floor` or `bias`.

    Between measured points by interpolation. Beyond the last one the squared error is the squared
    bias, plus a noise that falls as 1 / time.
    """
    if level <= max(bias, floor):
        return None
    ordered = sorted(points, key=lambda point: point["seconds"])
    seconds = np.array([point["seconds"] for point in ordered])
    errors = np.array([max(point["rmse"], 1e-9) for point in ordered])
    found, kind = time_to_reach(level, seconds, errors)
    if kind == "measured":
        return found
    return long_seconds * noise**2 / (level**2 - bias**2)


def speedup_of(methods: dict[str, Any], name: str, level: int) -> float | None:
    """Seconds of the explicit lamp over seconds of a method; None where either has none."""
    explicit, own = methods["explicit"]["seconds"][level], methods[name]["seconds"][level]
    return None if explicit is None or own is None else explicit / own
