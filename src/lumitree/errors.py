"""The exception and the warning of lumitree, and functions that format their messages."""

import copyreg
import functools
import inspect
import re
from collections.abc import Callable, Iterable
from typing import Any, TypeVar, cast

# Texts of errors of Dr.Jit and its backends.
_OUT_OF_MEMORY = ("out of memory", "bad_alloc", "could not allocate")
F = TypeVar("F", bound=Callable[..., Any])

_SHOWN_NAMES, _SHOWN_CHARACTERS = 12, 40
# Mitsuba's messages begin with the class or the line of its source that found the error.
_MITSUBA = re.compile(r"^\W*\[[\w:.]+(\[\w+\])?\] ")


class LumitreeError(Exception):
    """Invalid input, or a problem of the environment such as a full disk.

    The message is one line. It states what was found, what was expected and what to do. The
    command line prints it and exits with status 2.
    """

    def __reduce__(self) -> tuple[object, ...]:
        # The constructors of subclasses, which have other arguments, are not called, so that the
        # errors of tasks in other processes keep type, text and attributes.
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__ or None  # pyright: ignore


class LumitreeWarning(UserWarning):
    """A result is approximate, or an input is probably wrong.

    The message is one line. The command line prints it and continues; Python callers may filter it.
    """


def shown(text: object, limit: int = 80) -> str:
    """Text from a file, made safe for a message.

    Args:
        text: text of any length, with any characters.
        limit: largest number of characters of the result.

    Returns:
        One line: the beginning of the text, with `?` for unprintable characters. It ends in … if
        the text was cut.
    """
    text = str(text)
    start = text if len(text) <= limit else text[: limit - 1] + "…"
    return "".join(char if char.isprintable() else "?" for char in start)


def shown_names(names: Iterable[str]) -> str:
    """Names from a file, for a message; at most 12, and the number of the others."""
    names = list(names)
    more = f" and {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    listed = ", ".join(shown(name, _SHOWN_CHARACTERS) for name in names[:_SHOWN_NAMES])
    return listed + more if names else "none with a name"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: the nearest known one, or all of them."""
    import difflib

    known = list(known)
    if nearest := difflib.get_close_matches(name, known, 1):
        return f"; did you mean {nearest[0]!r}?"
    return f"; expected {', '.join(known)}"


def explained(function: F) -> F:
    """Decorator of public functions, with errors of a kind that users can read.

    Errors of the system, of memory and of readers for which readers of files have no message become
    a `LumitreeError`, and the `TypeError` for an unknown keyword names the nearest known one. An
    empty text, which as a path would be the current folder, is refused in place of any value. The
    type of the result is the type of the function, so that an editor finds where an argument is
    passed.
    """
    known = inspect.signature(function).parameters
    takes_any = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in known.values())

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        for name in () if takes_any else kwargs.keys() - known.keys():
            hint = did_you_mean(name, known)
            raise TypeError(f"{function.__name__}() has no argument {name!r}{hint}")
        for name, value in (*zip(known, args, strict=False), *kwargs.items()):
            texts = value if isinstance(value, list | tuple) else [value]
            if any(isinstance(each, str) and each == "" for each in texts):
                raise LumitreeError(f"{name} is ''; expected a name or another value")
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
            if any(each in str(error).lower() for each in _OUT_OF_MEMORY):
                reason = f"not enough memory: {shown(error, 200)}; choose smaller sizes"
            elif (found := renderer_reason(error)) is not None:
                raise LumitreeError(f"Mitsuba stopped: {shown(found, 400)}") from error
            else:
                raise
        raise LumitreeError(reason)

    return cast(F, run)


def renderer_reason(error: BaseException) -> str | None:
    """The fault of a scene, from an exception of Mitsuba.

    Returns:
        The message of a `LumitreeError` that a plugin of lumitree raised, or else Mitsuba's,
        without its place in the source. None if the exception is of another kind, such as one in
        Python, or one of Dr.Jit for a wrong call: that is an error in the program.
    """
    text = str(error)
    if raised := re.search(r"LumitreeError: (.*)", text):
        return raised.group(1)
    behind = error.__cause__ or error.__context__
    if "Traceback (most recent call last)" in text or not isinstance(error, RuntimeError):
        return None
    line = " ".join(text.split())
    if not _MITSUBA.match(line):
        # Dr.Jit wraps what is raised while it traces a loop or renders.
        return None if behind is None else renderer_reason(behind)
    line = re.sub(r"\[\w+\.(cpp|h):\d+\] ", "", _MITSUBA.sub("", line))
    # An object is printed as "Class[ member = ... ]".
    return re.sub(r"\[ .* \]", "", line)
