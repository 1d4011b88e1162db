"""What commands print."""

from typing import Any

from lumitree.errors import shown

LONGEST_LINE = 1000


def print_lines(values: dict[str, Any]) -> None:
    """A line for each value, with its name before it."""
    for name, value in values.items():
        print(f"{name:>20}  {shown(value, LONGEST_LINE)}")


def print_result(result: Any) -> None:
    """The figures of a `Result`."""
    print_report(result.to_json())


def print_report(report: dict[str, Any]) -> None:
    """A report's figures, those of one level below beside them."""
    flat: dict[str, Any] = {}
    for name, value in report.items():
        if name == "seconds":
            flat |= {f"{stage} (s)": round(seconds, 1) for stage, seconds in value.items()}
        elif name.endswith("_bytes"):
            flat[name.removesuffix("_bytes").replace("_", " ")] = _megabytes(value)
        elif isinstance(value, dict):
            flat |= {
                key: _megabytes(item) if key.endswith("_bytes") else _rounded(item)
                for key, item in value.items()
            }
        elif value is not None:
            flat[name.replace("_", " ")] = _rounded(value)
    print_lines(flat)


def print_metrics(report: dict[str, Any]) -> None:
    """The table of an evaluation."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    name = shown(report["asset"]["luminaire"])
    # Text: a name may hold what rich takes for markup.
    table = Table(title=Text(f"{name}: {len(report['views'])} held-out views"))
    table.add_column("metric")
    table.add_column("mean", justify="right")
    for metric, value in report["metrics"].items():
        table.add_row(metric, f"{value:.4f}")
    Console().print(table)
    print(f"contact sheet: {shown(report['sheet'], LONGEST_LINE)}")


def _megabytes(value: int) -> str:
    return f"{value / 1e6:.1f} MB"


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, list):
        return ", ".join(str(_rounded(item)) for item in value)
    return value
