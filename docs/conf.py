"""How the documentation site is built: sphinx-build -W docs docs/_build (see docs/contributors.md)."""

import functools
import gc
import sys
from pathlib import Path

from jinja2.sandbox import SandboxedEnvironment
from numpydoc import docscrape_sphinx
from sphinx.pycode.parser import DefinitionFinder
from sphinx.search.en import SearchEnglish

import optkit

# Nearly all that a build makes stays to its end: to look for garbage in it takes a third of the time.
gc.disable()

# numpydoc makes an environment for each docstring, and so would compile its template a thousand times.
environments: dict[type, SandboxedEnvironment] = {}
docscrape_sphinx.SandboxedEnvironment = lambda loader: environments.setdefault(
    type(loader), SandboxedEnvironment(loader=loader)
)

# The lines at which definitions begin and end are for links to sources, of which there are none.
DefinitionFinder.parse = lambda self: None

# The same few thousand words stand on page after page.
SearchEnglish.stem = functools.cache(SearchEnglish.stem)

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "optkit"
author = "The optkit developers"
release = version = optkit.__version__

# mathml, commands and names are in _ext.
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "mathml", "commands", "names"]
exclude_patterns = ["_build", "_ext"]
nitpicky = True

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

# Quotes and dots, but no dashes: --help is an option.
smartquotes_action = "qe"

html_theme = "furo"
html_title = "optkit"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
# Summaries are fetched when somebody searches, which no browser allows without a server.
html_show_search_summary = False
html_show_copyright = False
html_show_sphinx = False
html_math_renderer = "mathml"
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"

# Types stand in the docstrings, with their shapes and units.
autodoc_typehints = "none"
autodoc_use_type_comments = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
add_module_names = False
numpydoc_show_class_members = False
