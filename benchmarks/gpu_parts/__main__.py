"""Process of one part: `python -m benchmarks.gpu_parts FILE`, with the file of its job."""

import json
import os
import sys
import traceback
from pathlib import Path

from benchmarks.gpu_parts.part import Context, SkippedError
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.sizes import SIZES


def main(job: Path) -> None:
    """Measure the part that a job names."""
    described = json.loads(job.read_text(encoding="utf-8"))
    sizes = SIZES[described["size"]]
    work, folder, state = (Path(described[name]) for name in ("work", "folder", "state"))
    context = Context(sizes, described["variant"], work, folder, state, described["end"])
    part = next(part for part in all_parts(sizes) if part.name == described["part"])
    try:
        context.report(part.measure(context), "done")
    except SkippedError as reason:
        context.report({}, "skipped", str(reason))


if __name__ == "__main__":
    code = 0
    try:
        main(Path(sys.argv[1]))
    except Exception:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # Libraries of GPUs may hang when a process ends.
    os._exit(code)
