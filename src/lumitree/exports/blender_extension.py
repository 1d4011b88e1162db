"""The extension for Blender as an archive, which Blender installs.

`integrations/blender` has its sources, and makes the archive beside this module.
"""

import dataclasses
from importlib import resources
from pathlib import Path

from lumitree._version import __version__
from lumitree.core.files import FilePath, check_writable, write_bytes
from lumitree.core.results import Result, Stopwatch
from lumitree.errors import LumitreeError, explained, shown


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BlenderExtensionResult(Result):
    """Result of `blender_extension`.

    Attributes:
        file: the archive.
        file_bytes: its size.
        version: of the extension, equal to lumitree's version.
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
        archive = resources.files("lumitree.exports") / "blender_files" / "lumitree-blender.zip"
        content = archive.read_bytes()
        write_bytes(output, content)
    return BlenderExtensionResult(
        file=output, file_bytes=len(content), version=__version__, **watch.costs()
    )
