"""Sphinx configuration: prose in Markdown (MyST), the API from docstrings. Needs no GPU."""

import lumitree

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
exclude_patterns = ["_build"]
source_suffix = {".md": "markdown"}

myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"lumitree {release}"
html_show_sphinx = False
