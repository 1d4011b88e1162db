"""The index page of a folder of assets: HTML with relative links, thumbnails and polar curves."""

import html
import io
import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from PIL import Image

from lumitree.asset.asset import Asset
from lumitree.core.files import check_writable, write_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.many.result import BakedLamp

INDEX = "index.html"
# Folder of the thumbnails, within the assets' folder.
THUMBNAILS = "index-files"
# By this line a page is known as lumitree's.
_GENERATOR = '<meta name="generator" content="lumitree">'
_START_BYTES = 1000
# Pixels per side, and paths per pixel. On a CPU these are two equal passes of `rendering.passes`:
# passes of two sizes would compile two kernels for each lamp, which takes as long as the bake of a
# small one.
_PIXELS, _SAMPLES = 192, 28
_NOTES = {"interrupted": "interrupted; the same command continues", "waiting": "not baked yet"}
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #e7e5e4; background: #1c1917; }
p { color: #a8a29e; }
input { font: inherit; padding: 0.3rem 0.6rem; margin-bottom: 1.5rem; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr)); gap: 1.2rem; }
article { background: #292524; border-radius: 6px; overflow: hidden; }
article > div { aspect-ratio: 1; background: #000; display: grid; place-items: center; }
article > div img { width: 100%; height: 100%; object-fit: contain; }
section { padding: 0.7rem 1rem 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.05rem; margin: 0 0 0.4rem; }
a { color: #fcd34d; }
section img { width: 60%; display: block; margin: 0.6rem auto 0; }
dl { display: grid; grid-template-columns: auto 1fr; gap: 0 0.9rem; margin: 0; }
dd { margin: 0; text-align: right; }
.failed { color: #fca5a5; }
"""
_SEARCH = """
document.querySelector("input").oninput = event => {
  const text = event.target.value.toLowerCase();
  for (const each of document.querySelectorAll("article"))
    each.hidden = !each.textContent.toLowerCase().includes(text);
};
"""


def check_index(path: Path) -> None:
    """Refuse an index page that cannot be written, or that is not lumitree's."""
    check_writable(path)
    if not os.path.isfile(path):
        return
    with open(path, "rb") as file:
        start = file.read(_START_BYTES)
    if _GENERATOR.encode() not in start:
        raise LumitreeError(
            f"{shown(path, 300)} is not a page of lumitree; choose another folder, or move it"
        )


def write_thumbnail(folder: Path, name: str, asset: Asset) -> None:
    """Render the small image of a lamp for the page of its folder, and draw its polar curve."""
    from lumitree.rendering.studio import portrait
    from lumitree.viewer.polar import polar_svg

    stream, image = io.BytesIO(), portrait(asset, _PIXELS, _SAMPLES)
    Image.fromarray(image.pixels).save(stream, format="JPEG", quality=85)
    write_bytes(_thumbnail(folder, name), stream.getvalue())
    if curve := polar_svg(asset):
        write_bytes(_thumbnail(folder, name, "svg"), curve.encode())


def write_index(folder: Path, lamps: Sequence[BakedLamp]) -> None:
    """Write the page of a folder, with lamps in the given order."""
    title = html.escape(shown(folder.resolve().name or "lamps", 200))
    cards = "\n".join(_card(folder, lamp) for lamp in lamps)
    states = [lamp.state for lamp in lamps]
    counts = [f"{states.count(key):,} {key}" for key in ("failed", *_NOTES) if key in states]
    summary = counted(len(lamps)) + (f" ({', '.join(counts)})" if counts else "")
    page = f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
{_GENERATOR}
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>{_STYLE}</style>
<h1>{title}</h1>
<p>{summary}. Flux and size: lm and m if lengths of the luminaire are in metres.</p>
<input type="search" placeholder="Search" aria-label="Search">
<main>
{cards}
</main>
<script>{_SEARCH}</script>
</html>
"""
    write_bytes(folder / INDEX, page.encode())


def lumens_text(lumens: float) -> str:
    """A luminous flux to three digits at least."""
    return f"{lumens:,.0f} lm" if lumens >= 100 else f"{lumens:.3g} lm"


def counted(count: int) -> str:
    """A number of lamps."""
    return f"{count:,} lamp{'' if count == 1 else 's'}"


def _thumbnail(folder: Path, name: str, kind: str = "jpg") -> Path:
    # Not beside the asset, where an image of this name may be the user's.
    return folder / THUMBNAILS / f"{name}.{kind}"


def _card(folder: Path, lamp: BakedLamp) -> str:
    name = html.escape(shown(lamp.name, 200))
    image, heading, rows, curve = "no image", name, "", ""
    if lamp.path is not None:
        heading = f'<a href="{html.escape(quote(lamp.path.name))}">{name}</a>'
        if _thumbnail(folder, lamp.name).exists():
            source = html.escape(f"{THUMBNAILS}/{quote(lamp.name)}.jpg")
            image = f'<img alt="{name}" src="{source}" loading="lazy">'
        if _thumbnail(folder, lamp.name, "svg").exists():
            source = html.escape(f"{THUMBNAILS}/{quote(lamp.name)}.svg")
            curve = f'<img alt="polar curve of {name}" src="{source}" loading="lazy">'
        figures = {
            "flux": lumens_text(lamp.lumens),
            "file": f"{lamp.file_bytes / 1e6:.2f} MB",
            "size": " x ".join(f"{side:.3g}" for side in lamp.size),
        }
        if lamp.irradiance_rms is not None:
            figures["irradiance error"] = f"{100 * lamp.irradiance_rms:.1f} % RMS"
        rows = "".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in figures.items())
    text = f"failed: {lamp.error}" if lamp.state == "failed" else _NOTES.get(lamp.state, "")
    kind = ' class="failed"' if lamp.state == "failed" else ""
    note = f"<div{kind}>{html.escape(shown(text, 500))}</div>" if text else ""
    return (
        f"<article><div>{image}</div><section><h2>{heading}</h2>{note}<dl>{rows}</dl>"
        f"{curve}</section></article>"
    )
