"""Sphinx configuration: `uv run sphinx-build -W docs docs/_build/html`."""

import re

from docutils import nodes

import shape_obs

ARRAY = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")

project = "shape_obs"
author = "the shape_obs authors"
version = release = shape_obs.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
extensions += ["sphinx.ext.intersphinx", "sphinx_copybutton", "sphinx_design"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autodoc_class_signature = "mixed"  # "separated" lists __init__ and __new__
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"shape_obs {version}"
html_static_path = ["_static"]
html_css_files = ["pages.css"]


def shorten_arrays(app, domain, object_type, content):
    """Write the types of arrays as they are written in the source."""
    for text in list(content.findall(nodes.Text)):
        short = ARRAY.sub(r"NDArray[\1]", text)
        if short != text:
            text.parent.replace(text, nodes.Text(short))


def setup(app):
    """Run after autodoc has added the types, before they become links."""
    app.connect("object-description-transform", shorten_arrays, priority=600)
