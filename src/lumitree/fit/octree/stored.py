"""Rays of stored views, for a luminaire that cannot be traced: `RaySource` from a dataset."""

from __future__ import annotations

import dataclasses
import hashlib
import json

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.frames import orthographic_rays
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.fit.octree.config import TILE_RAYS, TILE_SIDE
from lumitree.fit.octree.estimate import inside_box
from lumitree.fit.octree.rays import RayPairs, Rays, Subject, Wanted, chosen_rays
from lumitree.lamp.dataset import Dataset, View, visual_hull


class StoredRays:
    """Rays through the pixels of a dataset's views; a ray is anywhere in its pixel.

    All pixels are held in memory, 20 bytes each. One view in `held_out_stride` is held out for the
    score, at least one.

    Raises:
        LumitreeError: there are fewer than two views, or they are black.
    """

    def __init__(self, dataset: Dataset, held_out_stride: int, seed: int = 0) -> None:
        self._manifest, self._seed = dataset.manifest, seed
        views = list(dataset.views())
        if len(views) < 2:
            raise LumitreeError(f"{dataset.folder} has one view; a bake needs two or more")
        self._max_radiance = dataset.max_radiance(views)
        held_out = views[held_out_stride // 2 :: held_out_stride] or views[-1:]
        files = {view.frame.file for view in held_out}
        self._views = [view for view in views if view.frame.file not in files]
        self._training, self._held_out = self._load(self._views), self._load(held_out)
        self._sampler = mi.load_dict({"type": "independent"})

    @property
    def subject(self) -> Subject:
        """The luminaire that the views show; another capture of it is another subject."""
        of = self._manifest
        captured = [of.fingerprint, of.split, of.resolution, of.spp, of.path_depth]
        captured += [[frame.file, frame.halton_index] for frame in of.frames]
        fingerprint = hashlib.sha256(json.dumps(captured).encode()).hexdigest()
        return Subject(of.luminaire, fingerprint, of.local_frame)

    def max_radiance(self) -> float:
        """L_max."""
        return self._max_radiance

    def draw(
        self, count: int, stream: SeedStream, wanted: Wanted, light_paths_per_ray: float = 0
    ) -> Rays:
        """The wanted ones of rays through `count` random pixels of the training views.

        They bring all the light; `light_paths_per_ray` is ignored.
        """
        origin, direction, radiance, through = self._pixels(self._training, count, stream)
        origin, direction, chosen = chosen_rays(origin, direction, wanted)
        num_rays = dr.width(chosen)
        share = parameter(mi.Float, 1 / max(1, num_rays)) * dr.ones(mi.Float, num_rays)
        light = dr.gather(mi.Color3f, radiance, chosen) * share
        through = dr.gather(mi.Float, through, chosen)
        dr.eval(share, light, through)
        return Rays(origin, direction, share, light, through)

    def draw_opacity(
        self, count: int, stream: SeedStream, wanted: Wanted
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float]:
        """Origin, direction and transmittance of wanted rays of the training views."""
        rays = self.draw(count, stream, wanted)
        return rays.origin, rays.direction, rays.transmittance

    def draw_pairs(self, count: int, stream: SeedStream, paths: int) -> RayPairs:
        """Rays of the held-out views for the score, and of the others for other purposes.

        A view has one value for a pixel, whose noise counts as error; `paths` is ignored.
        """
        images = self._held_out if stream.purpose is Purpose.HELD_OUT else self._training
        origin, direction, radiance, through = self._pixels(images, count, stream)
        return RayPairs(origin, direction, radiance, radiance, through)

    def hull(self, level: int) -> NDArray[np.int64]:
        """Cells [M, 3] of an octree's level that no training view shows as empty."""
        manifest = self._manifest
        # A mask has the pixels with opacity or radiance: what is transparent may emit too.
        masks = (
            (view.frame.pose, (view.straight_through > 0) | (view.radiance.max(axis=-1) > 0))
            for view in self._views
        )
        cells = np.argwhere(visual_hull(masks, manifest.half_width, (1, 1, 1), 1 << level))
        return cells[inside_box(cells, level, manifest.local_frame.half_extents)]

    def _load(self, views: list[View]) -> _Images:
        manifest = self._manifest
        corners, columns, rows, directions = [], [], [], []
        for view in views:
            # The corner of the image, and the steps from pixel to pixel.
            pose = view.frame.pose
            centres, direction = orthographic_rays(pose, manifest.half_width, 1)
            step = 2 * manifest.half_width / manifest.resolution
            columns.append(step * pose[:3, 0])
            rows.append(-step * pose[:3, 1])
            middle = manifest.resolution / 2
            corners.append(centres[0, 0] - middle * (columns[-1] + rows[-1]))
            directions.append(direction)
        corner, column, row, towards = (
            on_device(mi.Vector3f, each) for each in (corners, columns, rows, directions)
        )
        radiance = np.concatenate([view.radiance.reshape(-1, 3) for view in views])
        through = 1 - np.concatenate([view.straight_through.ravel() for view in views])
        images = _Images(
            corner,
            column,
            row,
            towards,
            on_device(mi.Color3f, radiance),
            on_device(mi.Float, through),
            len(views),
        )
        dr.eval(corner, column, row, towards, images.radiance, images.through)
        return images

    def _pixels(self, images: _Images, count: int, stream: SeedStream):
        """Origin, direction, radiance and transmittance of rays through random pixels."""
        resolution, tiles = self._manifest.resolution, count // TILE_RAYS
        self._sampler.seed(stream.seed(self._seed, 0), tiles)
        view = mi.UInt32(dr.minimum(self._sampler.next_1d() * images.count, images.count - 1))
        corner = mi.Point2i(dr.floor(self._sampler.next_2d() * resolution))
        dr.eval(view, corner)
        self._sampler.seed(stream.seed(self._seed, 1), count)
        index = dr.arange(mi.UInt32, count)
        tile, within = index // TILE_RAYS, mi.Int32(index % TILE_RAYS)
        view = dr.gather(mi.UInt32, view, tile)
        pixel = dr.gather(mi.Point2i, corner, tile) + mi.Point2i(
            within % TILE_SIDE, within // TILE_SIDE
        )
        # Beyond an edge at the opposite one, so that all pixels are drawn alike.
        pixel = pixel % resolution
        place = mi.Point2f(pixel) + self._sampler.next_2d()
        origin = (
            dr.gather(mi.Vector3f, images.corner, view)
            + place.x * dr.gather(mi.Vector3f, images.column, view)
            + place.y * dr.gather(mi.Vector3f, images.row, view)
        )
        flat = view * resolution**2 + mi.UInt32(pixel.y * resolution + pixel.x)
        return (
            mi.Point3f(origin),
            dr.gather(mi.Vector3f, images.direction, view),
            dr.gather(mi.Color3f, images.radiance, flat),
            dr.gather(mi.Float, images.through, flat),
        )


@dataclasses.dataclass
class _Images:
    """Views on the device: per view corner, steps and direction; per pixel its values."""

    corner: mi.Vector3f
    column: mi.Vector3f
    row: mi.Vector3f
    direction: mi.Vector3f
    radiance: mi.Color3f
    through: mi.Float
    count: int
