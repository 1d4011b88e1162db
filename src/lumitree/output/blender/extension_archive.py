"""The extension for Blender as an archive, which Blender installs."""

import dataclasses
import io
import json
import zipfile
from importlib import resources
from pathlib import Path

import numpy as np

from lumitree._version import __version__
from lumitree.core.files import FilePath, check_writable, write_bytes
from lumitree.core.photometry import MAX_TEMPERATURE, MIN_TEMPERATURE, blackbody_colour
from lumitree.core.results import Result
from lumitree.core.stopwatch import Stopwatch
from lumitree.errors import LumitreeError, explained, shown

# Temperatures of the table of colours, equally spaced in 1/K: colours between them are exact to
# 0.01 % of the brightest channel.
_TEMPERATURES = 200
# Of all members of the archive, so that equal contents give equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BlenderExtensionResult(Result):
    """Result of `blender_extension`.

    Attributes:
        file: the archive.
        file_bytes: its size.
        version: of the extension, which is that of lumitree.
    """

    file: Path
    file_bytes: int
    version: str


@explained
def blender_extension(output: FilePath) -> BlenderExtensionResult:
    """Write the extension for Blender 4.2 and newer, as a `.zip` file that Blender installs.

    The extension imports assets, changes the flux and the colour temperature of lamps, and bakes
    selected objects as a lamp. It runs the program `lumitree`.

    Args:
        output: path of the file to write.

    Raises:
        LumitreeError: the name does not end in `.zip`, or the file cannot be written.
    """
    output = Path(output)
    if output.suffix != ".zip":
        raise LumitreeError(f"output {shown(repr(str(output)), 300)} does not end in .zip")
    check_writable(output)
    watch = Stopwatch()
    with watch.stage("write"):
        content = _archive()
        write_bytes(output, content)
    return BlenderExtensionResult(
        file=output, file_bytes=len(content), version=__version__, **watch.costs()
    )


def _archive() -> bytes:
    folder = resources.files("lumitree.output.blender.extension")
    files = {
        each.name: each.read_bytes()
        for each in folder.iterdir()
        if each.name.endswith((".py", ".toml"))
    }
    files["blackbody.json"] = json.dumps(_blackbody_table()).encode()
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name in sorted(files):
            member = zipfile.ZipInfo(name, _DATE)
            archive.writestr(member, files[name], zipfile.ZIP_DEFLATED)
    return content.getvalue()


def _blackbody_table() -> dict[str, list]:
    """What `extension.light` reads."""
    reciprocal = np.linspace(1 / MAX_TEMPERATURE, 1 / MIN_TEMPERATURE, _TEMPERATURES)
    colours = [blackbody_colour(float(1 / each)) for each in reciprocal]
    return {"reciprocal": reciprocal.tolist(), "colour": colours}
