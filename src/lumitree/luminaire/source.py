"""Description of a luminaire that has not been loaded: a name or file, and how to read it."""

import dataclasses
import os


@dataclasses.dataclass(frozen=True)
class LuminaireSource:
    """A luminaire that has not been loaded yet.

    Attributes:
        name: built-in name, or path of a .xml, .obj, .gltf or .glb file.
        materials: TOML file of overrides for a model. By default it is the file with the model's
            name and the suffix .toml, if there is one.
        keep: patterns with * and ? of what belongs to the luminaire: ids of shapes or of their
            BSDFs, or numbers of shapes such as "#3", in a Mitsuba scene; or names of parts or
            materials in a model; empty for everything.
        drop: patterns of what does not belong to the luminaire.
    """

    name: str
    materials: str | None = None
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.name


def as_source(source: str | os.PathLike[str] | LuminaireSource) -> LuminaireSource:
    """`source` itself, or a `LuminaireSource` with this name and defaults."""
    return source if isinstance(source, LuminaireSource) else LuminaireSource(os.fspath(source))
