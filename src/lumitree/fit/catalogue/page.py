"""The pages of a folder of assets: HTML files with relative links, which can be opened as files."""

import dataclasses
import html
import json
from collections.abc import Iterator, Sequence
from importlib import resources
from urllib.parse import quote

from lumitree.errors import shown
from lumitree.fit.catalogue.folder import FOLDER_FILES, FolderLamp
from lumitree.fit.catalogue.record import INDEX_FILES, BakedLamp

INDEX = "index.html"
LAMPS_A_PAGE = 200
# By this line a page is known as lumitree's.
GENERATOR = '<meta name="generator" content="lumitree">'
SEARCH, NAMES = "search.js", "names.js"
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #e7e5e4; background: #1c1917; }
h1 { font-size: 1.4rem; margin-bottom: 0; }
p { color: #a8a29e; margin: 0 0 1.5rem; }
nav { display: flex; flex-wrap: wrap; gap: 0.2rem 0.7rem; margin: 0 0 1.5rem; }
input { font: inherit; color: inherit; background: #292524; border: 1px solid #57534e;
        border-radius: 4px; padding: 0.3rem 0.6rem; width: 20rem; max-width: 100%;
        margin-bottom: 1.5rem; }
main, #found { display: grid; grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr));
               gap: 1.2rem; }
main[hidden], #found[hidden] { display: none; }
article { background: #292524; border-radius: 6px; overflow: hidden; }
article > div { aspect-ratio: 1; background: #000; display: grid; place-items: center;
                color: #78716c; }
article > div img { width: 100%; height: 100%; object-fit: contain; }
section { padding: 0.7rem 1rem 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.05rem; margin: 0 0 0.4rem; }
a { color: #fcd34d; }
dl { display: grid; grid-template-columns: auto 1fr; gap: 0 0.9rem; margin: 0; }
dt { color: #a8a29e; }
dd { margin: 0; text-align: right; }
.failed { color: #fca5a5; }
"""


@dataclasses.dataclass(frozen=True)
class _Place:
    """Number of a page, from 1; number of all pages; prefix of links to the assets' folder."""

    number: int
    count: int
    root: str


def page_path(number: int) -> str:
    """Path of a page, relative to the folder of the assets."""
    return INDEX if number == 1 else f"{FOLDER_FILES}/{number}.html"


def folder_pages(title: str, lamps: Sequence[FolderLamp]) -> Iterator[tuple[str, bytes]]:
    """Paths and contents of the pages, the list of names and the script that searches in it."""
    count = max(1, -(-len(lamps) // LAMPS_A_PAGE))
    summary = _summary(lamps)
    for number in range(1, count + 1):
        own = lamps[(number - 1) * LAMPS_A_PAGE : number * LAMPS_A_PAGE]
        place = _Place(number, count, "" if number == 1 else "../../")
        yield page_path(number), _page(title, summary, own, place)
    yield f"{FOLDER_FILES}/{NAMES}", _names(lamps)
    script = resources.files("lumitree.fit.catalogue") / "static" / SEARCH
    yield f"{FOLDER_FILES}/{SEARCH}", script.read_bytes()


def lumens_text(lumens: float) -> str:
    """A luminous flux to three digits at least."""
    return f"{lumens:,.0f} lm" if lumens >= 100 else f"{lumens:.3g} lm"


def counted(count: int) -> str:
    """A number of lamps."""
    return f"{count:,} lamp{'' if count == 1 else 's'}"


def _summary(lamps: Sequence[FolderLamp]) -> str:
    states = [each.lamp.state for each in lamps]
    others = {"interrupted": "interrupted", "failed": "failed", "waiting": "not baked yet"}
    counts = [
        f"{states.count(state):,} {text}" for state, text in others.items() if state in states
    ]
    return counted(len(lamps)) + (f" ({', '.join(counts)})" if counts else "")


def _page(title: str, summary: str, lamps: Sequence[FolderLamp], place: _Place) -> bytes:
    name = html.escape(shown(title, 200))
    notes = (
        "Flux and size: if lengths of the luminaire are in metres, lm and m. Irradiance error: "
        "relative RMS error of the irradiance around the lamp."
    )
    cards = "\n".join(_card(each, place.root) for each in lamps)
    return f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
{GENERATOR}
<meta name="viewport" content="width=device-width">
<title>{name}</title>
<style>{_STYLE}</style>
<body data-root="{place.root}">
<h1>{name}</h1>
<p><span id="count">{summary}.</span> {notes}</p>
{_navigation(place)}
<input type="search" placeholder="Search in all lamps" aria-label="Search in all lamps" hidden>
<div id="found" hidden></div>
<main>
{cards}
</main>
<script src="{place.root}{FOLDER_FILES}/{SEARCH}"></script>
</body>
</html>
""".encode()


def _navigation(place: _Place) -> str:
    if place.count == 1:
        return ""
    links = " ".join(
        f"<b>{number}</b>"
        if number == place.number
        else f'<a href="{place.root}{page_path(number)}">{number}</a>'
        for number in range(1, place.count + 1)
    )
    return f"<nav>Pages {links}</nav>"


def _card(each: FolderLamp, root: str) -> str:
    lamp = each.lamp
    name = html.escape(shown(lamp.name, 200))
    image = "no image"
    if each.image is not None:
        source = html.escape(f"{root}{INDEX_FILES}/{quote(each.image)}")
        image = f'<img alt="{name}" src="{source}" loading="lazy">'
    heading = name
    if lamp.path is not None:
        heading = f'<a href="{html.escape(root + quote(lamp.path.name))}">{name}</a>'
    rows = "".join(
        f"<dt>{html.escape(key)}</dt><dd>{html.escape(value)}</dd>" for key, value in _rows(lamp)
    )
    text = _note(lamp)
    kind = ' class="failed"' if lamp.state == "failed" else ""
    note = f"<div{kind}>{html.escape(shown(text, 500))}</div>" if text else ""
    return (
        f"<article><div>{image}</div><section><h2>{heading}</h2>{note}<dl>{rows}</dl></section>"
        "</article>"
    )


def _note(lamp: BakedLamp) -> str:
    """State of a lamp, if it is not simply complete."""
    notes = {
        "failed": f"failed: {lamp.error}",
        "interrupted": "interrupted; the same command continues",
        "waiting": "not baked yet",
    }
    return notes.get(lamp.state, "")


def _rows(lamp: BakedLamp) -> list[tuple[str, str]]:
    """Names and values of a lamp's figures; see `fit.catalogue.record.LampRecord`."""
    figures = lamp.figures
    if not figures:
        return []
    error = figures.get("irradiance_rms")
    return [
        ("flux", lumens_text(figures["lumens"])),
        ("file", f"{figures['file_bytes'] / 1e6:.2f} MB"),
        ("bake", f"{lamp.seconds:,.0f} s"),
        ("irradiance error", "not compared" if error is None else f"{100 * error:.1f} %"),
        ("size", " x ".join(f"{side:.3g}" for side in figures["size"])),
    ]


def _names(lamps: Sequence[FolderLamp]) -> bytes:
    """A script with the list in which the pages search: what `card` of `SEARCH` shows."""
    rows = []
    for each in lamps:
        lamp = each.lamp
        suffix = "" if each.image is None else each.image.rpartition(".")[2]
        flux = lumens_text(lamp.figures["lumens"]) if lamp.figures else ""
        text = "; ".join(part for part in (flux, shown(_note(lamp), 200)) if part)
        rows.append([lamp.name, suffix, int(lamp.path is not None), text])
    text = json.dumps(rows, separators=(",", ":"))
    return f"window.lumitreeLamps={text};\n".encode()
