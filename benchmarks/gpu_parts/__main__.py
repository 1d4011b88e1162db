"""Process of one part: `python -m benchmarks.gpu_parts FILE`, with the file of its job."""

import json
import os
import signal
import sys
import threading
import time
import traceback
from pathlib import Path

from benchmarks.gpu_parts.part import Context, SkippedError, UnfinishedError, read_json
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.sizes import SIZES


def main(job: Path) -> None:
    """Measure the part that a job names."""
    described = json.loads(job.read_text(encoding="utf-8"))
    sizes = SIZES[described["size"]]
    context = Context(
        sizes=sizes,
        variant=described["variant"],
        work=Path(described["work"]),
        folder=Path(described["folder"]),
        state=Path(described["state"]),
        end=described["end"],
    )
    part = next(part for part in all_parts(sizes) if part.name == described["part"])
    try:
        context.report(part.measure(context), "done")
    except SkippedError as reason:
        context.report({}, "skipped", str(reason))
    except UnfinishedError as reason:
        context.report(read_json(context.state).get("values", {}), "unfinished", str(reason))


def end_with(parent: int) -> None:
    """End this process and what it has started when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(1)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    threading.Thread(target=end_with, args=[os.getppid()], daemon=True).start()
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
