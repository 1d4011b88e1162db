"""Text, XML and zip archives of luminaire data, read within limits; and messages about them.

XML is read without entities. Members of archives are read into memory; nothing is unpacked under a
name that an archive states. Both may be damaged or hostile.
"""

import datetime
import io
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from lumitree.core.file_kinds import in_utf8, utf16_encoding
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown

T = TypeVar("T")
MAX_FILE_BYTES = 1 << 24
# Largest number of C planes, of γ angles and of sets of lamps.
MAX_ANGLES, MAX_SETS = 3601, 20
# Negative intensities below this part of the largest are noise of the instrument.
_NOISE = 1e-3
# Relative difference of fluxes that coarse angles may cause.
_FLUX_ERROR = 0.05
# EULUMDAT limits the length of text lines.
_TEXT = 78
_MAX_WATTS = 1e9
# Limits of an XML file.
MAX_XML_BYTES = 1 << 25
_MAX_DEPTH, _MAX_ELEMENTS, _MAX_ATTRIBUTES = 256, 1 << 19, 1 << 20
# Limits of an archive: its bytes, bytes of all members that are read of it and of archives inside
# it, and members.
MAX_ARCHIVE_BYTES = 256 * 2**20
_MAX_UNPACKED = 256 * 2**20
_MAX_MEMBERS = 1 << 14
# An entry of the list of members begins with it.
_ENTRY = b"PK\x01\x02"
# zipfile unpacks other methods without a limit of memory.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Encodings of names that are not marked as UTF-8; zipfile takes the first.
_IS_UTF8 = 0x800
_ENCODINGS = ("cp437", "cp850", "cp1252", "utf-8")
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError)
_DAMAGED += (NotImplementedError, KeyError, MemoryError, struct.error)


def read_text(path: str | os.PathLike[str], kind: str, parse: Callable[[str], T]) -> T:
    """Result of `parse` for the text of a file, whose lines end in \\n; errors name the file.

    The text is in UTF-8, UTF-16 or else Latin-1.
    """
    content = in_utf8(read_bytes(path, f"an {kind}", MAX_FILE_BYTES))
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    try:
        # Numbers of any size are checked where they are used.
        with np.errstate(all="ignore"):
            return parse(text)
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is not a usable {kind}: {error}") from None


def number(text: str, what: str) -> float:
    """A finite number with a decimal point or comma."""
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise LumitreeError(f"{what} is {shown(text, 40)!r}; expected a number")
    return value


def integer(value: float, what: str, low: int, high: int) -> int:
    """A number as an integer from `low` to `high`."""
    if not (low <= value <= high and value == int(value)):
        raise LumitreeError(f"it has {value:g} {what}; expected {low} to {high}")
    return int(value)


def stated_power(text: str) -> float | None:
    """The electrical power that a file states, W; None if it is no number above 0 to 1e9."""
    try:
        watts = number(text, "the power")
    except LumitreeError:
        return None
    return watts if 0 < watts <= _MAX_WATTS else None


def one_line(text: str) -> str:
    """Text for one line of a file: printable characters of Latin-1."""
    return shown(text, _TEXT).replace("…", ".").encode("latin-1", "replace").decode("latin-1")


def date_of_writing() -> datetime.datetime:
    """The date that a written file states: now, or SOURCE_DATE_EPOCH, seconds since 1970.

    With this environment variable equal commands write equal files at any time
    (https://reproducible-builds.org).
    """
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    if seconds is None:
        return datetime.datetime.now().astimezone()
    try:
        return datetime.datetime.fromtimestamp(int(seconds), datetime.UTC)
    except (ValueError, OverflowError, OSError):
        raise LumitreeError(
            f"SOURCE_DATE_EPOCH is {shown(seconds, 40)}; expected seconds since 1970, or unset it"
        ) from None


def without_noise(
    path: str | os.PathLike[str], intensity: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Intensities of a file with 0 for small negative ones, of which it warns.

    Values below -0.1 % of the largest intensity are refused.
    """
    least, largest = float(intensity.min(initial=0)), float(intensity.max(initial=0))
    if least < -_NOISE * largest:
        raise LumitreeError(
            f"it has a negative intensity, {least:g} cd, where the largest is {largest:g} cd; "
            f"expected at least 0 (down to {-_NOISE * largest:g} would count as noise)"
        )
    if least < 0:
        warn_of_file(path, f"small negative intensities (down to {least:g} cd) count as 0")
    return np.maximum(intensity, 0)


def warn_of_flux(path: str | os.PathLike[str], lumens: float, stated: float, what: str) -> None:
    """Warn of intensities whose flux, lm, differs from the flux that their file states (0: none).

    `what` says how the file states it, such as "where it states 500 lm".
    """
    if min(stated, lumens) > 0 and abs(lumens - stated) > _FLUX_ERROR * stated:
        warn_of_file(
            path,
            f"its intensities have {lumens:.6g} lm, {what}; the intensities are used (state a "
            "known flux by lumens)",
        )


def warn_of_file(path: str | os.PathLike[str], text: str) -> None:
    """Warn of a photometric file."""
    warnings.warn(f"{shown(Path(path).name, 200)}: {text}", LumitreeWarning, stacklevel=3)


def parse_xml(content: bytes, name: str, expected: str) -> Element:
    """Root of an XML file in any encoding, whose tags and attributes are without namespaces.

    Entities, more than 32 MiB, 2¹⁹ elements or 2²⁰ attributes, and deep nesting are refused. `name`
    and `expected` are for messages.
    """
    if len(content) > MAX_XML_BYTES:
        raise LumitreeError(
            f"{name} is larger than {MAX_XML_BYTES >> 20} MiB, the limit for {expected}"
        )
    if content.count(b"=") > _MAX_ATTRIBUTES:
        raise LumitreeError(
            f"{name} has more than {_MAX_ATTRIBUTES} attributes, the limit for {expected}"
        )
    builder, depth, count = TreeBuilder(), 0, 0

    def local(tag: str) -> str:
        return tag.rpartition(":")[2]

    def opened(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MAX_DEPTH or count > _MAX_ELEMENTS:
            raise LumitreeError(
                f"{name} has more than {_MAX_ELEMENTS} elements, or they are nested more than "
                f"{_MAX_DEPTH} deep; expected {expected}"
            )
        builder.start(local(tag), {local(key): value for key, value in attributes.items()})

    def closed(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(local(tag))

    def declared(*_: object) -> None:
        raise LumitreeError(f"{name} declares XML entities, which are not read; remove them")

    # Files in UTF-16 may declare another encoding.
    is_utf16 = utf16_encoding(content) is not None
    parser = expat.ParserCreate("utf-8" if is_utf16 else None)
    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = declared
    try:
        parser.Parse(in_utf8(content) if is_utf16 else content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise LumitreeError(
            f"{name} is not well-formed XML ({shown(error)}); expected {expected}"
        ) from None
    return builder.close()


def number_of(element: Element, name: str, default: float | None = None) -> float:
    """A finite number that is an attribute, or the text of a child element.

    `default` is for one that is missing or blank; without it, the number must be there.
    """
    text = (element.get(name) or element.findtext(name) or "").strip()
    if not text and default is not None:
        return default
    return number(text, f"{name} of {element.tag}")


def text_of(element: Element, path: str) -> str:
    """Text of an element below, on one line; empty if there is none."""
    return " ".join((element.findtext(path) or "").split())


class Archive:
    """A zip archive, whose members are found by their names in any case and encoding.

    It shares the limit of size with `outer`, the archive that has it as a member. `name` and
    `expected` are for messages.
    """

    def __init__(
        self, content: bytes, name: str, expected: str, outer: "Archive | None" = None
    ) -> None:
        self.name, self._outer, self._unpacked = name, outer, 0
        # Before the list is read: a file of the largest size may have millions of them.
        if (count := content.count(_ENTRY)) > _MAX_MEMBERS:
            raise LumitreeError(f"{name} has {count} members; at most {_MAX_MEMBERS} are read")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(content))
            members = self._zip.infolist()
        except _DAMAGED as error:
            raise LumitreeError(
                f"{name} is damaged, or no zip archive ({type(error).__name__}); expected "
                f"{expected}"
            ) from None
        # The first of a name counts; exact names come before others.
        self._members: dict[str, zipfile.ZipInfo] = {}
        for key in (_plain, _folded):
            for encoding in _ENCODINGS:
                for member in members:
                    self._members.setdefault(key(_name(member, encoding)), member)

    @staticmethod
    def open(path: str | os.PathLike[str], expected: str) -> "Archive":
        """The archive that a file is."""
        content = read_bytes(path, expected, MAX_ARCHIVE_BYTES)
        return Archive(content, shown(path, 300), expected)

    def find(self, *names: str) -> str | None:
        """The first of some names that is in the archive."""
        return next((name for name in names if self._member(name) is not None), None)

    def names(self, folder: str) -> list[str]:
        """Names of the files directly in a folder, without the folder."""
        start = _folded(folder) + "/"
        found = {_plain(each.filename) for each in self._members.values() if not each.is_dir()}
        below = (name[len(start) :] for name in sorted(found) if _folded(name).startswith(start))
        return [name for name in below if name and "/" not in name]

    def read(self, name: str, expected: str, max_bytes: int = _MAX_UNPACKED) -> bytes:
        """Content of a member; `expected` is for messages.

        Nothing of a member larger than `max_bytes` is unpacked.
        """
        member = self._member(name)
        where = f"{shown(name, 200)} in {self.name}"
        if member is None:
            raise LumitreeError(f"{where} is missing; expected {expected}")
        if member.compress_type not in _METHODS:
            raise LumitreeError(
                f"{where} is compressed by method {member.compress_type} of zip archives; expected "
                "none or Deflate"
            )
        outermost = self
        while outermost._outer is not None:
            outermost = outermost._outer
        limit = min(max_bytes, _MAX_UNPACKED - outermost._unpacked)
        if member.file_size > limit:
            raise LumitreeError(
                f"{where} is too large: {member.file_size >> 20} MiB, of which {limit >> 20} MiB "
                "would be unpacked"
            )
        try:
            with self._zip.open(member) as file:
                # At most the size that is stated.
                content = file.read()
        except _DAMAGED as error:
            raise LumitreeError(
                f"{where} is damaged or encrypted ({type(error).__name__}); expected {expected}"
            ) from None
        outermost._unpacked += len(content)
        return content

    def _member(self, name: str) -> zipfile.ZipInfo | None:
        return self._members.get(_plain(name)) or self._members.get(_folded(name))


def _name(member: zipfile.ZipInfo, encoding: str) -> str:
    """Name of a member in one of `_ENCODINGS`."""
    if member.flag_bits & _IS_UTF8:
        return member.filename
    try:
        return member.filename.encode(_ENCODINGS[0]).decode(encoding)
    except UnicodeError:
        return member.filename


def _plain(name: str) -> str:
    return name.replace("\\", "/").removeprefix("./")


def _folded(name: str) -> str:
    return _plain(name).casefold()
