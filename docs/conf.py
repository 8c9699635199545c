"""Sphinx configuration: `uv run sphinx-build -W docs docs/_build/html`."""

import shape_obs

project = "shape_obs"
author = "the shape_obs authors"
version = release = shape_obs.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

autodoc_class_signature = "separated"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # units and shapes say more, and they are in the docstrings
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"shape_obs {version}"
