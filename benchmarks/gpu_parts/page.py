"""The page that shows the records of all parts."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.gpu_parts.part import Part

_TRIAL = (
    "# Trial of the benchmark of GPUs\n\n"
    "**These are not figures of a GPU.** They are of a CPU or of tiny sizes, and only test "
    "that each part runs: seconds, errors and agreements mean nothing beyond that.\n"
)


def page(parts: Sequence[Part], records: Mapping[str, dict[str, Any]]) -> str:
    """Markdown of all parts.

    Args:
        parts: in the order of the page.
        records: by the name of the part; empty if it was not measured.
    """
    rows, sections = [], []
    settings: dict[str, None] = {}
    is_of_gpu, devices = True, set()
    for part in parts:
        record = records.get(part.name)
        if not record:
            rows.append([part.name, "not measured yet", "", "", ""])
            continue
        facts = record["setting"]
        is_of_gpu &= facts["variant"].startswith("cuda") and record["size"] == "gpu"
        devices.add(facts["accelerator"])
        reason = record["reason"].replace("|", "\\|").replace("\n", " ")
        rows.append(
            [part.name, record["outcome"], reason, f"{record['seconds']:.0f}", facts["commit"]]
        )
        listed = ", ".join(f"{k} {v}" for k, v in facts.items() if k not in ("command", "commit"))
        settings[f"* `{facts['command']}`: {listed}\n"] = None
        if record["values"]:
            sections.append(f"## {part.title}\n\n{_section(part, record['values'])}")
    head = f"# On a GPU\n\nMeasured on {', '.join(sorted(devices))}, in parts.\n"
    overview = Table(["part", "outcome", "reason", "s", "commit"], rows, left=3).markdown()
    machine = "## Machine\n\n" + "".join(settings)
    return "\n".join([head if is_of_gpu else _TRIAL, overview, *sections, machine])


def _section(part: Part, values: dict[str, Any]) -> str:
    try:
        return part.show(values)
    except (KeyError, TypeError, ValueError) as error:
        # A part may have ended early, or have values that are not finite. Other parts are shown.
        return f"The values in {part.name}.json cannot be shown: {error!r}.\n"
