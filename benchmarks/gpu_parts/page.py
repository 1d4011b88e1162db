"""The page that shows the records of all parts."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.gpu_parts.agreement import SIGNIFICANCE
from benchmarks.gpu_parts.part import Part
from benchmarks.gpu_parts.peaks import PEAKS, Peak, peak_of

Records = Mapping[str, dict[str, Any]]
# Entries of a training's history that are shown.
_SHOWN = 12


def page(parts: Sequence[Part], records: Records) -> str:
    """Markdown of all parts.

    Args:
        parts: in the order of the page.
        records: by the name of the part; of parts that were measured.
    """
    text = [_introduction(list(records.values())), _overview(parts, records)]
    for part in parts:
        record = records.get(part.name)
        if record is not None and record["values"]:
            text.append(f"## {part.title}\n\n{_section(part, record)}")
    text.append(_settings(list(records.values())))
    return "\n".join(text)


def is_of_gpu(records: Sequence[dict[str, Any]]) -> bool:
    """Whether all records were measured on a GPU, at its sizes."""
    return all(
        record["setting"]["variant"].startswith("cuda") and record["parameters"]["size"] == "gpu"
        for record in records
    )


def _introduction(records: Sequence[dict[str, Any]]) -> str:
    if not is_of_gpu(records):
        return (
            "# Trial of the benchmark of GPUs\n\n"
            "**These are not figures of a GPU.** They are of a CPU or of tiny sizes, and only test "
            "that each part runs: seconds, errors and agreements mean nothing beyond that.\n"
        )
    devices = sorted({record["setting"]["accelerator"] for record in records})
    return (
        f"# On a GPU\n\nMeasured on {', '.join(devices) or 'no GPU yet'}, in parts, each in a "
        "process of its own.\n"
    )


def _overview(parts: Sequence[Part], records: Records) -> str:
    rows = []
    for part in parts:
        record = records.get(part.name)
        if record is None:
            rows.append([part.name, "not measured yet", "", "", "", "", ""])
            continue
        rows.append(
            [
                part.name,
                record["outcome"],
                f"{record['reason']} " * bool(record["reason"]) + record["end_of_process"],
                f"{record['seconds']:.0f}",
                _gigabytes(record["peak_memory_bytes"]),
                _gigabytes(record["peak_gpu_bytes"]),
                record["setting"]["commit"],
            ]
        )
    heads = ["part", "outcome", "its process ended", "s", "peak GB", "GPU in use, GB", "commit"]
    table = Table(heads, [[_cell(cell) for cell in row] for row in rows], left=3)
    return table.markdown()


def _gigabytes(count: int | None) -> str:
    return "" if not count else f"{count / 1e9:.1f}"


def _cell(text: str) -> str:
    """Text for a cell of a table."""
    return text.replace("|", "\\|").replace("\n", " ")


def _section(part: Part, record: dict[str, Any]) -> str:
    try:
        return _content(part, record)
    except (KeyError, TypeError, ValueError) as error:
        # A value that is not finite, or a record of another version: the others are shown.
        return f"The values in {part.name}.json cannot be shown: {error!r}.\n"


def _content(part: Part, record: dict[str, Any]) -> str:
    values = record["values"]
    if part.name.startswith("tests-"):
        return _tests(values)
    if part.name == "training":
        return _training(values)
    if part.name == "extraction":
        return _extraction(values)
    if part.name == "step":
        return f"`{values['command']}`\n\n" + _step(
            values["values"], record["setting"]["accelerator"]
        )
    if "tables" in values:
        return f"`{values['command']}`\n\n" + "\n".join(values["tables"])
    if "values" in values:
        return _of_paper(values)
    return _agreements(values)


def _agreements(values: dict[str, Any]) -> str:
    rows = []
    for name, each in values.items():
        figures = [f"{each['not_finite']} values are not finite", "", ""]
        if not each["not_finite"]:
            figures = [f"{each['largest_z']:.2f}", f"{each['p']:.2g}"]
            figures.append(f"{each['ratio']:.4f} ± {each['ratio_error']:.2g}")
        verdict = "agrees" if each["agrees"] else "**differs**"
        rows.append([name, verdict, str(each["quantities"]), *figures])
    heads = [
        "what",
        f"at p ≥ {SIGNIFICANCE:g}",
        "quantities",
        "largest difference, standard errors",
    ]
    return Table([*heads, "p", "sum, device / CPU"], rows, left=2).markdown()


def _tests(values: dict[str, Any]) -> str:
    counts = ", ".join(f"{count} {name}" for name, count in values["counts"].items() if count)
    text = f"{counts or 'none'}; {values['seconds']:.0f} s.\n"
    for how in values["ends"]:
        text += f"\n* pytest: {how}"
    for failure in values["failures"]:
        text += f"\n* {failure['outcome']}: `{failure['test']}`: {failure['message']}"
    return text + "\n"


def _training(values: dict[str, Any]) -> str:
    text = (
        f"{values['steps']:,} of {values['planned']:,} steps in {values['seconds']:.0f} s, "
        f"{values['rays_per_second'] / 1e3:.0f} thousand rays a second; held-out rays of the "
        f"training views: {values['psnr']:.2f} dB, black {values['psnr_black']:.2f} dB.\n\n"
    )
    history = values["history"]
    stride = max(1, -(-len(history) // _SHOWN))
    chosen = history[::-1][::stride][::-1]
    rows = [[f"{e['step']:,}", f"{e['seconds']:.0f}", f"{e['psnr']:.2f}"] for e in chosen]
    return text + Table(["steps", "s", "PSNR, dB"], rows, left=0).markdown()


def _extraction(values: dict[str, Any]) -> str:
    rows = [
        [
            str(each["depth"]),
            str(each["samples_per_leaf"]),
            f"{each['leaves']:,}",
            f"{each['bytes'] / 1e6:.1f}",
            f"{each['seconds']:.1f}",
        ]
        for each in values["octrees"]
    ]
    heads = ["depth", "positions a leaf", "leaves", "MB", "s"]
    table = Table(heads, rows, left=0).markdown()
    return f"After {values['steps']:,} steps of training.\n\n{table}"


def _step(values: dict[str, Any], accelerator: str) -> str:
    """A row for each network, and the table of peaks."""
    peak = peak_of(accelerator)
    heads = ["network", "s a step", "GFLOP a step", "TFLOP/s", "of a 2048² product, TFLOP/s"]
    heads += ["share of it", "share of the TF32 peak", "share of the float32 peak"]
    rows = []
    for name, each in values.items():
        speed, product = each["flops_per_second"], each["peak_flops_per_second"]
        row = [name, f"{each['seconds']:.4f}", f"{each['flops'] / 1e9:.1f}", f"{speed / 1e12:.2f}"]
        row += [f"{product / 1e12:.2f}", f"{speed / product:.0%}"]
        rows.append([*row, *_shares(speed, peak)])
    peaks = [[each.name, f"{each.tf32:g}", f"{each.float32:g}"] for each in PEAKS]
    known = Table(["device", "TF32, dense, TFLOP/s", "float32, TFLOP/s"], peaks)
    return (
        f"{Table(heads, rows).markdown()}\nPeaks, by the makers' data sheets:\n\n{known.markdown()}"
    )


def _shares(speed: float, peak: Peak | None) -> list[str]:
    if peak is None:
        return ["not known", "not known"]
    return [f"{speed / (1e12 * value):.1%}" for value in (peak.tf32, peak.float32)]


def _of_paper(values: dict[str, Any]) -> str:
    """Errors of the network and of its octree on test views."""
    found = values["values"]
    methods = {name: found[name] for name in ("network", "octree")}
    rows = [[name, *(f"{each[name]:.4g}" for each in methods.values())] for name in found["octree"]]
    table = Table(["metric, on test views", *methods], rows)
    return f"`{values['command']}`, {values['seconds']:.0f} s\n\n{table.markdown()}"


def _settings(records: Sequence[dict[str, Any]]) -> str:
    """Machine, versions and command of the records, each once."""
    lines = []
    for record in records:
        facts = dict(record["setting"])
        command = facts.pop("command")
        facts.pop("commit")
        listed = ", ".join(f"{name} {value}" for name, value in facts.items())
        lines.append(f"* `{command}`: {listed}\n")
    return "## Machine\n\n" + "".join(dict.fromkeys(lines))
