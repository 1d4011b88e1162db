"""Strategies of hypothesis: a valid text, tree or file with a few changes."""

import copy
import json
import struct
from xml.etree import ElementTree

from hypothesis import strategies as st

# Number tokens, as JSON, TOML, XML and the text formats write them; some are none of these.
NUMBERS = (
    *("0", "-0.0", "1", "-1", "2", "3", "7", "90", "180", "255", "256", "360", "361", "1000"),
    *("0.5", "1e-7", "1e-30", "1e-46", "5e-324", "1e7", "1e15", "1e16", "1e30", "3.5e38", "1e300"),
    *("1e308", "-1e308", "1e309", "-1e999", "2147483647", "2147483648", "-2147483649"),
    *("4294967296", "9223372036854775807", "9223372036854775808", "-9223372036854775809"),
    *("16777217", "65536", "1048577", "134217729", "268435457", "9" * 30, "NaN", "nan", "-nan"),
    *("inf", "Infinity", "-Infinity", "1_000", "0x10", "1,5", "+1", ".5", "1.", "1e", "--1", ""),
    *("٣", "\uff11", "1d5", "1.5.2", "1" * 400, "1" * 5000, "0" * 5000),
)
TEXTS = (
    *("", " ", "x", "\0", "\n", "\r\n", "\t", "\x1b[2J", "a\nb", "\ud800", "\udcff", "é", "☀"),
    *("\u2028", "\ufeff", "\u202e", "../../etc/passwd", "/dev/zero", "/dev/stdin"),
    *("..", ".", "/", "\\", "C:\\x.png", "http://a/b.png", "file:///etc/passwd", "%00", "%2e%2e"),
    *("a" * 300, "a" * 5000, "é" * 1000, "\x1b" * 3000, "&#0;", "&lt;", "<a>", "]]>", "{}", "[]"),
    *("None", "null", "NaN", "0", "-1", "1e999", "*", "?", "#", "#1", "$(id)", "%s%n", "{0}"),
)
# Numbers of 4 bytes in binary files.
_WORDS = tuple(
    struct.pack(kind, value)
    for kind, values in (
        ("<i", (0, 1, -1, 2, 7, 2**31 - 1, -(2**31), 300)),
        ("<f", (0.5, -1.0, 1e30, 3e38, float("inf"), float("nan"), 1e-40)),
    )
    for value in values
)
_FACTORS = (-1.0, 0.0, 0.5, 2.0, 1 + 1e-7, 1e3, 1e-3, 1e10, 1e-10, 1e20)
_DEEP, _MANY = 3000, 200
_XML_HEADS = (
    b'<?xml version="1.0" encoding="utf-16"?>',
    b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
    b'<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    b"\xef\xbb\xbf",
)
few = st.sampled_from((1, 1, 1, 2, 3))


def encoded(text):
    """UTF-8 with lone surrogates."""
    return text.encode("utf-8", "surrogatepass")


@st.composite
def near(draw, word):
    """A token that is often near the number that a word is."""
    token = draw(st.sampled_from(NUMBERS))
    try:
        changed = f"{float(word) * draw(st.sampled_from(_FACTORS)):.9g}"
    except (ValueError, OverflowError):
        return token
    return draw(st.sampled_from((changed, token)))


@st.composite
def changed_bytes(draw, content):
    """Bytes with some changed, a part repeated or removed, or cut off."""
    for _ in range(draw(few)):
        data = content or b"\0"
        at = draw(st.integers(0, len(data) - 1))
        length, end = draw(st.integers(1, 9)), at - at % 4
        content = draw(
            st.sampled_from(
                (
                    data[:at],
                    data[:at] + data[at + length :],
                    data[:at] + 8 * data[at : at + length] + data[at:],
                    data[:at] + bytes([data[at] ^ (1 << length % 8)]) + data[at + 1 :],
                    data[:end] + draw(st.sampled_from(_WORDS)) + data[end + 4 :],
                )
            )
        )
    return content


@st.composite
def changed_text(draw, content, separators=(" ",), tokens=()):
    """A text with words or lines changed, dropped or repeated; or, sometimes, other bytes."""
    text = content.decode("utf-8", "surrogateescape")
    for _ in range(draw(few)):
        separator = draw(st.sampled_from(("\n", *separators)))
        pieces = text.split(separator)
        at = draw(st.integers(0, len(pieces) - 1))
        match draw(st.integers(0, 7)):
            case 0:
                del pieces[at]
            case 1:
                pieces.insert(at, draw(st.sampled_from(pieces[:50])))
            case 2:
                pieces[at] = draw(st.sampled_from((*TEXTS, *tokens)))
            case _:
                pieces[at] = draw(near(pieces[at]))
        text = separator.join(pieces)
    content = text.encode("utf-8", "surrogatepass" if "\ud800" in text else "surrogateescape")
    return draw(changed_bytes(content)) if draw(st.integers(0, 9)) == 0 else content


def _slots(tree):
    """Containers and keys of all values below the root of a tree of JSON or TOML."""
    if isinstance(tree, dict | list):
        for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
            yield tree, key
            yield from _slots(value)


@st.composite
def changed_tree(draw, tree, keys=()):
    """A tree of JSON or TOML with some changed values.

    Args:
        keys: names of members that objects may get, with values of other members.
    """
    tree = copy.deepcopy(tree)
    for _ in range(draw(few)):
        slots = list(_slots(tree))
        if not slots:
            break
        outer, key = draw(st.sampled_from(slots))
        old = outer[key]
        other, there = draw(st.sampled_from(slots))
        match draw(st.integers(0, 7)):
            case 0:
                del outer[key]
            case 1 if isinstance(outer, dict):
                outer[draw(st.sampled_from((*keys, *TEXTS)))] = copy.deepcopy(old)
            case 1:
                outer.insert(0, copy.deepcopy(old))
            case 2:
                outer[key] = copy.deepcopy(other[there])
            case 3 if isinstance(old, list):
                outer[key] = draw(st.sampled_from((2, 30))) * old
            case 4 if isinstance(old, str):
                outer[key] = draw(st.sampled_from(TEXTS))
            case 5:
                outer[key] = draw(st.sampled_from((None, True, 0, -1, 0.5, "x", [], {}, [old])))
            case _ if isinstance(old, int | float) and not isinstance(old, bool):
                changed = old * draw(st.sampled_from(_FACTORS))
                whole = isinstance(old, int) and abs(changed) < 2**62
                outer[key] = draw(st.sampled_from((old + 1, int(changed) if whole else changed)))
    return tree


@st.composite
def json_text(draw, tree):
    """JSON of a tree; sometimes with one number replaced by a token, or nested deeply."""
    text = json.dumps(tree, ensure_ascii=False)
    match draw(st.integers(0, 19)):
        case 0:
            text = text.replace("0", draw(st.sampled_from(NUMBERS)), 1)
        case 1:
            deep = ("[" * _DEEP + "]" * _DEEP, '{"a":' * _DEEP + "1" + "}" * _DEEP, "[" * 200)
            text = text.replace("1", draw(st.sampled_from(deep)), 1)
    return encoded(text)


def toml_text(tree):
    """TOML of a tree, whose tables are in one line."""

    def text(value):
        if isinstance(value, dict):
            members = (f"{json.dumps(key)} = {text(each)}" for key, each in value.items())
            return "{" + ", ".join(members) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(map(text, value)) + "]"
        return "nan" if value is None else json.dumps(value)

    return encoded("\n".join(f"{json.dumps(key)} = {text(each)}" for key, each in tree.items()))


@st.composite
def changed_xml(draw, content):
    """Bytes of an XML text with some changes of its elements."""
    root = ElementTree.fromstring(content)
    for _ in range(draw(few)):
        every = list(root.iter())
        # Tags with equal probability: some are repeated many times.
        tag = draw(st.sampled_from(sorted({each.tag for each in every})))
        element = draw(st.sampled_from([each for each in every if each.tag == tag]))
        parents = {child: parent for parent in every for child in parent}
        parent, other = parents.get(element, root), draw(st.sampled_from(every))
        match draw(st.integers(0, 9)):
            case 0 if element is not root:
                parent.remove(element)
            case 1:
                parent.append(copy.deepcopy(other))
            case 2:
                element.tag = other.tag
            case 3:
                element.attrib |= other.attrib
            case 4 if element is not root:
                parent.extend([element] * _MANY)
            case 5 if element is not root:
                parent.remove(element)
                for _ in range(_MANY):
                    outer = ElementTree.Element(element.tag, element.attrib)
                    outer.append(element)
                    element = outer
                parent.append(element)
            case _:
                name = draw(st.sampled_from([None, *element.attrib]))
                old = (element.text if name is None else element.get(name)) or ""
                # XML has no other characters.
                texts = st.sampled_from([each for each in TEXTS if each.isprintable()])
                new = draw(st.one_of(near(old), texts))
                element.text = new if name is None else element.text
                element.attrib |= {} if name is None else {name: new}
    data = ElementTree.tostring(root, "utf-8")
    if draw(st.integers(0, 9)) == 0:
        return draw(st.sampled_from(_XML_HEADS)) + data.partition(b"?>")[2]
    return data
