"""How the book is built: sphinx-build -W notebooks book."""

import symsimpson

project = "symsimpson"
author = "the symsimpson developers"
copyright = author
version = release = symsimpson.__version__

extensions = [
    "myst_nb",  # pages in Markdown, notebooks with the outputs that they have
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx-mathjax-offline",  # formulas without a network connection
]
exclude_patterns = ["README.md", "_build", "**/.ipynb_checkpoints"]

# notebooks are executed in the tests; here they are shown as they were committed
nb_execution_mode = "off"
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
