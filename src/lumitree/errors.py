"""The one exception that lumitree raises for its users, its warning, and how both are made."""

import functools
from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

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


def explained(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator: errors of the system, of memory and of readers become a `LumitreeError`.

    Readers say what is wrong with a file where they know; this is for what they did not foresee.
    """

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except OSError as error:
            name = f"{shown(error.filename, 200)}: " if error.filename is not None else ""
            reason = name + shown(error.strerror or error, 200)
        except MemoryError:
            reason = "not enough memory; choose smaller sizes, or close other programs"
        except RecursionError:
            reason = "a file is nested too deeply to be read"
        except UnicodeError as error:
            reason = f"a name or a file is not valid UTF-8: {shown(error, 200)}"
        except OverflowError as error:
            reason = f"a number is too large: {shown(error, 200)}"
        except RuntimeError as error:
            if not _is_out_of_memory(error):
                raise
            reason = f"not enough memory: {shown(error, 200)}; choose smaller sizes"
        raise LumitreeError(reason)

    return run


def _is_out_of_memory(error: RuntimeError) -> bool:
    text = str(error).lower()
    return "out of memory" in text or "bad_alloc" in text or "could not allocate" in text
