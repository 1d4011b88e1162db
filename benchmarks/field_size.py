"""Bytes of a stored field against what rounding costs: ways to store it, side by side.

    python -m benchmarks field_size NAME ... --references FOLDER [--fields FOLDER]

Fits the field of every luminaire at `--quality`, or takes it from `--fields`, where it is kept as
it was fitted; stores it in every way; and evaluates what each gives back on the views of its name
in `--references` (see `lumitree capture --split test`). The baseline is the field as fitted, not
compressed: float32 densities, float16 coefficients and int32 children. `load` is the time to make
these arrays of the bytes again. All ways render from the same arrays: queries take as long.
"""

import argparse
import dataclasses
import lzma
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.asset import array_stream, field_bytes
from lumitree.asset.asset import Asset
from lumitree.core.dataset import Dataset
from lumitree.core.frames import LocalFrame
from lumitree.core.harmonics import Y_00, num_coefficients
from lumitree.fit.config import QUALITIES

Code = Callable[[bytes], bytes]
Floats = NDArray[np.float32]
BASELINE, OURS = "as fitted", "steps 1/64; 1/8, 1/2, 1 (the file)"
ROUNDS = 5
_ARRAYS = ("children", "density", "coefficients")
# Of vector quantization: codes, iterations, and leaves that the codes are fitted to.
_CODES, _ITERATIONS, _TRAINED = 4096, 10, 1 << 17
_AT_ONCE = 1 << 14


class Stored(NamedTuple):
    """A stored field: its bytes, and what reads it."""

    size: int
    read: Callable[[], Asset]


def as_fitted(asset: Asset) -> Stored:
    """Arrays without compression."""
    return Stored(sum(getattr(asset, name).nbytes for name in _ARRAYS), lambda: asset)


def deflated(asset: Asset) -> Stored:
    """Arrays as they are, by zlib."""
    content = [zlib.compress(getattr(asset, name).tobytes(), 6) for name in _ARRAYS]

    def read() -> Asset:
        for each in content:
            zlib.decompress(each)
        return asset

    return Stored(sum(map(len, content)), read)


def in_steps(asset: Asset, steps: field_bytes.Steps, code: Code | None = None) -> Stored:
    """Coefficients in these steps; all else as in the file.

    Args:
        code: compresses the stream's arrays in planes; default: zlib, as in the file.
    """
    layouts = field_bytes.field_layouts(len(asset.children), asset.num_leaves, asset.l_max)
    stream = array_stream.compressed(field_bytes.field_codes(asset, steps), layouts)
    size = stream.size if code is None else len(code(zlib.decompress(stream.tobytes())))

    def read() -> Asset:
        codes = array_stream.decompressed(stream, layouts, "the field")
        field = field_bytes.field_of_codes(codes, steps)
        return dataclasses.replace(asset, **field)

    return Stored(size, read)


def by_vectors(asset: Asset, stages: int, seed: int) -> Stored:
    """The coefficients of a leaf as the nearest of 4096 vectors, and what is left likewise.

    As in VQRF (Li et al. 2023): leaves weigh as much as they emit in the fit of the vectors.
    """
    random = np.random.default_rng(seed)
    flat = asset.coefficients.reshape(asset.num_leaves, -1).astype(np.float32)
    weight = np.exp(np.clip(flat[:, :: num_coefficients(asset.l_max)].max(axis=1) * Y_00, -20, 0))
    left, indices, books = flat.copy(), [], []
    for _ in range(stages):
        book = _codebook(left, weight, random)
        index = _nearest(left, book)
        left -= book[index]
        indices.append(index.astype(np.uint16))
        books.append(book.astype(np.float16))
    codes = field_bytes.field_codes(asset)
    others = array_stream.compressed(
        codes, field_bytes.field_layouts(len(asset.children), asset.num_leaves, 0)[:3]
    )
    # 12 of 16 bits: zlib finds the four that are 0.
    packed = [zlib.compress(index.tobytes(), 6) for index in indices]
    size = others.size + sum(map(len, packed)) + sum(book.nbytes for book in books)

    def read() -> Asset:
        total = np.zeros(flat.shape, np.float32)
        for each, book in zip(packed, books, strict=True):
            total += book[np.frombuffer(zlib.decompress(each), np.uint16)]
        coefficients = total.reshape(asset.coefficients.shape).astype(np.float16)
        density = field_bytes.densities(field_bytes.density_codes(asset.density))
        return dataclasses.replace(asset, coefficients=coefficients, density=density)

    return Stored(size, read)


def _codebook(rows: Floats, weight: Floats, random: np.random.Generator) -> Floats:
    """Vectors [4096, n] by weighted k-means."""
    chance = weight / weight.sum()
    start = random.choice(len(rows), _CODES, p=chance, replace=len(rows) < _CODES)
    book = rows[start].copy()
    some = random.permutation(len(rows))[:_TRAINED]
    for _ in range(_ITERATIONS):
        index = _nearest(rows[some], book)
        total = np.bincount(index, weight[some], _CODES)
        for column in range(rows.shape[1]):
            sums = np.bincount(index, weight[some] * rows[some, column], _CODES)
            book[:, column] = np.where(total > 0, sums / np.maximum(total, 1e-30), book[:, column])
    return book


def _nearest(rows: Floats, book: Floats) -> NDArray[np.int64]:
    """Index of the vector that is nearest to each row."""
    squares = (book**2).sum(axis=1)
    parts = [rows[i : i + _AT_ONCE] for i in range(0, len(rows), _AT_ONCE)]
    return np.concatenate([(squares - 2 * part @ book.T).argmin(axis=1) for part in parts])


def steps(constant: float, others: float) -> field_bytes.Steps:
    """Steps that are the same for all leaves."""
    return field_bytes.Steps(constant, others, others, others)


WAYS: dict[str, Callable[[Asset, int], Stored]] = {
    BASELINE: lambda asset, _: as_fitted(asset),
    "zlib": lambda asset, _: deflated(asset),
    "step 1/8": lambda asset, _: in_steps(asset, steps(1 / 8, 1 / 8)),
    "step 1/4": lambda asset, _: in_steps(asset, steps(1 / 4, 1 / 4)),
    "steps 1/4; 1/2": lambda asset, _: in_steps(asset, steps(1 / 4, 1 / 2)),
    OURS: lambda asset, _: in_steps(asset, field_bytes.STEPS),
    "the same by LZMA": lambda asset, _: in_steps(asset, field_bytes.STEPS, lzma.compress),
    "steps 1/4; 1/8, 1/4, 1/2": lambda asset, _: in_steps(
        asset, field_bytes.Steps(1 / 4, 1 / 8, 1 / 4, 1 / 2)
    ),
    "4096 vectors": lambda asset, seed: by_vectors(asset, 1, seed),
    "4096 vectors, 2 stages": lambda asset, seed: by_vectors(asset, 2, seed),
    "4096 vectors, 3 stages": lambda asset, seed: by_vectors(asset, 3, seed),
}


def fitted_field(name: str, options: argparse.Namespace) -> Asset:
    """The field of a luminaire before it is rounded, from `--fields` or by a fit."""
    from lumitree.fit.octree.bake import bake
    from lumitree.lamp.loading import load_luminaire

    path = options.fields / f"{name}-{options.quality}.npz"
    if not path.exists():
        config = dataclasses.replace(QUALITIES[options.quality].octree_fit, seed=options.seed)
        with tempfile.TemporaryDirectory() as folder:
            asset = bake(load_luminaire(name), config, Path(folder)).asset
        path.parent.mkdir(parents=True, exist_ok=True)
        scalars = {key: getattr(asset, key) for key in ("tree_depth", "l_max", "law")}
        np.savez(
            path,
            **{key: getattr(asset, key) for key in _ARRAYS},
            **scalars,
            max_radiance=asset.max_radiance,
            half_extents=asset.frame.half_extents,
            world_from_local=asset.frame.world_from_local,
        )
    with np.load(path) as stored:
        return Asset(
            **{key: stored[key] for key in _ARRAYS},
            tree_depth=int(stored["tree_depth"]),
            l_max=int(stored["l_max"]),
            law=str(stored["law"]),  # type: ignore[arg-type]
            max_radiance=float(stored["max_radiance"]),
            frame=LocalFrame(stored["half_extents"], stored["world_from_local"]),
            luminaire=name,
        )


def measure(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each way to store the field of a luminaire."""
    from lumitree.measure.irradiance import asset_irradiance
    from lumitree.measure.view_errors import evaluate_views

    asset = fitted_field(name, options)
    data = Dataset.open(str(options.references / name))
    rows, reference = [], None
    for way, store in WAYS.items():
        stored = store(asset, options.seed)
        found, seconds = stored.read(), []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            stored.read()
            seconds.append(time.perf_counter() - start)
        metrics = evaluate_views(found, data).metrics
        lux = asset_irradiance(found, options.rays, seed=options.seed).lux
        reference = lux if reference is None else reference
        rows.append(
            {
                "luminaire": name,
                "quality": options.quality,
                "leaves": asset.num_leaves,
                "way": way,
                "bytes": stored.size,
                "load_seconds": float(np.median(seconds)),
                "metrics": {key: metrics[key] for key in ("psnr_linear", "psnr_mulaw")},
                "irradiance_change": float(
                    np.sqrt(np.mean((lux.mean(axis=(1, 2)) / reference.mean(axis=(1, 2)) - 1) ** 2))
                ),
            }
        )
        print(table(rows[-1:]).text(), flush=True)
    return rows


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each row."""
    heads = ["luminaire", "leaves", "way", "MB", "B / leaf", "psnr_linear", "psnr_mulaw"]
    heads += ["irradiance, %", "load, s"]
    lines = [
        [
            f"{row['luminaire']}, {row['quality']}",
            f"{row['leaves']:,}",
            row["way"],
            f"{row['bytes'] / 1e6:.2f}",
            f"{row['bytes'] / row['leaves']:.1f}",
            f"{row['metrics']['psnr_linear']:.2f}",
            f"{row['metrics']['psnr_mulaw']:.2f}",
            f"{100 * row['irradiance_change']:.2f}",
            f"{row['load_seconds']:.2f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=3)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="NAME", nargs="+", help="a built-in luminaire")
    parser.add_argument("--references", metavar="FOLDER", type=Path, required=True)
    parser.add_argument(
        "--fields",
        metavar="FOLDER",
        type=Path,
        default=Path(tempfile.gettempdir()) / "fields",
        help="keeps the fields as they were fitted",
    )
    parser.add_argument("--quality", choices=list(QUALITIES), default="standard")
    parser.add_argument("--rays", metavar="N", type=int, default=1 << 18)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    for name in options.luminaires:
        Dataset.open(str(options.references / name))  # before the fits, not after
    results = Results(options)
    rows = []
    for name in options.luminaires:
        rows += measure(name, options)
        setting = results.setting()
        text = (
            "# Bytes of a stored field, and what rounding costs\n\n"
            f"{table(rows).markdown()}\n"
            "Irradiance: RMS change of the mean of the faces around the lamp, with the same random "
            "numbers. Load: decompression and conversion, median.\n\n"
            f"{notes(setting)}"
        )
        results.write({"setting": setting, "rows": rows}, text)
