"""XML texts taken apart, changed and written again."""

import copy
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

from fuzz.values import chance, pick, text, token

_HEADS = (
    b'<?xml version="1.0" encoding="utf-8"?>\n',
    b'<?xml version="1.0" encoding="utf-16"?>',
    b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
    b'<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    b"\xef\xbb\xbf",
)
_DEEP, _MANY = 300, 200


def changed(content, rng):
    """Bytes of an XML text with some changes of its elements."""
    root = ElementTree.fromstring(content)
    for _ in range(int(rng.integers(1, 4))):
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
    # Tags with equal probability: some are repeated many times.
    tag = pick(rng, sorted({each.tag for each in every}))
    element = pick(rng, [each for each in every if each.tag == tag])
    parents = {id(child): parent for parent in every for child in parent}
    parent = parents.get(id(element), root)
    match int(rng.integers(8)):
        case 0 if element is not root:
            parent.remove(element)
        case 1:
            parent.insert(int(rng.integers(len(parent) + 1)), copy.deepcopy(pick(rng, every)))
        case 2:
            element.tag = pick(rng, every).tag
        case 3:
            element.attrib |= pick(rng, every).attrib
        case 4 if chance(rng, 0.2) and element is not root:
            _repeat(rng, parent, element)
        case _:
            _set_value(rng, element, every)


def _repeat(rng, parent, element):
    """Put an element into itself many times, or beside itself."""
    if chance(rng, 0.5):
        parent.extend([element] * _MANY)
        return
    parent.remove(element)
    for _ in range(_DEEP):
        outer = ElementTree.Element(element.tag, element.attrib)
        outer.append(element)
        element = outer
    parent.append(element)


def _set_value(rng, element, every):
    names = list(element.attrib)
    name = pick(rng, names) if names and chance(rng, 0.8) else None
    words = ((element.text if name is None else element.get(name)) or "").split()
    values = [value for each in every for value in each.attrib.values()]
    if chance(rng, 0.3):
        new = pick(rng, values) if values and chance(rng, 0.5) else text(rng)
    elif words:
        # One number of a list, with the other ones.
        place = int(rng.integers(len(words)))
        words[place] = token(rng, words[place])
        new = " ".join(words)
    else:
        new = token(rng)
    if name is None:
        element.text = new
    else:
        element.set(name, new)
