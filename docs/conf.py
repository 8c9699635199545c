"""Configure Sphinx: ``uv run sphinx-build -W docs docs/_build/html``."""

import inspect
import re
import tempfile
import zlib
from pathlib import Path

import gymnasium.core
import numpy.typing as npt
from docutils import nodes
from gymnasium.envs.registration import EnvSpec
from sphinx import addnodes
from sphinx.util.typing import stringify_annotation

import shape_obs

DOCS = Path(__file__).parent

# Gymnasium imports it for type checkers only; without it no type in a subclass of Env or Wrapper can be resolved.
gymnasium.core.__dict__["EnvSpec"] = EnvSpec

project = "shape_obs"
author = "the shape_obs developers"
copyright = f"2026, {author}"
version = release = shape_obs.__version__

extensions = ["myst_parser", "sphinx_copybutton", "sphinx_design", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
extensions += ["sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx.ext.intersphinx"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build"]

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autodoc_class_signature = "mixed"  # "separated" lists __init__ and __new__
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autosummary_generate = False
napoleon_numpy_docstring = False
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = f"shape_obs {version}"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
templates_path = ["_templates"]


def inventory(name):
    """Write the inventory of another project from a text file, since a build must not need the network."""
    address, *lines = (DOCS / "inventories" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    entries = []
    for line in lines:
        role, target, page = line.split()
        anchor = "" if "generated" in page else "#$"
        entries.append(f"{target} {role} 1 {page}{anchor} -\n")
    head = f"# Sphinx inventory version 2\n# Project: {name}\n# Version:\n# The remainder is compressed using zlib.\n"
    path = Path(tempfile.gettempdir()) / f"shape_obs_docs_{name}.inv"
    path.write_bytes(head.encode() + zlib.compress("".join(entries).encode()))
    return address, str(path)


intersphinx_mapping = {name: inventory(name) for name in ("python", "numpy", "gymnasium", "stable_baselines3")}

# What autodoc resolves a type to, and what the source and the reader call it.
TYPES = {
    re.escape(stringify_annotation(npt.ArrayLike, "smart")): "~numpy.typing.ArrayLike",
    r"~numpy\.ndarray\[tuple\[(?:~typing\.)?Any, \.\.\.\], ~numpy\.dtype\[(.+?)\]\]": r"~numpy.typing.NDArray[\1]",
    r"~gymnasium\.core\.(\w+)": r"~gymnasium.\1",
    r"~gymnasium\.spaces\.\w+\.(\w+)": r"~gymnasium.spaces.\1",
    r"~numpy\.random\._generator\.Generator": "~numpy.random.Generator",
}
ARRAY = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")


def shorten_signature(app, what, name, obj, options, signature, annotation):
    """Write types as they are written in the source."""
    for long, short in TYPES.items():
        signature = signature and re.sub(long, short, signature)
        annotation = annotation and re.sub(long, short, annotation)
    return signature, annotation


def type_attributes(app, what, name, obj, options, lines):
    """Write the types of an ``Attributes:`` section next to the names, as for properties."""
    text = "\n".join(lines)
    for entry in re.findall(r"^\.\. attribute:: .+\n(?:[ ].*\n|\n)*", text + "\n", re.MULTILINE):
        typed = re.search(r"\n   :type: (.+)\n", entry)
        if typed:
            annotation = re.sub(r"(?<![\w.])(?=(?:\w+\.)+\w)", "~", typed[1])
            rest = entry.replace(typed[0], "\n")
        else:
            member = getattr(obj, entry.split()[2], None)
            getter = getattr(member, "fget", None) or getattr(member, "func", None)  # of a (cached) property
            if getter is None:
                continue
            annotation, rest = stringify_annotation(inspect.signature(getter).return_annotation, "smart"), entry
        annotation = shorten_signature(app, what, name, obj, options, None, annotation)[1]
        head, rest = rest.split("\n", 1)
        text = text.replace(entry.rstrip("\n"), f"{head}\n   :type: {annotation}\n{rest}".rstrip("\n"))
    lines[:] = text.split("\n")


def shorten_properties(app, doctree):
    """Do the same for the types of properties, which have no signature."""
    for annotation in doctree.findall(addnodes.desc_annotation):
        text = annotation.astext()
        if ARRAY.search(text):
            annotation.children = [nodes.Text(ARRAY.sub(r"NDArray[\1]", text))]


def setup(app):
    """Connect the functions above."""
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("autodoc-process-docstring", type_attributes, priority=900)  # after napoleon
    app.connect("doctree-read", shorten_properties)
