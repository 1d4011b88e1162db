"""All that has to be known about an NVIDIA GPU, in parts, in at most 14 minutes.

    python -m benchmarks gpu --minutes 14
    python -m benchmarks gpu --dry-run

The parts in order of worth: tests of kernels against reference implementations and of samplers by
χ²; images, irradiance and light fields on the GPU against the CPU by z-tests; costs of bakes and of
samples, baked, explicit and of a sphere, by the benchmark `illumination`; the tests of rendering;
and the network, trained by the paper's settings for the time that is left, with its octree and both
on test views. Each part runs in a process of its own with a limit of time, so that one which
crashes or hangs costs no other.

Every part writes its own file of `gpu/` into the results, and `gpu.md` shows them all. The same
command goes on with what is missing. Logs and intermediate data are kept in `--work`. `--dry-run`
runs all parts on the CPU at tiny sizes; its results are `gpu-trial.md` and `gpu-trial/` in the
folder of `--work`, unless `-o` names another, and are no figures of a GPU. Without a GPU there is
an error. The baseline is the CPU (`llvm_ad_rgb`). docs/how-to/gpu.md lists what has to be
installed.
"""

import argparse
import ctypes
from pathlib import Path

from benchmarks.common.results import RESULTS
from benchmarks.common.setting import nvidia
from benchmarks.common.tables import Table
from benchmarks.gpu_parts.page import page
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.running import Run, run_parts
from benchmarks.gpu_parts.sizes import SIZES
from lumitree.core.backend import CPU_VARIANT, GPU_VARIANT
from lumitree.core.files import write_bytes
from lumitree.core.interruption import interruptible
from lumitree.errors import LumitreeError

# The processes of the parts load Mitsuba, this one does not.
LOADS_MITSUBA = False


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--minutes", type=float, metavar="M", default=14.0, help="of all parts together"
    )
    parser.add_argument("--dry-run", action="store_true", help="tiny sizes on the CPU")
    parser.add_argument("--part", nargs="+", metavar="NAME", help="these parts only")
    parser.add_argument("--again", action="store_true", help="also parts that failed")
    parser.add_argument("--list", action="store_true", help="list the parts, and measure nothing")
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("gpu.work"))


def run(options: argparse.Namespace) -> None:
    size, variant = ("tiny", CPU_VARIANT) if options.dry_run else ("gpu", GPU_VARIANT)
    name, output = "gpu-trial" if options.dry_run else "gpu", Path(options.output)
    if options.dry_run and output == RESULTS:
        # Those are the published results.
        output = options.work
    parts = all_parts(SIZES[size])
    state = Run(size, variant, output / name, options.work / name, options.command)
    if options.list:
        rows = [
            [each.name, state.record(each).get("outcome", "missing"), f"{each.seconds:.0f}"]
            for each in parts
        ]
        print(Table(["part", "state", "at most, s"], rows, left=2).text())
        return
    known = {part.name for part in parts}
    if unknown := sorted(set(options.part or ()) - known):
        raise LumitreeError(f"no parts {', '.join(unknown)}; expected {', '.join(sorted(known))}")
    if not options.dry_run and not nvidia("name"):
        try:
            ctypes.CDLL("libcuda.so.1")
        except OSError:
            raise LumitreeError(
                "no NVIDIA GPU was found, since its driver's libcuda.so.1 is missing; --dry-run "
                "runs all parts at tiny sizes on the CPU"
            ) from None
    chosen = [part for part in parts if options.part is None or part.name in options.part]

    def show() -> None:
        records = {part.name: state.record(part) for part in parts}
        write_bytes(output / f"{name}.md", page(parts, records).encode())

    output.mkdir(parents=True, exist_ok=True)
    try:
        with interruptible():
            run_parts(chosen, state, 60 * options.minutes, options.again, show)
    except KeyboardInterrupt:
        raise LumitreeError("interrupted; the same command goes on") from None
    finally:
        show()
    due = [part.name for part in chosen if state.is_due(part)]
    print(f"wrote {output / name}.md; left: {', '.join(due) or 'nothing'}")
