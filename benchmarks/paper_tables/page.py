"""The page of all tables, with where and how each was measured. docs/paper.md has the findings."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.paper_tables import (
    costs,
    equal_quality,
    harmonics,
    losses,
    reconstruction,
    transmittance,
)
from benchmarks.paper_tables.cells import Cell, Found, Store
from benchmarks.paper_tables.scales import SCALES, Scale, ScaleName
from lumitree.core.files import write_bytes

MODULES = (reconstruction, losses, harmonics, transmittance, equal_quality)
Section = Callable[[Found], str]
# Number of the section, its title, and its writer.
SECTIONS: tuple[tuple[int, str, Section], ...] = (
    (1, "Table 1: reconstruction", reconstruction.section),
    (2, "Table 2: terms of the loss", losses.section),
    (3, "Table 3: spherical harmonics", harmonics.section),
    (4, "Table 4: transmittance laws", transmittance.section),
    (5, "Table 5: equal quality", equal_quality.section),
    (8, "Memory, precomputation, overhead", costs.section),
)
_TITLES: dict[ScaleName, str] = {
    "cpu": "CPU scale",
    "gpu": "Minutes of a GPU",
    "paper": "The paper's scale",
    "test": "Test scale",
}


def all_cells(scale: Scale) -> list[Cell]:
    """The cells of all tables at a scale, in the order in which they are measured."""
    return [cell for module in MODULES for cell in module.cells(scale)]


INTRODUCTION = """# The paper's tables: measurements

By `python -m benchmarks paper`. [The paper's tables](../../docs/paper.md) has the findings.
"""


def write_page(path: Path, stores: dict[ScaleName, Store]) -> None:
    """Write the page.

    Args:
        path: of the Markdown file.
        stores: of the scales that it shows, by name.
    """
    parts = [INTRODUCTION]
    for number, title, content in SECTIONS:
        parts.append(f"## {title}\n")
        shown = [_at_scale(number, content, *each, path) for each in stores.items()]
        parts += [each for each in shown if each]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, "\n".join(parts).encode())


def _at_scale(number: int, content: Section, name: ScaleName, store: Store, path: Path) -> str:
    found = Found(store, SCALES[name], path)
    records = found.records(number)
    own = number != 8  # which has no cells
    if name == "gpu" and not records:
        return ""
    if name == "paper" and not records:
        return f"{_TITLES[name]}: {found.missing}.\n"
    text = f"### {_TITLES[name]}, table {number}\n\n{content(found)}"
    return f"{text}\n{provenance(records)}" if own and records else text


def provenance(records: Iterable[dict[str, Any]]) -> str:
    """Where, with what, and how long the cells of a table were measured."""
    rows, settings = [], []
    for record in records:
        setting = record["setting"]
        peak = f"{record['peak_memory_bytes'] / 1e9:.1f}"
        rows.append([record["cell"], setting["commit"], f"{record['seconds']:.0f}", peak])
        versions = ", ".join(f"{key} {setting[key]}" for key in ("mitsuba", "jax", "python"))
        settings.append(
            f"* `{setting['command']}`; {setting['device']}, accelerator: "
            f"{setting['accelerator']}, {setting['variant']}, {versions}\n"
        )
    table = Table(["cell", "commit", "s", "peak GB"], rows).markdown()
    return f"Measured by:\n\n{''.join(dict.fromkeys(settings))}\n{table}"
