"""How the book is built: sphinx-build -W notebooks book."""

import json
from pathlib import Path

import symsimpson

project = "symsimpson"
author = "the symsimpson developers"
copyright = author
version = release = symsimpson.__version__

extensions = [
    "myst_nb",  # pages in Markdown, notebooks with the outputs that they have
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",  # a table of names on each page of the reference
    "sphinx_copybutton",
    "numpydoc",
    "sphinx-mathjax-offline",  # formulas without a network connection
]
exclude_patterns = ["README.md", "_build", "**/.ipynb_checkpoints"]
autosummary_generate = False
copybutton_exclude = ".linenos, .gp, .go"

# notebooks are executed in the tests; here they are shown as they were committed
nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["mystnb.unknown_mime_type"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say what is taken and returned
numpydoc_show_class_members = False  # autodoc lists them
numpydoc_class_members_toctree = False

html_theme = "furo"
html_title = f"symsimpson {version}"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_search_scorer = str(Path(__file__).parent / "_static/scorer.js")  # tasks come first


def offer_notebook(app, name, source):
    """Begin each page that is a notebook with a link to it."""
    if Path(app.env.doc2path(name)).suffix == ".ipynb":
        notebook = json.loads(source[0])
        file = f"{Path(name).name}.ipynb"
        note = f"{{download}}`Download this notebook <{file}>` and run it anywhere."
        text = "".join(notebook["cells"][0]["source"])
        notebook["cells"][0]["source"] = f"{text}\n\n{note}"
        source[0] = json.dumps(notebook)


def list_quantities(app, name, source):
    """Write the table of quantities where a page asks for it."""
    from symsimpson.text.quantity import QUANTITIES

    named = {"coordinates": "q1", "constraints": "rod"}
    lines = ["| name | attribute | quantity | in expressions |", "| --- | --- | --- | --- |"]
    for one in QUANTITIES.values():
        key = f'run["{one.prefix}{named[one.axis]}"]' if one.axis else f'run["{one.name}"]'
        known = "yes" if one.symbol else "no"
        lines.append(f"| `{key}` | `run.{one.name}` | {one.doc} | {known} |")
    source[0] = source[0].replace("<!-- quantities -->", "\n".join(lines))


def setup(app):
    """Connect what is done to pages."""
    app.connect("source-read", offer_notebook)
    app.connect("source-read", list_quantities)
