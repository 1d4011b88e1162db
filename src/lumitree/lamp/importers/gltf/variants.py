"""Material variants (KHR_materials_variants)."""

from lumitree.errors import shown, shown_names
from lumitree.lamp.importers.gltf.container import Document
from lumitree.lamp.importers.gltf.item import Item


class Variants:
    """Chooses the material of every primitive."""

    def __init__(self, document: Document, variant: str | None) -> None:
        self._index = None
        if variant is None:
            return
        extension = document.root.extension("KHR_materials_variants")
        entries = [] if extension is None else extension.items("variants")
        names = [entry.string("name", "") for entry in entries]
        if variant not in names:
            raise document.root.error(
                f"no material variant {shown(variant)!r}; there are: {shown_names(names)}"
            )
        self._index = names.index(variant)

    def material(self, primitive: Item) -> int | None:
        """Index of a primitive's material; None for the default material."""
        extension = primitive.extension("KHR_materials_variants")
        if self._index is not None and extension is not None:
            for mapping in extension.items("mappings"):
                if self._index in mapping.indices("variants"):
                    return mapping.integer("material")
        return primitive.index("material")
