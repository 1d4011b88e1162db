"""Printing of results."""

import os
from collections.abc import Sequence
from typing import Any

from lumitree.core.photometry import flux_text
from lumitree.errors import shown

LONGEST_LINE = 1000
# Longest list of lamps that is printed whole.
_MOST_LAMPS = 100
# Figures of a radiance field.
_OF_FIELD = ("tree_depth", "leaves", "nodes", "l_max", "law", "max_radiance")


def print_lines(values: dict[str, Any]) -> None:
    """Print one line per value: name, value."""
    for name, value in values.items():
        print(f"{name:>20}  {shown(value, LONGEST_LINE)}")


def print_result(result: Any, opens: str | os.PathLike[str] | None = None) -> None:
    """Print a `Result`, and last what to open; see `print_open`."""
    print_report(result.to_json())
    print_open(opens)


def check_outputs(image: str, *buffers: str | None) -> None:
    """Refuse an image, or OpenEXR files of layers and buffers, that cannot be written."""
    from lumitree.core.files import check_writable
    from lumitree.core.images import check_exr_name, check_image_name

    check_image_name(image)
    check_writable(image)
    for path in buffers:
        if path is not None:
            check_exr_name(path)
            check_writable(path)


def image_report(result: Any, image: str) -> dict[str, Any]:
    """Dictionary of a result whose image was written, with the name of the image."""
    report = result.to_json()
    costs = {name: report.pop(name) for name in ("seconds", "peak_memory_bytes")}
    return {**costs, "image": image, **report}


def print_open(path: str | os.PathLike[str] | None) -> None:
    """Print the last line of a command: the file or folder to look at; None prints nothing."""
    if path is not None:
        print(f"Open: {shown(path, LONGEST_LINE)}")


def print_report(report: dict[str, Any]) -> None:
    """Print a dictionary of figures; nested dictionaries are flattened by one level."""
    flat: dict[str, Any] = {}
    for name, value in report.items():
        if name == "seconds":
            flat |= {f"{stage} (s)": round(seconds, 1) for stage, seconds in value.items()}
        elif name.endswith("_bytes"):
            flat[name.removesuffix("_bytes").replace("_", " ")] = _megabytes(value)
        elif name == "irradiance":
            flat |= _irradiance_lines(value)
        elif isinstance(value, dict):
            # An asset without a field says nothing of one.
            unused = _OF_FIELD if value.get("leaves") == 0 else ()
            flat |= {
                key: _megabytes(item) if key.endswith("_bytes") else _rounded(item)
                for key, item in value.items()
                if item is not None and key not in unused
            }
        elif value is not None:
            flat[name.replace("_", " ")] = _rounded(value)
    print_lines(flat)


def print_metrics(report: dict[str, Any]) -> None:
    """Print the mean metrics of an evaluation as a table."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    name = shown(report["asset"]["luminaire"])
    views = "irradiance"
    if report["views"]:
        views = f"{len(report['views'])} views, {report['spp']:,} paths per pixel"
    # Not a string, in which rich would interpret markup.
    table = Table(title=Text(f"{name}: {views}"))
    table.add_column("metric")
    table.add_column("mean", justify="right")
    for metric, value in report["metrics"].items():
        table.add_row(metric, f"{value:.4f}")
    Console().print(table)
    _print_irradiance(report["irradiance"])
    for name in ("sheet", "irradiance_sheet"):
        if report[name] is not None:
            label = "contact sheet" if name == "sheet" else "irradiance"
            print(f"{label}: {shown(report[name], LONGEST_LINE)}")


def print_lamps(lamps: Sequence[Any]) -> None:
    """Print one line per `BakedLamp`; of more than 100 only those that are not complete."""
    from lumitree.many.page import counted, lumens_text

    complete = [lamp for lamp in lamps if lamp.state in ("baked", "kept")]
    shortened = len(lamps) > _MOST_LAMPS
    for lamp in lamps:
        if shortened and lamp.state in ("baked", "kept"):
            continue
        text = lamp.state if lamp.error is None else f"{lamp.state}: {lamp.error}"
        if lamp.path is not None:
            size = _megabytes(lamp.file_bytes)
            text += f", {lumens_text(lamp.lumens)}, {size}, {lamp.seconds:,.0f} s"
        print(f"{shown(lamp.name):>20}  {shown(text, LONGEST_LINE)}")
    if shortened:
        new = sum(lamp.state == "baked" for lamp in complete)
        size = sum(lamp.file_bytes for lamp in complete)
        print(f"{counted(new)} baked, {len(complete) - new:,} kept, {_megabytes(size)}")


def _irradiance_lines(irradiance: dict[str, Any]) -> dict[str, str]:
    """Lines of a bake: flux through a cube over the luminaire's, and RMS errors."""
    lines = {}
    if "irradiance_ratio" in irradiance:
        error = irradiance["ratio_error"]
        margin = "" if error is None else f" ± {error:.4f}"
        lines["irradiance, ratio"] = f"{irradiance['irradiance_ratio']:.4f}{margin}"
    for name, where in (("irradiance_rms", ""), ("irradiance_rms_touching", " touching")):
        if name in irradiance:
            lines[f"RMS error{where}"] = f"{100 * irradiance[name]:.1f} %"
    return lines


def _print_irradiance(irradiance: dict[str, Any] | None) -> None:
    """The table of the faces, or a line that says that there is none."""
    from rich.console import Console
    from rich.table import Table

    if irradiance is None:
        print(
            "irradiance: not compared; that takes a luminaire, not a dataset, and "
            "--irradiance-paths above 0"
        )
        return
    table = Table(title="irradiance around the lamp, baked / explicit")
    for heading in ("face", "ratio", "relative RMS error"):
        table.add_column(heading, justify="left" if heading == "face" else "right")
    for face, values in irradiance["faces"].items():
        table.add_row(face, *(_with_error(values, name) for name in ("ratio", "rms")))
    Console().print(table)
    # A comparison of two assets has none.
    if (flux := irradiance.get("flux")) is not None:
        print(f"flux: {flux_text(flux['light_paths'], flux['light_paths_error'])} by light paths")
        if flux["camera_paths"] is not None:
            text = flux_text(flux["camera_paths"], flux["camera_paths_error"])
            print(f"flux: {text} by camera paths that hit the emitters")


def _with_error(values: dict[str, float | None], name: str) -> str:
    value, error = values[name], values[f"{name}_error"]
    if value is None:
        return "not known"
    return f"{value:.4f}" + ("" if error is None else f" ± {error:.4f}")


def _megabytes(value: int) -> str:
    return f"{value / 1e6:.1f} MB"


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, list):
        return ", ".join(str(_rounded(item)) for item in value)
    return value
