# SPDX-License-Identifier: Apache-2.0
"""How Sphinx builds the documents: `make docs`."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

project = "cloth_sim_ros"
author = "cloth_sim_ros maintainers"
copyright = author  # a name that Sphinx gives
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
myst_heading_anchors = 4  # as GitHub has them, so that links lead to headings in both
autodoc_typehints = "none"  # docstrings say units and shapes, which types do not
autodoc_member_order = "bysource"


def setup(app):
    """Docstrings are plain text, in which stars and bars are multiplication and magnitude."""

    def escape(app, what, name, thing, options, lines):
        lines[:] = [line.replace("*", r"\*").replace("|", r"\|") for line in lines]

    app.connect("autodoc-process-docstring", escape)
