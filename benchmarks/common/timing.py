"""Times of jobs that take turns, so that a machine's changes of speed meet all of them alike."""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, Literal

ClockName = Literal["wall", "cpu"]
# A job takes the number of the round, prepares it, and returns the call that is timed.
Job = Callable[[int], Callable[[], object]]

MIN_ROUNDS = 5


class Clock:
    """Seconds of a block, by the wall or of the processor (all cores together)."""

    def __init__(self) -> None:
        self._start = time.perf_counter(), time.process_time()

    def read(self) -> dict[ClockName, float]:
        """Seconds since the start, by both."""
        wall, cpu = self._start
        return {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def device_clock() -> ClockName:
    """CPU time, which other programs change little; wall time where a GPU does the work."""
    from lumitree.core.backend import GPU_VARIANT, load_mitsuba

    return "wall" if load_mitsuba().variant() == GPU_VARIANT else "cpu"


def interleaved(
    jobs: Mapping[str, Job], rounds: int = MIN_ROUNDS, clock: ClockName = "wall"
) -> dict[str, float]:
    """Median seconds of each job, by name, over rounds in which every job runs once.

    Round 0, in which kernels are compiled, comes before the others and is not timed.

    Raises:
        ValueError: there are fewer than 5 rounds.
    """
    if rounds < MIN_ROUNDS:
        raise ValueError(f"{rounds} rounds; expected at least {MIN_ROUNDS}")
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for index in range(rounds + 1):
        for name, job in jobs.items():
            timed = job(index)
            start = Clock()
            timed()
            seconds[name].append(start.read()[clock])
    return {name: statistics.median(values[1:]) for name, values in seconds.items()}


def kernel(record: Callable[[], Any]) -> Job:
    """Job that times the kernel of Dr.Jit arrays, without the time for recording it.

    Args:
        record: returns arrays that are not evaluated yet.
    """
    import drjit as dr

    def prepare(_: int) -> Callable[[], object]:
        arrays = record()
        dr.sync_thread()

        def evaluate() -> None:
            dr.eval(arrays)
            dr.sync_thread()

        return evaluate

    return prepare


def ratios(times: Mapping[str, float], baseline: str) -> dict[str, float]:
    """Each time over the baseline's, by name."""
    return {name: value / times[baseline] for name, value in times.items()}
