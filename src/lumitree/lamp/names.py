"""Names of parts and materials, for files and for the scene."""


class Names:
    """Makes names that are unique, also where upper and lower case are not distinguished."""

    def __init__(self, separator: str) -> None:
        """Start empty.

        Args:
            separator: between a name and the number that makes it unique.
        """
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
