"""The viewer: a web page that shows an asset."""

import dataclasses
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.core.backend import load_rgb
from lumitree.core.files import FilePath, check_writable, write_bytes
from lumitree.core.results import Result
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.turns import in_turn
from lumitree.errors import LumitreeError, shown
from lumitree.rendering.asset_cache import open_asset


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ViewResult(Result):
    """Result of `view`. In a notebook it shows the page.

    Attributes:
        luminaire: name of the luminaire.
        page: file that was written; None if none was.
        page_bytes: size of the page.
        html: text of the page.
    """

    luminaire: str
    page: Path | None
    page_bytes: int
    html: str = dataclasses.field(repr=False)

    def _repr_html_(self) -> str:
        from lumitree.output.viewer.page import notebook_frame

        return notebook_frame(self.html)


@in_turn
def view(asset: Asset | FilePath, output: FilePath | None = None) -> ViewResult:
    """Make a web page that shows an asset, and the illuminance around it.

    It shows what images show: the geometry; or the field; or the light field of an asset that has
    neither, blurred and hiding almost nothing. With geometry and a field it shows either.

    Rays are followed through glass and from metals. Other surfaces have the mean radiance
    that they send out, which is traced first: highlights on them do not move with the viewer.

    The page needs a browser with WebGL 2, and loads nothing from a network.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file.
        output: path of the HTML file to write. Default: no file is written.

    Returns:
        The page as `html`; in a notebook, the result shows it.

    Raises:
        LumitreeError: the asset cannot be read, or is too large for a browser; or the file has
            another ending than .html or .htm, or cannot be written.
    """
    if output is not None:
        if Path(output).suffix.lower() not in (".html", ".htm"):
            name = shown(repr(str(output)), 300)
            raise LumitreeError(f"page name {name} does not end in .html")
        check_writable(output)
    # The surfaces of geometry are traced, and directions go through Dr.Jit.
    load_rgb()
    from lumitree.output.viewer.page import make_page

    watch = Stopwatch()
    with watch.stage("load"):
        loaded = open_asset(asset)
    with watch.stage("page"):
        html = make_page(loaded)
        content = html.encode()
        if output is not None:
            write_bytes(output, content)
    return ViewResult(
        luminaire=loaded.luminaire,
        page=None if output is None else Path(output),
        page_bytes=len(content),
        html=html,
        **watch.costs(),
    )
