"""Settings of Sphinx: `make docs` builds the pages of this folder and an API reference into build/docs."""

from __future__ import annotations

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "Beam rig suite"
author = "beam_ros maintainers"
release = version = installed_version("beam_ros")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docstring_dialect",
    "api_pages",
    "tree_pages",
]

source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_heading_anchors = 4

# The packages whose public names get a page for every room.
api_packages = [
    "beam_model",
    "beam_ident",
    "beam_ros.interfaces",
    "beam_ros.rig",
    "beam_ros.hub",
    "beam_ros.vision",
    "beam_ros.messages",
    "beam_ros.bags",
    "beam_ros.excitation",
    "beam_ros.calibration",
    "beam_ros.offline",
]

suppress_warnings = [
    "ref.python"
]  # two rooms may have a class of one name: its type is then shown without a link

autodoc_typehints = "none"  # types stand in the docstrings, with shapes and units
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]  # a list of names, without a link from each
napoleon_use_rtype = False

smartquotes = False  # x' is a derivative

html_theme = "furo"
html_title = f"Beam rig suite {release}"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_static_path = ["extensions/pages.css"]
html_css_files = ["pages.css"]
