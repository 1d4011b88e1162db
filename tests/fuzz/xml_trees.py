"""XML texts taken apart, changed and written again."""

import copy
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

from fuzz.values import chance, pick, text, token

_HEADS = (
    b'<?xml version="1.0" encoding="utf-8"?>\n',
    b'<?xml version="1.0" encoding="latin-1"?>',
    b'<?xml version="1.0" encoding="utf-16"?>',
    b'<?xml version="1.1"?>',
    b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
    b'<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    b"\xef\xbb\xbf",
    b"<!-- -->",
)
_DEEP, _MANY = 300, 200
# Attributes of Mitsuba's scenes that are numbers.
_VALUES = ("value", "x", "y", "z", "angle", "origin", "target", "up")


def changed(content, rng, times=None):
    """Bytes of an XML text with some changes of its elements."""
    root = ElementTree.fromstring(content)
    for _ in range(int(rng.integers(1, 4)) if times is None else times):
        _change(rng, root)
    data = _written(root).encode("utf-8", "surrogatepass")
    return pick(rng, _HEADS) + data if chance(rng, 0.1) else data


def _written(element):
    """Text of an element, nested however deep; characters that XML does not allow stay."""
    parts, rest = [], [element]
    while rest:
        each = rest.pop()
        if isinstance(each, str):
            parts.append(each)
            continue
        attributes = "".join(f" {key}={quoteattr(value)}" for key, value in each.attrib.items())
        parts.append(f"<{each.tag}{attributes}>{escape(each.text or '')}")
        rest.append(f"</{each.tag}>")
        for child in reversed(each):
            rest += [escape(child.tail or ""), child]
    return "".join(parts)


def _change(rng, root):
    every = list(root.iter())
    # Of all tags alike: some are repeated many times.
    tags = sorted({each.tag for each in every})
    tag = pick(rng, tags)
    element = pick(rng, [each for each in every if each.tag == tag])
    parents = {id(child): parent for parent in every for child in parent}
    parent = parents.get(id(element), root)
    match int(rng.integers(10)):
        case 0 if element is not root:
            parent.remove(element)
        case 1:
            parent.insert(int(rng.integers(len(parent) + 1)), copy.deepcopy(element))
        case 2:
            parent.append(copy.deepcopy(pick(rng, every)))
        case 3:
            element.tag = pick(rng, every).tag
        case 4 if element.attrib:
            del element.attrib[pick(rng, list(element.attrib))]
        case 5:
            other = pick(rng, every)
            element.attrib |= other.attrib
        case 6 if chance(rng, 0.2) and element is not root:
            _repeat(rng, parent, element)
        case _:
            _set_value(rng, element, every)


def _repeat(rng, parent, element):
    """Put an element into itself many times, or beside itself."""
    if chance(rng, 0.5):
        for _ in range(_MANY):
            parent.append(element)
        return
    index = list(parent).index(element)
    parent.remove(element)
    for _ in range(pick(rng, (10, 70, _DEEP))):
        outer = ElementTree.Element(element.tag, element.attrib)
        outer.append(element)
        element = outer
    parent.insert(index, element)


def _set_value(rng, element, every):
    names = list(element.attrib)
    name = pick(rng, names) if names and chance(rng, 0.8) else None
    old = element.get(name) if name is not None else element.text
    values = [value for each in every for value in each.attrib.values()]
    kind = int(rng.integers(6))
    if kind == 0 and values:
        new = pick(rng, values)
    elif kind == 1:
        new = text(rng)
    else:
        # One number of a list, with the other ones.
        words = (old or "").replace(",", " , ").split()
        places = [place for place, word in enumerate(words) if word != ","]
        if places:
            place = pick(rng, places)
            words[place] = token(rng, words[place])
        new = " ".join(words) if words else token(rng)
    if name is None:
        element.text = new
    else:
        element.set(name, new)
