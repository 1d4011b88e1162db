"""The one exception that lumitree raises for its users, and its warning."""


class LumitreeError(Exception):
    """Bad input or a failed environment, told in one line.

    The message says what was found, what was expected and what to do. The command line prints
    it and exits with status 2; Python callers catch it.
    """


class LumitreeWarning(UserWarning):
    """Something was approximated or looks wrong; told in one line.

    The command line prints it and goes on; Python callers may filter it.
    """
