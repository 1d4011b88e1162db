"""The index page of a folder of assets: an HTML file that loads nothing, with relative links."""

import base64
import dataclasses
import html
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote

from lumitree.errors import shown

# By this line a page is known as lumitree's.
GENERATOR = '<meta name="generator" content="lumitree">'
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #e7e5e4; background: #1c1917; }
h1 { font-size: 1.4rem; margin-bottom: 0; }
p { color: #a8a29e; margin: 0 0 1.5rem; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr)); gap: 1.2rem; }
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
class Entry:
    """A lamp of the page.

    Attributes:
        name: of the lamp.
        link: name of its file in the folder of the page; None if there is none.
        image: PNG file; None if there is none.
        rows: names and values of its figures.
        note: state of the lamp, if it is not simply complete.
        failed: whether the note is an error.
    """

    name: str
    link: str | None
    image: bytes | None
    rows: Sequence[tuple[str, str]]
    note: str = ""
    failed: bool = False


def figure_rows(figures: dict[str, Any], seconds: float) -> list[tuple[str, str]]:
    """Names and values of a lamp's figures; see `fit.catalogue.record.LampRecord`."""
    error = figures.get("irradiance_rms")
    return [
        ("flux", lumens_text(figures["lumens"])),
        ("file", f"{figures['file_bytes'] / 1e6:.2f} MB"),
        ("bake", f"{seconds:,.0f} s"),
        ("irradiance error", "not compared" if error is None else f"{100 * error:.1f} %"),
        ("size", " x ".join(f"{side:.3g}" for side in figures["size"])),
    ]


def lumens_text(lumens: float) -> str:
    """A luminous flux to three digits at least."""
    return f"{lumens:,.0f} lm" if lumens >= 100 else f"{lumens:.3g} lm"


def index_page(title: str, entries: Sequence[Entry]) -> bytes:
    """The page as an HTML file."""
    name = html.escape(shown(title, 200))
    count = f"{len(entries)} lamp{'' if len(entries) == 1 else 's'}"
    notes = (
        "Flux and size: if lengths of the luminaire are in metres, lm and m. Irradiance error: "
        "relative RMS error of the irradiance around the lamp."
    )
    cards = "\n".join(map(_card, entries))
    return f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
{GENERATOR}
<meta name="viewport" content="width=device-width">
<title>{name}</title>
<style>{_STYLE}</style>
<h1>{name}</h1>
<p>{count}. {notes}</p>
<main>
{cards}
</main>
</html>
""".encode()


def _card(entry: Entry) -> str:
    name = html.escape(shown(entry.name, 200))
    image = "no image"
    if entry.image is not None:
        data = base64.b64encode(entry.image).decode()
        image = f'<img alt="{name}" src="data:image/png;base64,{data}">'
    heading = name
    if entry.link is not None:
        heading = f'<a href="{html.escape(quote(entry.link))}">{name}</a>'
    rows = "".join(
        f"<dt>{html.escape(key)}</dt><dd>{html.escape(value)}</dd>" for key, value in entry.rows
    )
    kind = ' class="failed"' if entry.failed else ""
    note = f"<div{kind}>{html.escape(shown(entry.note, 500))}</div>" if entry.note else ""
    return (
        f"<article><div>{image}</div><section><h2>{heading}</h2>{note}<dl>{rows}</dl></section>"
        "</article>"
    )
