"""Printing of results."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from lumitree.errors import shown

if TYPE_CHECKING:
    from lumitree.core.results import Json, Result
    from lumitree.exports.export import ExportResult
    from lumitree.many.result import BakedLamp
    from lumitree.measure.design import DesignResult
    from lumitree.measure.illuminance import IlluminanceResult
    from lumitree.measure.photometry import PhotometryResult
    from lumitree.measure.preview import AssetPreviewResult, PreviewResult
    from lumitree.measure.receivers import AreaFigures, LampIlluminance

LONGEST_LINE = 1000
# Longest lists of lamps and shapes that are printed whole.
_MOST_LAMPS, _MOST_SHAPES = 100, 20
# Figures of a radiance field.
_OF_FIELD = ("tree_depth", "leaves", "nodes", "l_max", "law", "max_radiance")
# Names and units of figures.
_LABELS = {
    "dgp": "DGP",
    "ev": "exposure",
    "file_bytes": "file size",
    "lumens": "luminous flux",
    "ugr": "UGR",
    "ugr_of_lamps": "UGR of lamps",
    "watts": "radiant flux",
}
_UNITS = {
    "background": "cd/m²",
    "lumens": "lm",
    "max_radiance": "W/(m² sr)",
    "mean_radiance": "W/(m² sr)",
    "size": "in the unit of the lamp's file",
    "source_luminance": "cd/m²",
    "source_solid_angle": "sr",
    "vertical_illuminance": "lx",
    "watts": "W of R, G, B",
}


def print_lines(values: Json) -> None:
    """Print one line per value: name, value; values are below each other."""
    width = max([20, *map(len, values)])
    for name, value in values.items():
        print(f"{name:>{width}}  {shown(value, LONGEST_LINE)}")


def print_result(result: Result, opens: str | os.PathLike[str] | None = None) -> None:
    """Print a `Result`, and last what to open; see `print_open`."""
    print_report(result.to_json())
    print_open(opens)


def check_outputs(image: str, *buffers: str | None, page: bool = False) -> None:
    """Refuse an image, or OpenEXR files of layers and buffers, that cannot be written.

    Args:
        page: whether a page may be written in place of the image.
    """
    from lumitree.core.files import check_writable
    from lumitree.core.images import check_exr_name, check_image_name

    check_image_name(image, page=page)
    check_writable(image)
    for path in buffers:
        if path is not None:
            check_exr_name(path)
            check_writable(path)


def image_report(result: Result, image: str) -> Json:
    """Dictionary of a result whose image was written, with the name of the image."""
    report = result.to_json()
    costs = {name: report.pop(name) for name in ("seconds", "peak_memory_bytes")}
    return {**costs, "image": image, **report}


def print_open(path: str | os.PathLike[str] | None) -> None:
    """Print the last line of a command: the file or folder to look at; None prints nothing."""
    if path is not None:
        print(f"Open: {shown(path, LONGEST_LINE)}")


def print_photograph(report: Json) -> None:
    """Print the report of an image, with the exposure and white balance of its photograph."""
    ev, kelvin = report["ev"], report["white_balance"]
    balance = "off" if kelvin is None else f"{kelvin:,.0f} K"
    print_report({k: v for k, v in report.items() if k not in ("ev", "white_balance")})
    print_lines({"exposure": f"EV {ev:.1f} (less is brighter), white balance {balance}"})


def print_report(report: Json) -> None:
    """Print a dictionary of figures; nested dictionaries are flattened by one level."""
    flat: Json = {}
    for name, value in _used(report):
        if name == "seconds":
            flat |= {f"{stage} (s)": round(seconds, 1) for stage, seconds in value.items()}
        elif name == "irradiance":
            flat |= _irradiance_lines(value)
        elif isinstance(value, dict):
            flat |= {_label(key): _shown_value(key, item) for key, item in _used(value)}
        else:
            flat[_label(name)] = _shown_value(name, value)
    print_lines(flat)


def print_metrics(report: Json) -> None:
    """Print the mean metrics of an evaluation as a table."""
    views = "irradiance"
    if report["views"]:
        views = f"{len(report['views'])} views, {report['spp']:,} paths per pixel"
    rows = [(metric, _rounded(value, "")) for metric, value in report["metrics"].items()]
    _print_table(f"{shown(report['asset']['luminaire'])}: {views}", ("metric", "mean"), rows)
    _print_irradiance(report["irradiance"])
    for name in ("sheet", "irradiance_sheet"):
        if report[name] is not None:
            label = "contact sheet" if name == "sheet" else "irradiance"
            print(f"{label}: {shown(report[name], LONGEST_LINE)}")


def print_lamps(lamps: Sequence[BakedLamp]) -> None:
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


def _irradiance_lines(irradiance: Json) -> dict[str, str]:
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


def _print_irradiance(irradiance: Json | None) -> None:
    """The table of the faces, or a line that says that there is none."""
    if irradiance is None:
        print(
            "irradiance: not compared; that takes a luminaire, not a dataset, and "
            "--irradiance-paths above 0"
        )
        return
    rows = [
        (face, *(_with_error(values, name) for name in ("ratio", "rms")))
        for face, values in irradiance["faces"].items()
    ]
    heads = ("face", "ratio", "relative RMS error")
    _print_table("irradiance around the lamp, baked / explicit", heads, rows)
    # A comparison of two assets has none.
    if (flux := irradiance.get("flux")) is not None:
        from lumitree.core.photometry import flux_text

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
    return f"{value / 1e6:.1f} MB" if value >= 50_000 else f"{value / 1e3:.1f} kB"


def _used(report: Json) -> Iterable[tuple[str, Any]]:
    """Figures that are known; an asset without a field says nothing of one."""
    unused = _OF_FIELD if report.get("leaves") == 0 else ()
    return [(k, v) for k, v in report.items() if v is not None and k not in unused]


def _label(name: str) -> str:
    return _LABELS.get(name, name.removesuffix("_bytes").replace("_", " "))


def _shown_value(name: str, value: Any) -> str:
    """A figure by its name, with its unit: bytes in megabytes, noise in per cent."""
    if name.endswith("_bytes"):
        return _megabytes(value)
    if name == "noise" or name.endswith("_noise"):
        return f"{100 * value:.2g} %"
    if name == "ev":
        return f"EV {value:.1f}"
    text = _rounded(value, " x " if name in ("resolution", "size") else ", ")
    return f"{text} {_UNITS[name]}" if name in _UNITS else text


def _rounded(value: object, between: str) -> str:
    """Numbers with four digits, whole ones with all."""
    from lumitree.core.results import digits_text

    if isinstance(value, list):
        return between.join(_rounded(item, between) for item in value)
    if isinstance(value, float):
        return digits_text(value)
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else str(value)


def print_list(result: Json) -> None:
    """Print the built-in luminaires."""
    for name, item in result["luminaires"].items():
        size = " x ".join(f"{side:.3g}" for side in item["size"])
        print(f"{name:>20}  {item['description']}")
        print(
            f"{'':>20}  {item['triangles']:,} triangles, emitters: {item['emitters']}, of up to "
            f"{item['emitted_radiance']:.4g} W/(m² sr), {size} m, "
            f"{'media' if item['has_media'] else 'no media'}"
        )


def print_preview(result: PreviewResult | AssetPreviewResult) -> None:
    """Print the figures of a preview, and the shapes of a luminaire."""
    from lumitree.measure.preview import PreviewResult

    if not isinstance(result, PreviewResult):
        print_result(result, result.image)
        return
    watts = ", ".join(f"{value:.4g}" for value in result.flux.watts)
    errors = ", ".join(f"{value:.2g}" for value in result.flux.watts_error)
    highest = result.max_radiance
    lines = {
        "luminaire": result.luminaire,
        "triangles": f"{result.triangles:,}",
        "emitters": result.emitters,
        **({} if highest is None else {"L_max": f"{highest:.4g} W/(m² sr)"}),
        "exposure": f"EV {result.ev:.1f}",
        "size": _shown_value("size", list(result.size)),
        "media": "yes" if result.has_media else "no",
        "flux": f"{result.flux} (if lengths are in metres)",
        "flux R, G, B": f"{watts} ± {errors} W",
    }
    for item in result.bounces or ():
        name = f"beyond {item.path_depth} bounces"
        lines[name] = f"{100 * item.share:.2g} ± {100 * item.error:.1g} % of the flux"
    print_lines(lines)
    for shape in result.shapes[:_MOST_SHAPES]:
        print_lines({"shape": shape})
    if (more := len(result.shapes) - _MOST_SHAPES) > 0:
        print_lines({"shapes": f"{more:,} more; --json writes all"})
    print_open(result.image)


def print_exported(result: ExportResult) -> None:
    """Print the figures of an export, and what is not carried over."""
    report = result.to_json()
    report["files"] = len(result.files)
    for line in report.pop("not_carried_over"):
        print(f"note: {line}")
    print_report(report)
    print_open(result.file)


def print_illuminance(result: IlluminanceResult, outputs: Sequence[str]) -> None:
    """Print the illuminance of each area."""
    from lumitree.measure.photometric_figures import Estimate

    rows = []
    for area in result.areas:
        mean = str(Estimate(area.mean, area.mean_error))
        count = f"{area.count - area.enclosed:,}"
        ratios = (f"{area.uniformity:.3f}", f"{area.diversity:.3f}")
        extremes = (f"{area.smallest:.4g}", f"{area.largest:.4g}")
        rows.append((shown(area.name, 100), count, mean, *extremes, *ratios))
    heads = ("area", "points", "mean", "smallest", "largest", "U0", "Ud")
    kind = "direct illuminance, lx" if result.direct_only else "illuminance, lx"
    _print_table(kind, heads, rows)
    if result.by_lamp is not None:
        for area in (each for each in result.areas if each.enclosed < each.count):
            _print_lamps(area, result.by_lamp)
    if enclosed := sum(area.enclosed for area in result.areas):
        print(f"note: {enclosed:,} points are inside solids, and do not count")
    print_lines({f"{stage} (s)": round(value, 1) for stage, value in result.seconds.items()})
    print_open(next(iter(outputs), None))


def print_design(result: DesignResult, outputs: Sequence[str]) -> None:
    """Print the illuminance before, predicted and simulated, and the dim levels."""
    rows = []
    for area in result.areas:
        plane, columns = area.plane, (area.before, area.predicted, area.simulated)
        for name, wanted, digits in (
            ("mean", plane.target, ".4g"),
            ("smallest", plane.minimum, ".4g"),
            ("uniformity", plane.uniformity, ".3f"),
            ("largest", plane.maximum, ".4g"),
        ):
            found = (f"{getattr(each, name):{digits}}" for each in columns)
            rows.append(
                (shown(area.before.name, 100), name, f"{wanted:g}" if wanted else "", *found)
            )
    heads = ("area", "lx", "needed", "before", "predicted", "simulated")
    _print_table("illuminance", heads, rows)
    lamps = []
    for lamp in result.lamps:
        place = ", ".join(f"{each:.3g}" for each in lamp.placement.at or ())
        lamps.append((shown(lamp.label, 100), f"{lamp.level:.3f}", f"{lamp.lumens:,.0f}", place))
    _print_table("lamps", ("lamp", "level", "lm", "at"), lamps)
    unit, before = result.unit, result.cost_before
    print_lines(
        {
            "all lamps": f"{result.cost:,.0f} {unit}, before {before:,.0f} {unit}",
            "one level for all": f"{result.cost_of_equal_levels:,.0f} {unit} for the same minimum",
            **{f"{stage} (s)": round(value, 1) for stage, value in result.seconds.items()},
        }
    )
    print_open(next(iter(outputs), None))


def _print_lamps(area: AreaFigures, lamps: LampIlluminance) -> None:
    """Print the mean illuminance of an area by each lamp."""
    rows = []
    for name, direct, reflected in zip(lamps.names, *lamps.means(area), strict=True):
        share = (direct + reflected) / area.mean if area.mean > 0 else 0.0
        rows.append((shown(name, 60), f"{direct:.4g}", f"{reflected:.4g}", f"{100 * share:.1f} %"))
    heads = ("lamp", "direct", "reflected", "of the mean")
    _print_table(f"{shown(area.name, 100)}: mean by lamp, lx", heads, rows)


def print_photometry(result: PhotometryResult) -> None:
    """Print the photometric figures, and the distance of the far field."""
    from lumitree.measure.photometric_figures import NEAR_FIELD_HEADER, figure_rows, near_field_rows

    rows = figure_rows(result, result.size, result.step, result.rays, result.ugr)
    details = {name.replace("_", " "): text for name, text in result.details.items()}
    print_lines({"luminaire": result.luminaire, **details, **dict(rows)})
    if result.near_field:
        title = "far field, intensity / distance², within 5 %"
        _print_table(title, NEAR_FIELD_HEADER, near_field_rows(result.near_field))
        if not all(limit.is_known for limit in result.near_field):
            print(f"note: for directions with too few rays trace more: --paths {4 * result.rays}")
    for path in result.files:
        print(f"written: {shown(path, LONGEST_LINE)}")
    # A report, if there is one.
    reports = [path for path in result.files if path.suffix.lower() in (".html", ".pdf")]
    print_open(next(iter((*reports, *result.files)), None))


def _print_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # Not strings, in which rich would interpret markup.
    table = Table(title=Text(title))
    for index, heading in enumerate(heads):
        table.add_column(heading, justify="right" if index else "left")
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)
