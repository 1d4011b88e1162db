"""What a LUMINAIRE argument names: a built-in lamp, or a file and how to read it."""

import dataclasses
import os


@dataclasses.dataclass(frozen=True)
class LuminaireSource:
    """A luminaire that has not been loaded yet.

    Attributes:
        name: built-in name, or path of a .xml, .obj, .gltf or .glb file.
        materials: TOML file of overrides for a model; None for the one beside it, if any.
        keep: patterns with * and ? of what belongs to the luminaire: ids of shapes in a Mitsuba
            scene, parts or materials in a model; empty for everything.
        drop: patterns of what does not.
    """

    name: str
    materials: str | None = None
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.name


def as_source(source: str | os.PathLike[str] | LuminaireSource) -> LuminaireSource:
    """The source itself, or one that names `source` and says nothing more."""
    return source if isinstance(source, LuminaireSource) else LuminaireSource(os.fspath(source))
