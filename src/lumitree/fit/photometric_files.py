"""Bakes of photometric files and ray files."""

from pathlib import Path

from lumitree.core.arguments import check_asset_output, check_light
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as steps
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeError, shown
from lumitree.fit.result import BakeResult
from lumitree.fit.work import save_asset
from lumitree.lamp.source import LuminaireSource, as_source, refuse_options, source_kind
from lumitree.trace.light_field_config import LightFieldConfig


@in_turn
def bake_photometric(
    file: FilePath | LuminaireSource,
    output: FilePath | None = None,
    *,
    light_field: LightFieldConfig | None = None,
    lumens: float | None = None,
    temperature: float | None = None,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> BakeResult:
    """Make an asset that has the light field of a photometric file or a ray file.

    Args:
        file: an IES or EULUMDAT file (`.ies`, `.ldt`); a GLDF file (`.gldf`), with # and a variant
            for another than the first; luminaire data of IES TM-33 (`.tm33`, `.xml`); or an IES
            TM-25 ray file (`.ray`, `.tm25ray`).
        output: path of the `.lumitree` file to write. Default: no file is written.
        light_field: cells and bins of direction of a ray file's light field. Those of another file
            depend on its intensities. Default: `LightFieldConfig()`.
        lumens: luminous flux of the asset, lm, 10⁻⁶ to 10⁹. Default: that of the file.
        temperature: colour temperature of the whole flux, K, 1000 to 20,000; see `BakeConfig`.
            Default: the colours of a ray file; R = G = B for the others.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The asset (`asset`) and its file (`path`).

    Raises:
        LumitreeError: an argument is out of range; the file cannot be read, or emits nothing; or
            the asset cannot be written.
    """
    if output is not None:
        check_asset_output(output)
    check_light(lumens, temperature)
    described = as_source(file)
    path = described.name
    if source_kind(described) != "photometric":
        raise LumitreeError(
            f"{shown(path, 300)} is not a photometric file; expected .ies, .ldt, .gldf, .tm33, "
            ".ray or .tm25ray"
        )
    refuse_options(described, "a photometric file")
    load_rgb(variant)
    from lumitree.formats.photometric_file import bake_file
    from lumitree.rendering.asset_flux import with_light

    watch = Stopwatch()
    with (
        reporting(progress),
        steps(f"light of {shown(Path(path).name)}", 1) as advance,
        watch.stage("light"),
    ):
        asset = bake_file(path, LightFieldConfig() if light_field is None else light_field)
        asset = with_light(asset, lumens, temperature)
        advance(1)
    return BakeResult(asset=asset, path=save_asset(asset, output), **watch.costs())
