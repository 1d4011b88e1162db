"""Make the archive of the extension for Blender, which lumitree ships.

Run `python integrations/blender/make_archive.py` after each change of the extension. `--table`
writes the table of black bodies again, too, which needs lumitree.
"""

import io
import json
import sys
import zipfile
from pathlib import Path

FOLDER = Path(__file__).parent / "lumitree_blender"
ARCHIVE = Path(__file__).parents[2] / "src/lumitree/exports/blender_files/lumitree-blender.zip"
# Temperatures of the table, equally spaced in 1/K: interpolated colours are exact to 0.01 % of the
# brightest channel.
_TEMPERATURES = 200
# Date of all members, so that equal contents give equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


def archive() -> bytes:
    """The extension as a zip file; not compressed, so that its bytes depend on no library."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as file:
        for path in sorted(FOLDER.iterdir()):
            if path.suffix in (".py", ".toml", ".json"):
                # Line ends are "\n", also in a working tree of Windows.
                text = path.read_text(encoding="utf-8")
                member = zipfile.ZipInfo(path.name, _DATE)
                member.create_system = 3
                file.writestr(member, text.encode())
    return content.getvalue()


def blackbody_table() -> dict[str, list]:
    """The table that `lumitree_blender.light` reads."""
    from lumitree.core.photometry import MAX_TEMPERATURE, MIN_TEMPERATURE, blackbody_colour

    ends = (1 / MAX_TEMPERATURE, 1 / MIN_TEMPERATURE)
    step = (ends[1] - ends[0]) / (_TEMPERATURES - 1)
    reciprocal = [ends[0] + i * step for i in range(_TEMPERATURES - 1)] + [ends[1]]
    colours = [blackbody_colour(1 / each) for each in reciprocal]
    digits = [[float(f"{channel:.7g}") for channel in colour] for colour in colours]
    return {"reciprocal": [float(f"{each:.7g}") for each in reciprocal], "colour": digits}


if __name__ == "__main__":
    if "--table" in sys.argv[1:]:
        table = json.dumps(blackbody_table())
        (FOLDER / "blackbody.json").write_text(f"{table}\n", encoding="utf-8", newline="\n")
    ARCHIVE.write_bytes(archive())
