"""The page that shows all tables: what is measured, where and with what, and the findings.

The findings are hand-written, in `notes/`; everything else is made from the cells.
"""

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

NOTES = Path(__file__).parent / "notes"
MODULES = (reconstruction, losses, harmonics, transmittance, equal_quality)
Section = Callable[[Found], str]
# Number of the section, its title, and what writes it, or the name of other results.
SECTIONS: tuple[tuple[int, str, Section | str], ...] = (
    (1, "Table 1: reconstruction", reconstruction.section),
    (2, "Table 2: terms of the loss", losses.section),
    (3, "Table 3: spherical harmonics", harmonics.section),
    (4, "Table 4: transmittance laws", transmittance.section),
    (5, "Table 5: equal quality", equal_quality.section),
    (6, "Table 6: against Zhu et al. 2021", "zhu"),
    (7, "Against everything else", "representations"),
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


def write_page(path: Path, stores: dict[ScaleName, Store], results: Path) -> None:
    """Write the page.

    Args:
        path: of the Markdown file.
        stores: of the scales that it shows, by name.
        results: folder of the results of other benchmarks.
    """
    parts = [_note("introduction").rstrip() + "\n"]
    for number, title, content in SECTIONS:
        parts.append(f"## {title}\n")
        if note := _note(str(number)):
            parts.append(note.rstrip() + "\n")
        if isinstance(content, str):
            parts.append(_other(content, results, path))
        else:
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


def _note(name: str) -> str:
    path = NOTES / f"{name}.md"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _other(benchmark: str, results: Path, page: Path) -> str:
    """The first table of another benchmark's results, its pictures, and a link to them."""
    path = results / f"{benchmark}.md"
    if not path.is_file():
        return f"No results of `{benchmark}`.\n"
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("|"))
    end = next((i for i in range(start, len(lines)) if not lines[i].startswith("|")), len(lines))
    link = f"[its results](../benchmarks/results/{benchmark}.md)"
    text = f"By a program that is in git, at the commit that {link} state.\n\n"
    text += "\n".join(lines[start:end]) + "\n"
    for picture in sorted(results.glob(f"{benchmark}*.png")):
        write_bytes(page.parent / "images" / "paper" / picture.name, picture.read_bytes())
        text += f"\n![{picture.stem}](images/paper/{picture.name})\n"
    return text
