"""The kind and the encoding of a file, by its first bytes and its suffix."""

import codecs
import os
import re
from pathlib import Path

ASSET, EXR = "a lumitree asset", "an OpenEXR image"
SCENE, XML = "a Mitsuba scene", "an XML file"
TM33 = "a photometric file (IES TM-33)"
# First bytes.
_STARTS = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"v/1\x01": EXR,
    b"#?RADIANCE": "a Radiance HDR image",
    b"#?RGBE": "a Radiance HDR image",
    b"GIF8": "a GIF image",
    b"II*\x00": "a TIFF image",
    b"MM\x00*": "a TIFF image",
    b"%PDF": "a PDF document",
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b": "a gzip archive",
    b"glTF": "a glTF model",
    b"ply": "a PLY mesh",
    b"BLENDER": "a Blender file",
    b"TM25": "a ray file (IES TM-25)",
    b"IESNA": "a photometric file (IES LM-63)",
    b"IES:LM-63": "a photometric file (IES LM-63)",
}
_SUFFIXES = {
    ".lumitree": ASSET,
    ".ies": "a photometric file (IES LM-63)",
    ".ldt": "a photometric file (EULUMDAT)",
    ".ray": "a ray file (IES TM-25)",
    ".tm25ray": "a ray file (IES TM-25)",
    ".tm33": TM33,
    ".gldf": "a GLDF file",
    ".l3d": "an L3D model, which has no intensities: give the GLDF file that it belongs to",
    ".obj": "an OBJ model",
    ".mtl": "a material file of an OBJ model",
    ".gltf": "a glTF model",
    ".glb": "a glTF model",
    ".fbx": "an FBX model",
    ".dae": "a COLLADA model",
    ".stl": "an STL mesh",
    ".toml": "a TOML file",
    ".json": "a JSON file",
}
_LOOKED_AT = 1 << 12
# Text that may precede the root of XML; and roots of IES TM-33 and UNI 11733.
_PROLOGUE = re.compile(rb"<\?.*?\?>|<!--.*?-->|\s+", re.DOTALL)
_TM33_ROOT = re.compile(rb"<([\w.-]+:)?(IESTM33[\w.-]*|LuminaireOpticalData)[\s/>]")


def what_it_is(path: str | os.PathLike[str], content: bytes | None = None) -> str | None:
    """The kind of a file, such as "a PNG image"; None if it cannot be found.

    Args:
        path: a file or folder that exists; only regular files are opened.
        content: of the file, if it has been read.
    """
    path = Path(path)
    if os.path.isdir(path):
        return "a folder"
    if not os.path.isfile(path):
        return None
    if content is None:
        with path.open("rb") as file:
            content = file.read(_LOOKED_AT)
    start = content[:_LOOKED_AT].removeprefix(b"\xef\xbb\xbf")
    if not start:
        return "an empty file"
    by_suffix = _SUFFIXES.get(path.suffix.lower())
    for first, kind in _STARTS.items():
        if start.startswith(first):
            is_zip = first == b"PK\x03\x04" and path.suffix.lower() in (".gldf", ".l3d")
            return by_suffix if is_zip else kind
    if (text := in_utf8(start).lstrip()).startswith(b"<"):
        if _is_tm33(text):
            return TM33
        if b"<scene" in start:
            return SCENE
        return "a web page" if b"<html" in start.lower() else XML
    return "a text file" if by_suffix in (None, ASSET) and _is_text(start) else by_suffix


def _is_tm33(text: bytes) -> bool:
    """Whether XML begins as a file of IES TM-33 does."""
    at = 0
    while (skipped := _PROLOGUE.match(text, at)) is not None:
        at = skipped.end()
    return _TM33_ROOT.match(text, at) is not None


def _is_text(start: bytes) -> bool:
    try:
        # A character of several bytes may be cut at the end.
        text = codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return False
    return all(char.isprintable() or char.isspace() for char in text)


# UTF-16 without a byte order mark is recognised by this part of a file.
_PROBE = 400


def in_utf8(content: bytes) -> bytes:
    """The text of a file without its byte order mark, lines ending in \\n.

    UTF-16, with or without a byte order mark, becomes UTF-8. Other encodings are left: UTF-8, or
    one of single bytes.
    """
    if (encoding := utf16_encoding(content)) is not None:
        content = content.decode(encoding, "replace").encode("utf-8", "replace")
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in content:
        # Some programs write \r\r\n.
        content = content.replace(b"\r\r\n", b"\n").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


def utf16_encoding(content: bytes) -> str | None:
    """Name of the encoding of UTF-16, with or without a byte order mark; None for others."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    start = content[:_PROBE]
    if start.count(0) <= len(start) / 4:
        return None
    # ASCII in UTF-16: every other byte is 0.
    return "utf-16-le" if start[1::2].count(0) > start[::2].count(0) else "utf-16-be"
