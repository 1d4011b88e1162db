"""Commands that are killed at random moments: what they leave, and what the same command makes.

    python -m benchmarks kills [--kills 200] [--seed 0] [JOB ...]

Each job is a command of some seconds (`benchmarks/reliability/jobs.py`). It first runs twice
without a kill, which gives the files to compare with. Then it is ended by SIGKILL, up to `--chain`
times one after another, and continued by the same command until it ends; training is continued with
`--resume`. Of the kills, 60 % come in a write: when a temporary file appears, or up to 20 ms later;
the others at a random moment. All moments depend on the seed, but also on the machine's speed.

After each kill: every file of the output is that of the run without a kill, or it is a temporary
file or the state of the job; and what was done before is still done. After the end: the files are
those of the run without a kill, no temporary file is left, the inputs are unchanged, and no process
has printed a traceback or an error. What breaks a rule is a fault.

The trials are kept in `kills.json`, to which another call adds. Baseline: the time of all processes
of a trial over that of the command without a kill. Writes `kills.md` and `kills.json`.
"""

import argparse
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.reliability.jobs import JOBS, Job
from benchmarks.reliability.trial import PLACE, Reference, measure, prepare, run_trial
from lumitree.errors import LumitreeError


def table(report: dict[str, Any]) -> Table:
    """A line for each job."""
    heads = ["job", "kills", "in a write", "left by them", "trials", "faults", "equal", "time"]
    lines = []
    for name, reference in report["references"].items():
        trials = [each for each in report["trials"] if each["job"] == name]
        kills = [kill for trial in trials for kill in trial["kills"]]
        if not trials:
            continue
        seconds = sum(trial["seconds"] for trial in trials) / len(trials)
        lines.append(
            [
                name,
                str(len(kills)),
                str(sum(kill["mode"] == "in a write" for kill in kills)),
                str(sum(kill["left"] > 0 for kill in kills)),
                str(len(trials)),
                str(sum(len(trial["faults"]) for trial in trials)),
                "by bytes" if set(reference["agreement"]) <= {"bytes"} else "by values",
                f"{seconds / reference['seconds']:.1f}",
            ]
        )
    return Table(heads, lines, left=1)


def _in_turn(jobs: list[Job], wanted: int, stored: list[dict[str, Any]]) -> Iterator[Job]:
    """The jobs one after another, until so many kills are stored."""
    while True:
        for job in jobs:
            if sum(len(trial["kills"]) for trial in stored) >= wanted:
                return
            yield job


def _described(reference: Reference) -> dict[str, Any]:
    return {
        "seconds": round(reference.seconds, 3),
        "writes": reference.writes,
        "agreement": sorted(set(reference.agreement.values())),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    names = [job.name for job in JOBS]
    parser.add_argument(
        "jobs", metavar="JOB", nargs="*", help=f"of {', '.join(names)} (default: all)"
    )
    parser.add_argument("--kills", type=int, metavar="N", default=200, help="of all jobs together")
    parser.add_argument(
        "--chain", type=int, metavar="N", default=3, help="kills of one output, at most"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    jobs = [job for job in JOBS if not options.jobs or job.name in options.jobs]
    if len(jobs) < len(options.jobs):
        raise LumitreeError(f"no such job; expected some of {', '.join(j.name for j in JOBS)}")
    results = Results(options)
    report = results.stored({"references": {}, "trials": []})
    trials = report["trials"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs, place = folder / "inputs" / PLACE, folder / "trial" / PLACE
        prepare(inputs)
        references: dict[str, Reference] = {}
        for job in _in_turn(jobs, options.kills, trials):
            if job.name not in references:
                references[job.name] = measure(job, inputs, folder / job.name)
                report["references"][job.name] = _described(references[job.name])
            number = sum(each["job"] == job.name for each in trials)
            found = run_trial(
                job,
                references[job.name],
                inputs,
                place,
                f"{options.seed} {job.name} {number}",
                options.chain,
            )
            shutil.rmtree(place)
            trials.append({"job": job.name, "seed": options.seed, "number": number, **found})
            _write(results, report)
            line = "; ".join(found["faults"]) or "no fault"
            print(f"{job.name} {number}: {len(found['kills'])} kills, {line}", flush=True)
    print(table(report).text())


def _write(results: Results, report: dict[str, Any]) -> None:
    report["setting"] = facts = results.setting()
    results.write(report, f"# Killed commands\n\n{table(report).markdown()}\n{notes(facts)}")
