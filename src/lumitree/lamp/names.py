"""Names of parts and materials, for files and for the scene, and patterns that choose by them."""

import fnmatch
import re
from collections.abc import Sequence

from lumitree.errors import LumitreeError, shown, shown_names

# A pattern of digits alone; a name of this form is matched by "[#]3".
_NUMBER = re.compile(r"#[0-9]{1,9}")


class Names:
    """Makes names that are unique, also where upper and lower case are not distinguished."""

    def __init__(self, separator: str) -> None:
        self._separator = separator
        self._taken: set[str] = set()
        self._numbers: dict[str, int] = {}

    def unique(self, wanted: str) -> str:
        """`wanted`, with a number where it is taken."""
        key = wanted.lower()
        name, number = wanted, self._numbers.get(key, 1)
        while name.lower() in self._taken:
            number += 1
            name = f"{wanted}{self._separator}{number}"
        # The next search starts here: from 1, many equal names would take quadratic time.
        self._numbers[key] = number
        self._taken.add(name.lower())
        return name


def select_names(
    names: Sequence[Sequence[str]],
    keep: Sequence[str],
    drop: Sequence[str],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
) -> list[bool]:
    """Which things are kept, each known by one or more names; patterns must match something."""
    how = "" if listed is None else f"; 'lumitree preview {file} --keep \"*\"' lists them all"
    kept, dropped = (
        [matching(each, option, names, file, kind, listed, how) for each in patterns]
        for option, patterns in (("--keep", keep), ("--drop", drop))
    )
    chosen = [
        (not keep or any(each[at] for each in kept)) and not any(each[at] for each in dropped)
        for at in range(len(names))
    ]
    if not any(chosen):
        raise LumitreeError(f"{file}: --keep and --drop leave nothing; keep more or drop less")
    return chosen


def matching(
    pattern: str,
    option: str,
    names: Sequence[Sequence[str]],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
    how: str = "",
) -> list[bool]:
    """Which of the things a pattern with * and ? matches, by one of their names.

    Args:
        option, file, kind: the pattern's option, the name of the file, and what the things are, for
            messages.
        listed: descriptions of the things, for messages. They may then be chosen by number, too, as
            "#3". None: by names alone.
        how: end of the message.

    Raises:
        LumitreeError: it matches nothing.
    """
    if listed is not None and _NUMBER.fullmatch(pattern):
        found = [at == int(pattern[1:]) for at in range(len(names))]
    else:
        found = [any(fnmatch.fnmatchcase(name, pattern) for name in own) for own in names]
    if not any(found):
        every = dict.fromkeys(name for own in names for name in own if name)
        raise LumitreeError(
            f"{file}: {option} {shown(pattern)!r} matches no {kind}; there are "
            f"{shown_names(every if listed is None else listed)}{how}"
        )
    return found
