"""All that has to be known about an NVIDIA GPU, in parts, in at most 25 minutes.

    python -m benchmarks gpu --minutes 25
    python -m benchmarks gpu --dry-run

The parts in order of worth: tests of kernels against reference implementations and of samplers by
χ²; images, irradiance and light fields on the GPU against those on the CPU by z-tests; the tests of
rendering; bakes, queries against an area light, and time at equal error, by the benchmarks
`devices`, `query` and `equal_quality`; a step of the network, its training by the paper's settings,
and its octree at depth 10; then the remaining tests. Each part runs in a process of its own with a
limit of time, so that one which crashes or hangs costs no other.

Every part writes its own file of `gpu/` into the results, and `gpu.md` shows them all. The same
command goes on with what is missing, so `--minutes 8` several times does the same. Logs and
intermediate data are kept in `--work`. `--dry-run` runs all parts on the CPU at tiny sizes; its
results are `gpu-trial.md` and `gpu-trial/` in the folder of `--work`, unless `-o` names another,
and are no figures of a GPU. Without a GPU there is an error. The baseline is the CPU
(`llvm_ad_rgb`). docs/how-to/gpu.md lists what has to be installed.
"""

import argparse
import ctypes
from pathlib import Path

from benchmarks.common.results import RESULTS
from benchmarks.common.setting import nvidia
from benchmarks.common.tables import Table
from benchmarks.gpu_parts.page import page
from benchmarks.gpu_parts.part import Part
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.running import Run, run_parts
from benchmarks.gpu_parts.sizes import SIZE_NAMES, SIZES, SizeName
from lumitree.core.backend import CPU_VARIANT, GPU_VARIANT
from lumitree.core.files import write_bytes
from lumitree.core.interrupt import interruptible
from lumitree.errors import LumitreeError

# The processes of the parts load Mitsuba, this one does not.
LOADS_MITSUBA = False


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--minutes", type=float, metavar="M", default=25.0, help="of all parts together"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help=f"--variant {CPU_VARIANT} --scale tiny"
    )
    parser.add_argument("--scale", choices=SIZE_NAMES, default="gpu", help="how large")
    parser.add_argument("--part", nargs="+", metavar="NAME", help="these parts only")
    parser.add_argument("--again", action="store_true", help="also parts that failed")
    parser.add_argument("--list", action="store_true", help="list the parts, and measure nothing")
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("gpu.work"))


def run(options: argparse.Namespace) -> None:
    size: SizeName = "tiny" if options.dry_run else options.scale
    variant = CPU_VARIANT if options.dry_run else options.variant or GPU_VARIANT
    parts = all_parts(SIZES[size])
    name = "gpu" if (size, variant) == ("gpu", GPU_VARIANT) else "gpu-trial"
    output = Path(options.output)
    if name != "gpu" and output == RESULTS:
        # Those are the published results.
        output = options.work
    work = options.work / f"{size}-{variant}"
    state = Run(size, variant, output / name, work, options.command)
    if options.list:
        rows = [[each.name, _state(state, each), f"{each.seconds:.0f}"] for each in parts]
        print(Table(["part", "state", "at most, s"], rows, left=2).text())
        return
    chosen = _chosen(parts, options.part)
    _check_variant(variant)

    def show() -> None:
        found = {part.name: state.record(part) for part in parts}
        records = {name: record for name, record in found.items() if record is not None}
        if records:
            write_bytes(output / f"{name}.md", page(parts, records).encode())

    try:
        with interruptible():
            run_parts(chosen, state, 60 * options.minutes, options.again, show)
    except KeyboardInterrupt:
        raise LumitreeError("interrupted; the same command goes on") from None
    finally:
        show()
    due = [part.name for part in chosen if state.is_due(part)]
    print(f"wrote {output / name}.md; left: {', '.join(due) or 'nothing'}")


def _state(run: Run, part: Part) -> str:
    record = run.record(part)
    return "missing" if record is None else record["outcome"]


def _chosen(parts: list[Part], names: list[str] | None) -> list[Part]:
    known = {part.name for part in parts}
    if unknown := sorted(set(names or ()) - known):
        raise LumitreeError(f"no parts {', '.join(unknown)}; expected {', '.join(sorted(known))}")
    return [part for part in parts if names is None or part.name in names]


def _check_variant(variant: str) -> None:
    """Refuse, before any part, what no part could use."""
    if variant not in (CPU_VARIANT, GPU_VARIANT):
        raise LumitreeError(f"variant is {variant}; expected {GPU_VARIANT} or {CPU_VARIANT}")
    if variant == GPU_VARIANT and not nvidia("name"):
        try:
            ctypes.CDLL("libcuda.so.1")
        except OSError:
            raise LumitreeError(
                "no NVIDIA GPU was found, since its driver's libcuda.so.1 is missing; --dry-run "
                "runs all parts at tiny sizes on the CPU"
            ) from None
