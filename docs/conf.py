"""Settings of the site: ``python -m sphinx -W docs build/site``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_site"))

import bayesftc

project = "bayesftc"
author = "The bayesftc developers"
copyright = author
version = release = bayesftc.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # the site needs no other address, also not for mathematics
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
    "public_names",
    "drawn",
    "file_keys",
    "linked_names",
    "repository_files",
]
root_doc = "index"
exclude_patterns = ["_site"]
default_role = "py:obj"  # what stands in single backticks in a docstring

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]  # as GitHub writes formulas

# Each public name has a page of its own, from the signature and the docstring (`_site/public_names.py`).
autosummary_generate = True
autodoc_typehints = "none"  # the docstring has them with shapes and units
autodoc_member_order = "bysource"
autodoc_default_options = {
    "exclude-members": "set_fit_request, set_score_request"
}  # scikit-learn adds them to each class
numpydoc_show_class_members = False
templates_path = ["_site/templates"]

html_theme = "pydata_sphinx_theme"
html_title = f"bayesftc {version}"
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "bayesftc"},
    "navbar_align": "left",
    "navigation_depth": 3,
    "show_toc_level": 2,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
