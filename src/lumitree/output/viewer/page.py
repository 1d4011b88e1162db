"""The page of the viewer: a template with the asset, style, scripts and shaders in it."""

import html
from importlib import resources

import matplotlib
import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.files import json_text
from lumitree.output.viewer.packing import pack_asset

# In the order in which they are run; all share one scope.
_SCRIPTS = ("gl.js", "field.js", "model.js", "irradiance.js", "camera.js", "interface.js")
_SHADERS = ("field", "model", "display", "irradiance", "walls")


def make_page(asset: Asset) -> str:
    """HTML text of a page that shows an asset; it loads nothing. Errors are as in `pack_asset`."""
    packed = pack_asset(asset)
    shaders = {name: _file(f"{name}.glsl") for name in _SHADERS}
    colours = matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3]
    colour_map = np.round(colours * 255).astype(int).ravel().tolist()
    parts = {
        "TITLE": html.escape(f"{asset.luminaire} - lumitree"),
        "STYLE": _file("style.css"),
        "ASSET": _json({**packed.description, "block": packed.block, "colours": colour_map}),
        "SHADERS": _json(shaders),
        "SCRIPT": "\n".join(_file(name) for name in _SCRIPTS),
    }
    # The parts are joined, and not replaced one after the other: a name may look like a place.
    pieces = _file("template.html").split("@@")
    return "".join(parts[piece] if index % 2 else piece for index, piece in enumerate(pieces))


def notebook_frame(page: str, height: int = 560) -> str:
    """HTML of an iframe that holds a page."""
    return (
        f'<iframe srcdoc="{html.escape(page)}" style="width:100%;height:{height}px;border:0" '
        'sandbox="allow-scripts" title="lumitree viewer"></iframe>'
    )


def _file(name: str) -> str:
    return (resources.files("lumitree.output.viewer") / "page" / name).read_text(encoding="utf-8")


def _json(value: object) -> str:
    """JSON that can stand in a script element: it has no `<`, so that it cannot end it."""
    return json_text(value).replace("<", "\\u003c")
