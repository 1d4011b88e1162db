"""XML of luminaire data, read without entities and within limits."""

from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from lumitree.core.file_kinds import in_utf8, utf16_encoding
from lumitree.errors import LumitreeError, shown
from lumitree.formats.photometric_text import number

MAX_BYTES = 1 << 25
_MAX_DEPTH, _MAX_ELEMENTS, _MAX_ATTRIBUTES = 256, 1 << 19, 1 << 20


def parse_xml(content: bytes, name: str, expected: str) -> Element:
    """Root of an XML file in any encoding, whose tags and attributes are without namespaces.

    Entities, more than 32 MiB, 2¹⁹ elements or 2²⁰ attributes, and deep nesting are refused. `name`
    and `expected` are for messages.
    """
    if len(content) > MAX_BYTES:
        raise LumitreeError(
            f"{name} is larger than {MAX_BYTES >> 20} MiB, the limit for {expected}"
        )
    if content.count(b"=") > _MAX_ATTRIBUTES:
        raise LumitreeError(
            f"{name} has more than {_MAX_ATTRIBUTES} attributes, the limit for {expected}"
        )
    builder, depth, count = TreeBuilder(), 0, 0

    def opened(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MAX_DEPTH or count > _MAX_ELEMENTS:
            raise LumitreeError(
                f"{name} has more than {_MAX_ELEMENTS} elements, or they are nested more than "
                f"{_MAX_DEPTH} deep; expected {expected}"
            )
        builder.start(_local(tag), {_local(key): value for key, value in attributes.items()})

    def closed(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_local(tag))

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


def _local(tag: str) -> str:
    return tag.rpartition(":")[2]
