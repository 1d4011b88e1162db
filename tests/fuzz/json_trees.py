"""JSON and TOML texts taken apart, changed and written again.

An object is `Members`, a list of pairs, so that keys may be repeated; a `Raw` is written as it is.
"""

import copy
import json

from fuzz.values import NUMBERS, chance, number_near, pick, text

# Deeper than any reader goes.
_DEEP = 3000


class Raw(str):
    """A token that is written as it is."""


class Members(list):
    """Pairs [key, value] of an object."""


DEEP = (Raw("[" * _DEEP + "]" * _DEEP), Raw('{"a":' * _DEEP + "1" + "}" * _DEEP), Raw("[" * 200))


def tree_of(value):
    """The tree of what `json.loads` returns."""
    if isinstance(value, dict):
        return Members([key, tree_of(each)] for key, each in value.items())
    return [tree_of(each) for each in value] if isinstance(value, list | tuple) else value


def written(tree):
    """Bytes of the JSON text of a tree; lone surrogates stay."""
    return _text(tree, ":").encode("utf-8", "surrogatepass")


def written_toml(tree):
    """Bytes of the TOML text of a tree, whose tables are in one line."""
    lines = [f"{_quoted(key)} = {_text(each, '=')}" for key, each in tree]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _text(tree, colon):
    if isinstance(tree, Raw):
        return str(tree)
    if isinstance(tree, Members):
        members = (f"{_quoted(key)}{colon}{_text(each, colon)}" for key, each in tree)
        return "{" + ",".join(members) + "}"
    if isinstance(tree, list):
        return "[" + ",".join(_text(each, colon) for each in tree) + "]"
    return _quoted(tree) if isinstance(tree, str) else json.dumps(tree)


def _quoted(value):
    return value if isinstance(value, Raw) else json.dumps(value, ensure_ascii=False)


def changed(value, rng, keys=()):
    """Tree of a value with some changes.

    Args:
        value: as of `json.loads`.
        keys: names of members that objects may get, with other members' values.
    """
    tree = tree_of(value)
    # Often one value alone, and one of the same type, so that further checks are reached.
    alike = chance(rng, 0.4)
    for _ in range(1 if alike else int(rng.integers(1, 4))):
        slots = list(_slots(tree))
        if slots:
            outer, index, holder, place = pick(rng, slots)
            if alike:
                holder[place] = _alike(rng, holder[place], slots)
            else:
                _change(rng, outer, index, holder, place, slots, keys)
    return tree


def _slots(tree):
    """Lists and indices of all values below the root: of a member it is that of its pair."""
    if isinstance(tree, list):
        for index, each in enumerate(tree):
            holder, place = (each, 1) if isinstance(tree, Members) else (tree, index)
            yield tree, index, holder, place
            yield from _slots(holder[place])


def _alike(rng, old, slots):
    """A number near the old one, or another value of the same type."""
    if type(old) in (int, float) and chance(rng, 0.7):
        return number_near(rng, old)
    values = [holder[place] for *_, holder, place in slots]
    return copy.deepcopy(pick(rng, [each for each in values if type(each) is type(old)]))


def _change(rng, outer, index, holder, place, slots, keys):
    old = holder[place]
    match int(rng.integers(9)):
        case 0:
            del outer[index]
        case 1:
            outer.insert(int(rng.integers(len(outer) + 1)), copy.deepcopy(outer[index]))
        case 2:
            *_, other, there = pick(rng, slots)
            holder[place] = copy.deepcopy(other[there])
        case 3 if isinstance(outer, Members):
            name = pick(rng, keys) if keys and chance(rng, 0.6) else text(rng)
            outer.append([name, copy.deepcopy(old)])
        case 4 if isinstance(old, list) and old:
            old.extend(copy.deepcopy(old) * pick(rng, (1, 1, 2, 30)))
        case 5 if chance(rng, 0.2):
            holder[place] = pick(rng, DEEP)
        case _:
            holder[place] = _wrong(rng, old)


def _wrong(rng, old):
    """A value of the same type as another one, or of another one."""
    is_number = isinstance(old, int | float) and not isinstance(old, bool)
    if is_number and chance(rng, 0.8):
        near = number_near(rng, old)
        # json.dumps writes no token of JSON for infinite numbers, which is wanted here.
        return near if chance(rng, 0.5) else Raw(pick(rng, NUMBERS) or "null")
    if isinstance(old, str) and chance(rng, 0.7):
        return text(rng)
    return pick(rng, (None, True, False, 0, -1, 0.5, "x", [], Members(), text(rng), [old]))
