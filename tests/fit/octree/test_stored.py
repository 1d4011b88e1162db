"""Rays of stored views, and the bake from them alone."""

import dataclasses

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import Dataset
from support.lamps import AREA, cube, sphere
from support.tiny_bakes import octree_config
from support.traced_lamps import everywhere, stream

VIEWS, RESOLUTION = 17, 64


@pytest.fixture(scope="module")
def dataset(mi, tmp_path_factory):
    """An emissive sphere beside a grey cube."""
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.trace.cameras import capture

    folder = tmp_path_factory.mktemp("stored")
    grey = '<bsdf type="diffuse"/>'
    shapes = sphere("lamp", 0.5, (-0.5, 0, 0), AREA) + cube("body", 0.5, (0.5, 0.1, 0), grey)
    (folder / "lamp.xml").write_text(f'<scene version="3.0.0">{shapes}</scene>')
    return capture(
        load_luminaire(str(folder / "lamp.xml")),
        str(folder / "views"),
        views=VIEWS,
        resolution=RESOLUTION,
        spp=32,
        split="train",
    )


def test_rays_have_the_values_of_their_pixels(mi, dataset):
    """Every ray, projected into the view it is of, lies in a pixel of its value."""
    from lumitree.fit.octree.stored import StoredRays

    rays = StoredRays(dataset, 8).draw(1 << 12, stream(3), everywhere)
    origin, direction = np.array(rays.origin).T, np.array(rays.direction).T
    light, share = np.array(rays.light).T, np.array(rays.share)
    assert share.sum() == pytest.approx(1, rel=1e-4)
    through = np.array(rays.transmittance)
    seen = set()
    for view in dataset.views():
        pose = view.frame.pose
        of_view = np.abs(direction + pose[:3, 2]).max(axis=1) < 1e-4
        if not of_view.any():
            continue
        seen.add(view.frame.file)
        half = dataset.manifest.half_width
        offset = origin[of_view] - pose[:3, 3]
        column = (offset @ pose[:3, 0] + half) / (2 * half) * RESOLUTION
        row = (half - offset @ pose[:3, 1]) / (2 * half) * RESOLUTION
        inner = (np.abs(column % 1 - 0.5) < 0.49) & (np.abs(row % 1 - 0.5) < 0.49)
        place = row[inner].astype(int), column[inner].astype(int)
        shown = light[of_view][inner] / share[of_view][inner, None]
        assert shown == pytest.approx(view.radiance[place], rel=1e-3, abs=1e-5)
        assert 1 - through[of_view][inner] == pytest.approx(view.straight_through[place], abs=1e-5)
    # Two of the 17 are held out.
    assert len(seen) == VIEWS - 2


def test_all_pixels_are_drawn_alike(mi, dataset):
    from lumitree.fit.octree.stored import StoredRays

    rays = StoredRays(dataset, 8).draw(1 << 18, stream(4), everywhere)
    origin, direction = np.array(rays.origin).T, np.array(rays.direction).T
    half = dataset.manifest.half_width
    columns = []
    for view in dataset.views():
        pose = view.frame.pose
        of_view = np.abs(direction + pose[:3, 2]).max(axis=1) < 1e-4
        offset = origin[of_view] - pose[:3, 3]
        columns.append((offset @ pose[:3, 0] + half) / (2 * half) * RESOLUTION)
    counts, _ = np.histogram(np.concatenate(columns), RESOLUTION, (0, RESOLUTION))
    # Four columns of a tile are drawn together: 16 times fewer are independent.
    expected = counts.mean()
    assert np.abs(counts - expected).max() < 6 * np.sqrt(16 * expected)


def test_held_out_views_are_others(mi, dataset):
    from lumitree.core.seeds import Purpose, SeedStream
    from lumitree.fit.octree.stored import StoredRays

    source = StoredRays(dataset, 8)
    kinds = [
        {
            tuple(np.round(row, 4))
            for row in np.array(source.draw_pairs(1 << 12, SeedStream(purpose), 1).direction).T
        }
        for purpose in (Purpose.ERROR_INDICATOR, Purpose.HELD_OUT)
    ]
    assert len(kinds[0]) == VIEWS - 2
    assert len(kinds[1]) == 2
    assert not kinds[0] & kinds[1]


def test_hull_holds_the_lamp_and_little_else(mi, dataset):
    from lumitree.fit.octree.stored import StoredRays

    level = 6
    cells = StoredRays(dataset, 8).hull(level)
    manifest = dataset.manifest
    scale = np.array(manifest.local_frame.world_from_local)[0, 0]
    centre = np.array(manifest.local_frame.world_from_local)[:3, 3]
    random = np.random.default_rng(1)
    points = random.normal(size=(500, 3))
    points = 0.5 * points / np.linalg.norm(points, axis=1, keepdims=True) + [-0.5, 0, 0]
    local = (points - centre) / scale
    inside = {tuple(cell) for cell in cells}
    on_lamp = np.floor((local * 0.999 + 1) / 2 * (1 << level)).astype(int)
    assert all(tuple(cell) in inside for cell in on_lamp)
    # The corners of the box around the sphere, 0.87 from its centre, are carved away.
    centres = ((cells + 0.5) / (1 << level) * 2 - 1) * scale + centre - [-0.5, 0, 0]
    beyond = centres[centres[:, 0] < 0]
    assert 0.4 < np.linalg.norm(beyond, axis=1).max() < 0.75


@pytest.mark.slow
def test_bake_from_views(mi, dataset, tmp_path):
    from lumitree.fit.octree.bake import bake_stored
    from lumitree.measure.evaluate import evaluate_views

    config = octree_config(tree_depth=6, rays=1 << 22, refine={"rays": 1 << 13})
    result = bake_stored(dataset, config, tmp_path)
    metrics = evaluate_views(result.asset, dataset).metrics
    assert metrics["psnr_linear"] > metrics["psnr_linear_black"] + 8
    assert metrics["opacity_rmse"] < 0.15
    assert result.asset.luminaire == dataset.manifest.luminaire


def test_another_capture_of_the_lamp_is_another_subject(mi, dataset):
    """Whose unfinished bake is not continued."""
    from lumitree.fit.octree.stored import StoredRays

    fewer = dataclasses.replace(dataset.manifest, frames=dataset.manifest.frames[:-1])
    subjects = [
        StoredRays(Dataset(dataset.folder, manifest), 8).subject
        for manifest in (dataset.manifest, dataset.manifest, fewer)
    ]
    assert subjects[0].fingerprint == subjects[1].fingerprint != subjects[2].fingerprint


def test_one_view_is_refused(mi, lamp, tmp_path):
    from lumitree.fit.octree.stored import StoredRays
    from lumitree.trace.cameras import capture

    emissive = lamp(sphere("lamp", 1, inside=AREA))
    one = capture(
        emissive, str(tmp_path / "one"), views=1, resolution=16, spp=1,
        split="train",
    )  # fmt: skip
    with pytest.raises(LumitreeError, match="one view"):
        StoredRays(one, 8)
