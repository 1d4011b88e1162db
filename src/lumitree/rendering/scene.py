"""Scenes with luminaires placed in them, their integrators, and where their cameras look."""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import MAX_PIXELS_A_SIDE, check_gain
from lumitree.core.frames import float32_step, is_far, similarity, similarity_scale
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.luminaire import Luminaire, LuminaireLike, load_luminaire
from lumitree.lamp.media import any_heterogeneous
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_shapes import SceneShape, reusable_shapes, shapes_of_scene
from lumitree.lamp.source import LuminaireSource
from lumitree.rendering.asset_cache import asset_of
from lumitree.rendering.asset_flux import asset_watts, factors_to
from lumitree.rendering.emitter import Appearance, Sampling, lamp_of, shows_geometry
from lumitree.rendering.layers import records_layers
from lumitree.rendering.objects import load_ordered
from lumitree.rendering.placement import Placement
from lumitree.rendering.placement_checks import contains_objects, warn_of_overlaps
from lumitree.rendering.register import register, shape

# `volpath` starts rays (1 + largest coordinate) * RayEpsilon from surfaces. Where that is this part
# of a lamp's size, the irradiance 0.7 sizes below it is 1 % too high; at 3 times this part, 4 %.
_FAR_FOR_VOLPATH = 0.09
# Classes of `volpath` and `volpathmis`, which take the transmittance of null surfaces for shadow
# rays, and render media.
_SEE_MEDIA = ("VolumetricPathIntegrator", "VolpathMisIntegratorImpl")
# These become `lumitree_path`, or `volpath` where media are heterogeneous.
_PATH_TRACERS = ("path", "lumitree_path")
_DEFAULT_PATH_DEPTH = 16
# Path of a scene file, dictionary as for `mitsuba.load_dict`, or scene.
SceneSource: TypeAlias = "str | os.PathLike[str] | Mapping[str, Any] | mi.Scene"


class PlacedLuminaire:
    """A luminaire that has been read, and where it goes.

    Args:
        placement: what to read, and where it goes.
        source: what the placement names, if it is loaded already.
        metres: in a unit of length of the scene.
    """

    def __init__(
        self, placement: Placement, source: Luminaire | Asset | None = None, metres: float = 1
    ) -> None:
        self.placement = placement
        self.asset: Asset | None = None
        self.luminaire: Luminaire | None = None
        source = _loaded(placement, metres) if source is None else source
        if isinstance(source, Asset):
            self.asset = source
        else:
            self.luminaire = source
        self.source, frame = source, source.frame
        scene_from_local = frame.placed(
            at=placement.at, size=placement.size, rotate=placement.rotate
        )
        # `scene_from_world` [4, 4] from the frame of the luminaire's file; `scene_from_box` [4, 4]
        # maps [-1, 1]³ to the bounding box.
        self.scene_from_world = scene_from_local @ frame.local_from_world
        self.scene_from_box = scene_from_local @ np.diag([*frame.half_extents, 1])
        self._metres = metres
        # Factors [3] on its light, for its `gain`, `lumens` and `temperature`.
        self.gain = (1.0, 1.0, 1.0)
        gain, wanted = check_gain(placement.gain), (placement.lumens, placement.temperature)
        if self.asset is not None and wanted != (None, None):
            gain = check_gain(factors_to(self.watts, *wanted, placement.name) * gain)
        self.gain = gain

    @property
    def watts(self) -> NDArray[np.float64]:
        """Flux [3] of R, G and B of a baked lamp in the scene, W."""
        assert self.asset is not None
        scale = similarity_scale(self.scene_from_world, "placement")
        grown = 1.0 if self.asset.is_photometric else scale
        return asset_watts(self.asset) * (grown * self._metres) ** 2 * self.gain

    @property
    def title(self) -> str:
        """Its name in messages: its label, if it has one."""
        label = self.placement.label
        return self.placement.name if label is None else shown(label, 200)

    @property
    def kind(self) -> object:
        """The lamp that is placed; equal for instances of one lamp."""
        return self.placement.name if self.asset is None else self.asset

    def is_shown_by_field(self, appearance: Appearance) -> bool:
        """Whether images show its radiance field."""
        return self.asset is not None and not shows_geometry(self.asset, appearance)

    def moved(self, emitter: mi.Emitter, placement: Placement) -> PlacedLuminaire:
        """The same asset at another placement, where its emitter and its shapes go, too."""
        found = PlacedLuminaire(placement, self.source, self._metres)
        lamp = lamp_of(emitter)
        assert lamp is not None
        lamp.gain = mi.Color3f(*found.gain)
        lamp.to_world = mi.Transform4f(found.scene_from_world)
        emitter.parameters_changed()
        return found

    def shapes(self, sampling: Sampling, appearance: Appearance) -> dict[str, object]:
        """Shapes for `mitsuba.load_dict`; arguments as for `place_luminaires`."""
        if self.luminaire is not None:
            return place_shapes(self.luminaire, self.scene_from_world)
        assert self.asset is not None
        return {"proxy": shape(self.asset, self.scene_from_world, sampling, self.gain, appearance)}


def _loaded(placement: Placement, metres: float) -> Luminaire | Asset:
    """The lamp of a placement; a photometric file, which is in metres, in the scene's unit."""
    asset = asset_of(placement.source)
    if asset is None:
        return load_luminaire(placement.source)
    return asset.scaled(1 / metres) if asset.is_photometric and metres != 1 else asset


def place_shapes(luminaire: LuminaireLike, scene_from_world: ArrayLike) -> dict[str, object]:
    """Shapes of an explicit luminaire placed in a scene, for `mitsuba.load_dict`.

    Args:
        luminaire: as for `load_luminaire`, but no `mi.Scene`.
        scene_from_world: [4, 4] similarity from the frame of the luminaire's file. The
            extinction of interior media is divided by its scale, so that the appearance of the
            luminaire does not depend on its size.
    """
    luminaire, matrix = load_luminaire(luminaire), np.asarray(scene_from_world, np.float64)
    scale = similarity_scale(matrix, "placement")
    if luminaire.origin.any():
        matrix = matrix @ similarity(np.eye(3), 1.0, luminaire.origin)
    file = luminaire.parsed.moved(matrix)
    for node in file.nodes("Medium"):
        node.props["scale"] = node.props.get("scale", 1.0) / scale
    shapes = reusable_shapes(file.instantiate())
    return {f"luminaire_{i}": shape for i, shape in enumerate(shapes)}


def open_placements(placements: Sequence[Placement], metres: float = 1) -> list[PlacedLuminaire]:
    """Read the luminaires of placements, each once; `metres` as for `PlacedLuminaire`."""
    loaded: dict[object, Luminaire | Asset] = {}
    opened = []
    for placement in placements:
        source = placement.source
        # A dictionary has no hash.
        key = source if isinstance(source, str | os.PathLike | LuminaireSource) else id(source)
        placed = PlacedLuminaire(placement, loaded.get(key), metres)
        loaded.setdefault(key, placed.source)
        opened.append(placed)
    return opened


def place_luminaires(
    scene: mi.Scene,
    luminaires: Sequence[PlacedLuminaire],
    sampling: Sampling = "emission",
    appearance: Appearance = "field",
) -> mi.Scene:
    """Scene with the objects of another one and the placed luminaires.

    The appearance "geometry" is for `lumitree_path` only (`appearance_for`).

    Warns on standard error of objects in the box of a luminaire that does not light them there.
    """
    register()
    objects: dict[str, object] = {"type": "scene"}
    objects |= {f"room_{i}": item for i, item in enumerate(reusable_shapes(scene))}
    objects |= {f"sensor_{i}": item for i, item in enumerate(scene.sensors())}
    if scene.environment() is not None:
        objects["environment"] = scene.environment()
    distant = [e for e in scene.emitters() if e.get_shape() is None and not e.is_environment()]
    objects |= {f"emitter_{i}": item for i, item in enumerate(distant)}
    ids = [(item, item.id()) for item in objects.values() if isinstance(item, mi.Object)]
    taken: set[tuple[str, bytes]] = set()
    for placed in luminaires:
        place = (placed.placement.name, placed.scene_from_box.tobytes())
        if place in taken:
            raise LumitreeError(
                f"{place[0]} is placed twice in the same place; give each its own --at"
            )
        taken.add(place)
    _warn_rounded(luminaires)
    causes = {}
    for placed in luminaires:
        if placed.asset is not None and placed.asset.light_field is None:
            causes[placed] = "the asset has no light field; bake it again"
        elif placed.asset is not None and sampling == "uniform":
            causes[placed] = 'use the sampling "emission"'
    _warn_unlit(scene, causes)
    if luminaires:
        warn_of_overlaps(
            np.stack([placed.scene_from_box for placed in luminaires]),
            [placed.title for placed in luminaires],
            [placed.kind for placed in luminaires],
            [placed.is_shown_by_field(appearance) for placed in luminaires],
        )
    for start, placed in zip(placed_ids(luminaires), luminaires, strict=True):
        shapes = placed.shapes(sampling, appearance)
        objects |= {start + name: value for name, value in shapes.items()}
    loaded = load_ordered(objects)
    # The names in the dictionary became the ids.
    for item, name in ids:
        item.set_id(name)
    return loaded


def placed_ids(luminaires: Sequence[PlacedLuminaire]) -> list[str]:
    """For each placed luminaire, what the ids of its shapes in `place_luminaires` begin with."""
    return [f"placed_{index}_" for index in range(len(luminaires))]


def load_scene(
    source: SceneSource,
    luminaires: Sequence[PlacedLuminaire] = (),
    *,
    box_filter: bool = False,
    width: int | None = None,
) -> tuple[mi.Scene, mi.Integrator]:
    """Scene and integrator of a scene; the integrator sees through null surfaces.

    A `path` integrator becomes `lumitree_path` with the same settings, or `volpath` where the scene
    has heterogeneous media. Any other that would let proxies block the light of other lamps is
    replaced too, which is said on standard error; so is a baked luminaire too small, or too far
    from the origin, for `volpath`.

    Args:
        source: path of a scene file, dictionary as for `mitsuba.load_dict`, or `mitsuba.Scene`.
        luminaires: that will be placed in the scene.
        box_filter: whether each pixel is the mean of its own samples, whatever filter the scene
            names.
        width: of the film, pixels; its proportions stay. Default: the scene's.

    Raises:
        LumitreeError: the scene cannot be loaded or has no camera, or its film is created already
            and cannot be changed, or stores no R, G and B.
    """
    title = scene_title(source)
    scene, described, _ = _open(source, title, box_filter=box_filter)
    sensors = scene.sensors()
    if not sensors:
        raise LumitreeError(f"{title} has no sensor; add a camera to the scene")
    _check_size(sensors[0].film(), title)
    if box_filter and sensors[0].film().rfilter().class_name() != "BoxFilter":
        raise LumitreeError(
            f"{title} has a film that is created already; denoise needs one with the "
            "reconstruction filter 'box': create it so, or describe the sensor by a dictionary"
        )
    if width is not None:
        if any(sensors[0].film() is each for each in _created_films(source)):
            raise LumitreeError(
                f"{title} has a film that is created already, and keeps its width: create it with "
                "another, or describe the sensor by a dictionary"
            )
        set_film_width(scene, width)
        _check_size(sensors[0].film(), title)
    _check_rgb(sensors[0].film(), title)
    heterogeneous = any_heterogeneous(scene)
    integrator = integrator_for(scene, described, title, heterogeneous=heterogeneous)
    if not records_layers(integrator):
        baked = [item for item in luminaires if item.placement.is_baked]
        for item in baked:
            _warn_far(item)
        _warn_unlit(scene, dict.fromkeys(baked, "volpath does not light it; lumitree_path does"))
    return scene, integrator


def integrator_for(
    scene: mi.Scene, described: mi.Properties | None, title: str, *, heterogeneous: bool
) -> mi.Integrator:
    """The integrator of a scene, or its replacement, which sees through null surfaces.

    `described` is None where the scene has none, or one whose settings cannot be read.
    """
    tracer, given = _path_tracer(heterogeneous), scene.integrator()
    kind = described.plugin_name() if described is not None else None
    if given is not None and given.class_name() in _SEE_MEDIA:
        return given
    if described is not None and kind in _PATH_TRACERS:
        described.set_plugin_name(tracer)
        return mi.PluginManager.instance().create_object(described)
    if given is not None and records_layers(given) and not heterogeneous:
        return given
    found = f"integrator {kind!r}" if kind else "no integrator"
    if described is None and given is not None:
        found = f"the integrator {given.class_name()}, which is created already"
    warnings.warn(
        f"{title} has {found}; using {tracer} with max_depth {_DEFAULT_PATH_DEPTH}",
        LumitreeWarning,
        stacklevel=3,
    )
    return default_integrator(heterogeneous=heterogeneous)


def default_integrator(
    path_depth: int = _DEFAULT_PATH_DEPTH, *, heterogeneous: bool = False
) -> mi.Integrator:
    """Integrator for scenes that name none."""
    register()
    return mi.load_dict({"type": _path_tracer(heterogeneous), "max_depth": path_depth})


def _path_tracer(heterogeneous: bool) -> str:
    return "volpath" if heterogeneous else "lumitree_path"


def _check_size(film: mi.Film, title: str) -> None:
    """Refuse a film of no pixels, or of more than memory is likely to hold."""
    width, height = (int(each) for each in film.crop_size())
    if not (1 <= width <= MAX_PIXELS_A_SIDE and 1 <= height <= MAX_PIXELS_A_SIDE):
        raise LumitreeError(
            f"{title} has an image of {width:,} x {height:,} pixels; expected 1 to "
            f"{MAX_PIXELS_A_SIDE:,} a side"
        )


def _check_rgb(film: mi.Film, title: str) -> None:
    """Refuse a film that does not store R, G and B; it may store alpha too."""
    if film.class_name() == "HDRFilm":
        # The bitmap exists from here on.
        film.prepare([])
        formats = mi.Bitmap.PixelFormat
        if film.bitmap().pixel_format() in (formats.RGB, formats.RGBA):
            return
    raise LumitreeError(
        f"{title} has a film that does not store R, G and B; use an hdrfilm with the pixel_format "
        "'rgb'"
    )


def load_without_camera(source: SceneSource) -> tuple[mi.Scene, Sequence[SceneShape]]:
    """A scene, as of `load_scene`, but it needs no camera; and its shapes as the file has them."""
    scene, _, shapes = _open(source, scene_title(source))
    return scene, shapes_of_scene(scene, shapes)


def _open(
    source: SceneSource, title: str, *, box_filter: bool = False
) -> tuple[mi.Scene, mi.Properties | None, Sequence[SceneShape]]:
    """Scene, and, if they are known, properties of its integrator and its shapes."""
    register()  # the scene may name our plugins itself
    if isinstance(source, mi.Scene):
        return source, None, ()
    return _create(source, title, box_filter=box_filter)


def scene_title(source: SceneSource) -> str:
    """Name of a scene, as for `load_scene`, in messages."""
    if isinstance(source, Mapping | mi.Scene):
        return "the scene"
    return str(source)


def _created_films(source: SceneSource) -> list[object]:
    """The films of a scene, as for `load_scene`, that are created already, and other objects."""
    if isinstance(source, mi.Scene):
        return [sensor.film() for sensor in source.sensors()]
    values = list(source.values()) if isinstance(source, Mapping) else []
    within = [item for value in values if isinstance(value, Mapping) for item in value.values()]
    of_sensors = [value.film() for value in values if isinstance(value, mi.Sensor)]
    return [*of_sensors, *(item for item in within if isinstance(item, mi.Object))]


def _create(
    source: str | os.PathLike[str] | Mapping[str, Any], title: str, *, box_filter: bool
) -> tuple[mi.Scene, mi.Properties | None, Sequence[SceneShape]]:
    """Scene of a file or a dictionary, properties of its integrator, and its shapes."""
    file = SceneFile(source)
    # Copied, since creating the scene clears the nodes.
    described = [mi.Properties(node.props) for node in file.nodes("Integrator")][:1]
    file.set_rgb_films()
    if box_filter:
        file.set_box_filter()
    notes = list(file.notes)
    if "area" in file.loose_lights():
        notes.append("an area emitter outside of a shape emits nothing")
    for note in notes:
        warnings.warn(f"{title}: {note}", LumitreeWarning, stacklevel=3)
    shapes = file.shapes
    return file.instantiate(), described[0] if described else None, shapes


def appearance_for(integrator: mi.Integrator) -> Appearance:
    """Appearance that an integrator can show of lamps whose assets have geometry."""
    return "geometry" if getattr(integrator, "shows_geometry", False) else "field"


def set_film_width(scene: mi.Scene, width: int) -> None:
    """Change the image of the scene's first sensor to `width` pixels, keeping its proportions.

    A crop window shows the same part, to a pixel.
    """
    film = scene.sensors()[0].film()
    if width < 1:
        raise LumitreeError(f"width is {width}; expected at least 1 pixel")
    crop, offset, size = (
        np.ravel(each) for each in (film.crop_size(), film.crop_offset(), film.size())
    )
    scale = width / int(crop[0])
    scaled = np.array([width, max(1, round(int(crop[1]) * scale))])
    start = np.round(offset * scale).astype(int)
    params = mi.traverse(film)
    params["size"] = np.maximum(np.round(size * scale).astype(int), start + scaled).tolist()
    params["crop_size"] = scaled.tolist()
    params["crop_offset"] = start.tolist()
    params.update()


def _warn_rounded(luminaires: Sequence[PlacedLuminaire]) -> None:
    """Warn once where coordinates of a scene are too coarse for luminaires."""
    far: list[tuple[float, float, PlacedLuminaire]] = []
    for placed in luminaires:
        box = placed.scene_from_box
        reach = np.abs(box[:3, 3]) + np.abs(box[:3, :3]).sum(axis=1)
        size = 2 * float(np.linalg.norm(box[:3, :3], axis=0).max())
        if is_far(reach, size):
            far.append((float32_step(reach) / size, float(reach.max()), placed))
    if far:
        ratio, reach, placed = max(far, key=lambda each: each[0])
        others = "" if len(far) == 1 else f" and {len(far) - 1:,} others"
        warnings.warn(
            f"{placed.title}{others}: at {reach:.4g} units from the origin of the scene, "
            f"coordinates are rounded to multiples of {float32_step(reach):.2g}, {ratio:.2%} of "
            "its size; surfaces and shadows there are rough: move the scene to the origin",
            LumitreeWarning,
            stacklevel=3,
        )


def _warn_far(placed: PlacedLuminaire) -> None:
    """Warn where `volpath` cannot resolve a baked luminaire."""
    box, name = placed.scene_from_box, placed.placement.name
    size = 2 * np.linalg.norm(box[:3, :3], axis=0).max()
    coordinate = np.abs(box[:3, 3]).max()
    offset = (1 + coordinate) * mi.math.RayEpsilon
    if offset > _FAR_FOR_VOLPATH * size:
        warnings.warn(
            f"{name}: at coordinates of {coordinate:.4g} volpath starts rays {offset:.2g} "
            f"from surfaces, for a luminaire of size {size:.2g}; surfaces near it are lit wrongly "
            f"by about {0.11 * offset / size:.0%}; place it nearer the origin or use smaller units",
            LumitreeWarning,
            stacklevel=3,
        )


def _warn_unlit(scene: mi.Scene, causes: Mapping[PlacedLuminaire, str]) -> None:
    """Warn of objects in the boxes of luminaires that do not light them there."""
    boxes = np.array([placed.scene_from_box for placed in causes]).reshape(-1, 4, 4)
    inside = contains_objects(scene.shapes(), boxes)
    for (placed, cause), has_objects in zip(causes.items(), inside, strict=True):
        if has_objects:
            warnings.warn(
                f"{placed.title}: an object of the room is inside its box, where it is not lit: "
                f"{cause}",
                LumitreeWarning,
                stacklevel=3,
            )


@dataclasses.dataclass(frozen=True)
class CameraView:
    """View of a perspective camera.

    Attributes:
        origin: [3] its place, scene coordinates.
        direction, up: [3] unit vectors, where it looks and what is up in the image.
        horizontal, vertical: angles of view, degrees.
    """

    origin: tuple[float, float, float]
    direction: tuple[float, float, float]
    up: tuple[float, float, float]
    horizontal: float
    vertical: float


def camera_view(sensor: mi.Sensor) -> CameraView | None:
    """View of a perspective camera, with or without a lens; None for other cameras.

    There is none either if the centre of the image is not on the camera's axis, because of a crop
    window or of an offset of the principal point.
    """
    parameters, film = mi.traverse(sensor), sensor.film()
    if "x_fov" not in parameters:
        return None
    size, crop, start = (
        np.array(each, np.int64) for each in (film.size(), film.crop_size(), film.crop_offset())
    )
    shifts = [parameters[key] for key in parameters.keys() if key.startswith("principal_point")]  # noqa: SIM118
    if np.abs(2 * start + crop - size).max() > 1 or np.any(shifts):
        return None
    matrix = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
    # Half the width of the whole film at a distance of 1, and of the image that is its part.
    half = math.tan(math.radians(float(np.ravel(parameters["x_fov"])[0]) / 2))
    halves = half * crop / size[0]
    horizontal, vertical = (2 * math.degrees(math.atan(each)) for each in halves)
    axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    origin, direction, up = (
        tuple(each.tolist()) for each in (matrix[:3, 3], axes[:, 2], axes[:, 1])
    )
    return CameraView(origin, direction, up, horizontal, vertical)
