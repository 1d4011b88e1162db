"""The one exception that lumitree raises for its users, and its warning."""

from collections.abc import Iterable

_SHOWN_NAMES, _SHOWN_CHARACTERS = 12, 40


class LumitreeError(Exception):
    """Bad input or a failed environment, told in one line.

    The message says what was found, what was expected and what to do. The command line prints
    it and exits with status 2; Python callers catch it.
    """


class LumitreeWarning(UserWarning):
    """Something was approximated or looks wrong; told in one line.

    The command line prints it and goes on; Python callers may filter it.
    """


def shown(text: object, limit: int = 80) -> str:
    """Text that came from a file, as it may stand in a message.

    Args:
        text: of any length, with any characters.
        limit: characters of the result.

    Returns:
        Its beginning in one line, with `?` for what cannot be printed, and … where it was cut.
    """
    text = str(text)
    start = text if len(text) <= limit else text[: limit - 1] + "…"
    return "".join(char if char.isprintable() else "?" for char in start)


def shown_names(names: Iterable[str]) -> str:
    """Names that came from a file, for a message; not all of them where there are many."""
    names = list(names)
    more = f" and {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    listed = ", ".join(shown(name, _SHOWN_CHARACTERS) for name in names[:_SHOWN_NAMES])
    return listed + more if names else "none with a name"
