"""Sphinx configuration: prose in Markdown (MyST), the API from docstrings. Needs no GPU."""

import json
import re
import shutil
from pathlib import Path

import numpy.typing


class ArrayLike:
    """Shown by this name, instead of NumPy's union of a dozen types."""


class NDArray:
    """Shown by this name; docstrings state type and shape."""

    def __class_getitem__(cls, _):
        return cls


# Before lumitree is imported, which takes them from there.
numpy.typing.ArrayLike, numpy.typing.NDArray = ArrayLike, NDArray

import lumitree  # noqa: E402

project = "lumitree"
author = "lumitree contributors"
copyright = "lumitree contributors, BSD-3-Clause"
version = release = lumitree.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]
# autosummary takes the first suffix that it does not know as Markdown, so .rst is before .ipynb.
source_suffix = {".md": "markdown", ".rst": "restructuredtext", ".ipynb": "markdown"}

myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"lumitree {release}"
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["tables.css"]
# Pages that `make gallery` has made, which the documentation then links to.
EXTRA = Path(__file__).parent / "generated" / "extra"
html_extra_path = ["generated/extra"] if EXTRA.is_dir() else []


# Documents outside docs/ become pages too; their links are relative to the repository's root.
ROOT = Path(__file__).parent.parent
GENERATED = Path(__file__).parent / "generated"
OUTSIDE = (
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "benchmarks/results/*.md",
    "benchmarks/results/*.png",
    "benchmarks/results/paper/images/*.jpg",
)


def copy_outside(app):
    """Copy the documents outside docs/ to where Sphinx reads them."""
    for pattern in OUTSIDE:
        for path in ROOT.glob(pattern):
            copy = GENERATED / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)


def read_notebook(app, name, source):
    """Make Markdown of a notebook: its texts, and its code as blocks."""
    if app.env.doc2path(name).suffix != ".ipynb":
        return
    fences = {"markdown": ("", ""), "code": ("```python\n", "\n```")}
    parts = []
    for cell in json.loads(source[0])["cells"]:
        before, after = fences[cell["cell_type"]]
        parts.append(before + "".join(cell["source"]) + after)
    source[0] = "\n\n".join(parts)


def link_outside(app, name, source):
    """Point links between docs/ and the outside at those copies."""
    outside = (
        r"\]\((?:\.\./)*(ARCHITECTURE|CHANGELOG|CONTRIBUTING|SECURITY|benchmarks/results/\w+)\.md"
    )
    text = re.sub(outside, r"](/generated/\1.md", source[0])
    source[0] = re.sub(r"\]\((?:\.\./)*docs/", "](/", text)


def link_gallery(app, name, source):
    """Link the names of lamps in the gallery to their pages, where there are any."""
    if name == "gallery":
        for page in EXTRA.glob("gallery/*.html"):
            link = f'<a href="gallery/{page.name}">{page.stem}: open</a>'
            source[0] = source[0].replace(f"**{page.stem}**", link)


def setup(app):
    app.connect("builder-inited", copy_outside, priority=1)
    # In this order: links are changed in Markdown.
    app.connect("source-read", read_notebook, priority=400)
    app.connect("source-read", link_outside)
    app.connect("source-read", link_gallery)
