"""Manifests, records, TOML files, tables of points, and images with layers."""

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import tempfile
import tomllib
from pathlib import Path

import numpy as np

from fuzz import json_trees, words
from fuzz.reader import MEBIBYTE, Reader
from fuzz.values import chance, pick, text, token
from lumitree.cli.config_file import config_text, read_config
from lumitree.core.dataset import Dataset, Frame, Manifest, View
from lumitree.core.directions import view_pose
from lumitree.core.frames import LocalFrame
from lumitree.core.images import write_exr
from lumitree.core.toml_table import read_toml
from lumitree.errors import LumitreeError
from lumitree.fit.catalogue.record import INDEX_FILES, LampFiles
from lumitree.fit.config import QUALITIES
from lumitree.measure.illuminance.areas import read_points
from lumitree.rendering.placement_file import read_placements
from support.damage import damaged
from support.placement_text import PLACEMENTS

_TOML_SEPARATORS = (b" ", b" = ", b", ", b".", b'"', b"[")


def changed_toml(content, rng):
    """A TOML file with some changes."""
    if chance(rng, 0.1):
        return damaged(content, rng)
    if chance(rng, 0.8):
        # An earlier change may have left no TOML, or one that is nested too deeply.
        with contextlib.suppress(ValueError, RecursionError):
            tree = tomllib.loads(content.decode())
            return json_trees.written_toml(json_trees.changed(tree, rng))
    return words.changed(content, rng, separators=_TOML_SEPARATORS)


def _placements(rng):
    return {"lights.toml": changed_toml(PLACEMENTS.encode(), rng)}


def _sound_placements(found):
    for each in found:
        assert each.label is not None
        for values in (each.at, each.rotate, each.size, each.gain, each.lumens, each.temperature):
            assert values is None or np.isfinite(np.array(values, float)).all()


@functools.cache
def _settings_text():
    """All settings with their values."""
    lines = config_text(QUALITIES["high"]).splitlines()
    lines = [line.removeprefix("#") if "=" in line and line[:2] != "# " else line for line in lines]
    return "\n".join(line for line in lines if line[:2] != "# " and "..." not in line).encode()


def _settings(rng):
    lines = _settings_text().split(b"\n")
    # Few of them, so that most changes are not beside an error.
    heads = [line for line in lines if line.startswith(b"[")]
    chosen = set(heads) | {lines[int(at)] for at in rng.integers(len(lines), size=6)}
    content = b"\n".join(line for line in lines if line in chosen and line)
    return {"settings.toml": changed_toml(content, rng)}


def _read_settings(folder):
    table = read_toml(folder / "settings.toml", "a TOML file of settings")
    found, _ = read_config(table, QUALITIES["standard"])
    table.finish()
    return found


def _points(rng):
    names = ["x", "y", "z", "nx", "ny", "nz", "room"][: pick(rng, (6, 6, 7))]
    rng.shuffle(names)
    rows = [names]
    for _ in range(int(rng.integers(0, 8))):
        row = [f"{value:.6g}" for value in rng.normal(size=len(names))]
        if chance(rng, 0.1):
            row[int(rng.integers(len(row)))] = text(rng) if chance(rng, 0.3) else token(rng, row[0])
        rows.append(row)
    separator = pick(rng, (",",) * 9 + (", ",) * 3 + (";",))
    content = pick(rng, ("\n", "\r\n")).join(separator.join(row) for row in rows)
    content = content.encode(pick(rng, ("utf-8", "utf-8-sig")), "surrogatepass")
    if chance(rng, 0.4):
        content = words.changed(content, rng, separators=(b",",))
    return {"points.csv": damaged(content, rng) if chance(rng, 0.1) else content}


def _sound_points(found):
    points, normals = found
    assert points.shape == normals.shape
    assert points.shape[1] == 3
    assert len(points) > 0


@functools.cache
def _dataset():
    """Manifest and views of a dataset."""
    with tempfile.TemporaryDirectory() as name:
        rows = [tuple(map(tuple, view_pose(i, 2.0).tolist())) for i in (1, 2)]
        frames = tuple(Frame(f"view_{i}.exr", i, row) for i, row in enumerate(rows, 1))
        manifest = Manifest(
            luminaire="lamps/lamp",
            fingerprint="0" * 64,
            split="train",
            resolution=4,
            samples_per_pixel=4,
            path_depth=128,
            half_width=1.5,
            local_frame=LocalFrame((1.0, 0.5, 1e-3), np.diag([2, 2, 2, 1])),
            frames=frames,
        )
        dataset = Dataset(Path(name), manifest)
        dataset.save_manifest()
        planes = np.random.default_rng(0).random((3, 4, 4, 3)).astype(np.float32)
        for frame in frames:
            dataset.write(View(frame, planes[0], planes[1, ..., 0], planes[2, ..., 0]))
        return {path.name: path.read_bytes() for path in Path(name).iterdir()}


def _changed_dataset(rng):
    files = dict(_dataset())
    if chance(rng, 0.6):
        manifest = json.loads(files["manifest.json"])
        files["manifest.json"] = json_trees.written(json_trees.changed(manifest, rng))
    else:
        files["view_1.exr"] = _changed_exr(files["view_1.exr"], rng)
    if chance(rng, 0.05):
        files["manifest.json"] = damaged(files["manifest.json"], rng)
    return files


def _changed_exr(content, rng):
    """An OpenEXR file with other numbers in its header, or with damaged bytes.

    Its header is a list of attributes: name, type, size and value.
    """
    if chance(rng, 0.3):
        return words.flipped(content, rng)
    data = bytearray(content)
    end = content.index(b"\0\0", 8) if b"\0\0" in content[8:] else len(content)
    attributes = [content.find(name) for name in (b"dataWindow", b"displayWindow", b"channels")]
    for _ in range(int(rng.integers(1, 4))):
        start = pick(rng, [at for at in attributes if at >= 0] or [8])
        at = start + int(rng.integers(0, 60)) if chance(rng, 0.7) else int(rng.integers(end))
        size = pick(rng, (1, 4))
        if at + size <= len(data):
            value = pick(rng, (0, 1, 255, 2**31 - 1, 2**31, 2**32 - 1, 65536, int(rng.integers(9))))
            data[at : at + size] = value.to_bytes(4, "little")[:size]
    return bytes(data)


def _read_dataset(folder):
    dataset = Dataset.open(folder)
    return dataset, list(dataset.views())


def _sound_dataset(found):
    dataset, views = found
    size = dataset.manifest.resolution
    for view in views:
        assert view.radiance.shape == (size, size, 3)
        assert np.isfinite(view.radiance).all()
        assert np.isfinite(view.opacity("geometric")).all()


@functools.cache
def _layers():
    """An image of layers, as `render --layers` writes it."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "layers.exr"
        pixels = np.random.default_rng(0).random((2, 4, 4, 3)).astype(np.float32)
        channels = {"RGB": pixels.sum(axis=0), "lamp": pixels[0], "room": pixels[1]}
        write_exr(path, channels, json.dumps({"lumitree": "0", "command": "render"}))
        return path.read_bytes()


def _changed_layers(rng):
    if chance(rng, 0.4):
        # Numbers that are right in themselves.
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / "layers.exr"
            pixels = [rng.random((4, 4, 3)).astype(np.float32) for _ in range(3)]
            pixels = [words.changed_array(each, rng) for each in pixels]
            names = [pick(rng, ("RGB", "lamp", "a b", "é", "x" * 200, "Z")) for _ in pixels]
            write_exr(path, dict(zip(names, pixels, strict=True)), pick(rng, ("", "{}", "\0")))
            return {"layers.exr": path.read_bytes()}
    return {"layers.exr": _changed_exr(_layers(), rng)}


def _mix(folder):
    from lumitree.rendering.mixture import mix

    return mix(folder / "layers.exr", {})


@functools.cache
def _records():
    """A record of each version."""
    figures = {"lumens": 812.5, "file_bytes": 5, "size": [0.1, 0.2, 0.3], "irradiance_rms": 0.04}
    both = {
        "state": "finished",
        "fingerprint": "a" * 64,
        "settings": "{}",
        "seconds": 12.5,
        "figures": figures,
    }
    digest = hashlib.sha256(b"asset").hexdigest()
    stamp = [5, 1_700_000_000_000_000_000, digest]
    return (
        {"version": 1, "asset_sha256": digest, **both},
        {"version": 2, "options": "{}", "files": [["../lamp.xml", *stamp]], "asset": stamp,
         "image": "webp", **both},
    )  # fmt: skip


def _changed_record(rng):
    content = json_trees.written(json_trees.changed(pick(rng, _records()), rng))
    if chance(rng, 0.1):
        content = damaged(content, rng)
    return {"lamp.lumitree": b"asset", f"{INDEX_FILES}/lamp.json": content}


def _write_pages(folder):
    from lumitree.fit.catalogue.index import FolderIndex

    FolderIndex(folder).write([])
    return LampFiles(folder, "lamp").read()


@functools.cache
def _state_arrays():
    """Arrays as a saved state of a bake has them, and the settings that it is of."""
    from lumitree.core.harmonics import num_coefficients
    from lumitree.fit.octree.config import OctreeFitConfig
    from lumitree.fit.octree.leaf_field import padded_width

    random, leaves, config = np.random.default_rng(0), 8, OctreeFitConfig()
    terms, width = num_coefficients(config.l_max), padded_width(config.l_max)
    arrays = {
        "seconds": np.array(1.5),
        "max_radiance": np.array(2.0),
        "rays": np.array(10),
        "steps": np.array([3, 3]),
    }
    for prefix in ("", "best_"):
        arrays[f"{prefix}cells"] = np.indices((2, 2, 2)).reshape(3, -1).T
        arrays[f"{prefix}levels"] = np.ones(leaves, np.int64)
        arrays[f"{prefix}log_density"] = random.random(leaves).astype(np.float32)
        arrays[f"{prefix}coefficients"] = random.random((leaves, 3, terms)).astype(np.float32)
    for name, size in (("density", leaves), ("coefficient", leaves * width)):
        for part in ("mean", "square"):
            arrays[f"{name}_{part}"] = random.random(size).astype(np.float32)
    return config, arrays


def _changed_archive(arrays, rng):
    """An .npz archive of arrays, of which some are missing, of another type or size."""
    arrays = dict(arrays)
    for _ in range(int(rng.integers(1, 3))):
        name = pick(rng, list(arrays))
        match int(rng.integers(6)):
            case 0 if len(arrays) > 1:
                del arrays[name]
            case 1 if arrays[name].dtype.kind in "fiub":
                kind = pick(rng, ("S3", "U3", "bool", "complex64", "int8", "float16", "float64"))
                arrays[name] = arrays[name].astype(kind)
            case 2:
                arrays[name] = np.broadcast_to(arrays[name], (2, *arrays[name].shape))
            case 3 if arrays[name].ndim:
                arrays[name] = words.resized(arrays[name], rng)
            case _ if arrays[name].dtype.kind in "fiub" and arrays[name].ndim:
                arrays[name] = words.changed_array(arrays[name], rng)
    content = io.BytesIO()
    np.savez(content, **arrays)
    data = content.getvalue()
    if chance(rng, 0.2):
        data = words.flipped(data, rng)
    return data


def _state(rng):
    config, arrays = _state_arrays()
    settings = dataclasses.asdict(config)
    del settings["time"], settings["rays"]
    record = json.dumps({"version": 2, "fingerprint": "abc", **settings}, sort_keys=True)
    return {"state.npz": _changed_archive(arrays | {"record": np.array(record)}, rng)}


def _read_state(folder):
    from lumitree.fit.octree.ray_source import Subject
    from lumitree.fit.octree.saved_state import StateFile

    subject = Subject("lamp", "abc", LocalFrame(np.ones(3), np.eye(4)))
    return StateFile(folder, subject, _state_arrays()[0]).load()


def _sound_state(state):
    """The octrees of both fields can be built."""
    from lumitree.octree.build import build_children

    # Leaves that overlap are refused then.
    with contextlib.suppress(LumitreeError):
        for prefix in ("", "best_"):
            build_children(state._arrays[f"{prefix}cells"], state._arrays[f"{prefix}levels"])
    assert np.isfinite(state.seconds)


@functools.cache
def _run_files():
    """Record, occupancy and history of a training run."""
    from lumitree.fit.network.config import TrainConfig

    frame = LocalFrame(np.ones(3), np.eye(4))
    record = {
        "config": dataclasses.asdict(TrainConfig()),
        "dataset": "data",
        "fingerprint": "a" * 64,
        "luminaire": "lamp",
        "max_radiance": 2.5,
        **frame.members(),
        "version": 1,
    }
    cells = np.packbits(np.random.default_rng(0).random(24) < 0.5)
    shape, half = np.array([2, 3, 4], np.int32), np.array([1, 0.5, 0.25], np.float32)
    history = [{"step": 1, "seconds": 2.0, "loss": 0.5, "psnr": 12.0}]
    return record, {"bits": cells, "shape": shape, "half_extents": half}, history


def _changed_run(rng):
    record, occupancy, history = _run_files()
    files = {"run.json": json_trees.written(json_trees.tree_of(record))}
    files["history.json"] = json.dumps(history).encode()
    content = io.BytesIO()
    np.savez_compressed(content, **occupancy)
    files["occupancy.npz"] = content.getvalue()
    match int(rng.integers(4)):
        case 0:
            files["occupancy.npz"] = _changed_archive(occupancy, rng)
        case 1:
            files["history.json"] = json_trees.written(json_trees.changed(history, rng))
        case _:
            files["run.json"] = json_trees.written(json_trees.changed(record, rng))
    return files


def _read_run(folder):
    from lumitree.fit.network.occupancy import load_occupancy
    from lumitree.fit.network.run import RunRecord
    from lumitree.fit.network.train import _load_history

    record, occupancy = RunRecord.load(folder), load_occupancy(folder / "occupancy.npz")
    return record, occupancy, _load_history(folder, 10)


READERS = (
    Reader(
        "placements",
        _placements,
        lambda folder: read_placements(folder / "lights.toml"),
        _sound_placements,
    ),
    Reader("settings", _settings, _read_settings),
    Reader(
        "points",
        _points,
        lambda folder: read_points(folder / "points.csv"),
        _sound_points,
    ),
    Reader("dataset", _changed_dataset, _read_dataset, _sound_dataset, memory=2048 * MEBIBYTE),
    Reader("layers", _changed_layers, _mix, memory=2048 * MEBIBYTE),
    Reader("record", _changed_record, _write_pages),
    Reader("state", _state, _read_state, _sound_state),
    Reader("run", _changed_run, _read_run),
)
