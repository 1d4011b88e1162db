"""Approximations and omissions while a file was read, to be reported at the end."""

from collections.abc import Iterator

from lumitree.errors import shown


class Notes:
    """Collects remarks about a file and about each of its materials."""

    def __init__(self, name: str) -> None:
        self._name = name
        # Dictionaries, because sets do not keep their order.
        self._file: dict[str, None] = {}
        self._materials: dict[str, dict[str, None]] = {}

    def file(self, text: str) -> None:
        """Note something in the file that is ignored."""
        self._file[text] = None

    def material(self, name: str, text: str) -> None:
        """Note a property of a material that is approximated."""
        self._materials.setdefault(name, {})[text] = None

    def lines(self) -> Iterator[str]:
        """One line for the file and one for each material, for which there are notes."""
        if self._file:
            yield f"{self._name}: ignored: {'; '.join(self._file)}"
        for name, texts in self._materials.items():
            yield f"{self._name}: material {shown(name)!r} is approximated: {'; '.join(texts)}"
