"""Settings of the site: ``python -m sphinx -W docs build/site``."""

import logging
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_site"))

import bayesftc

project = "bayesftc"
author = "The bayesftc developers"
copyright = author
version = release = bayesftc.__version__

extensions = [
    "myst_nb",  # Markdown pages and notebooks
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # the site needs no other address, also not for mathematics
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "public_names",
    "drawn",
    "file_keys",
    "inherited_parameters",
    "linked_names",
    "repository_files",
]
root_doc = "index"
exclude_patterns = ["_site", "gallery_examples", "gallery/**/*.ipynb", "**/.executed"]
default_role = "py:obj"  # what stands in single backticks in a docstring

mathjax3_config = {"options": {"enableMenu": False}}  # with its menu, each formula is a stop of the Tab key

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]  # as GitHub writes formulas

# The three notebooks are executed when they change.
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent / "notebooks" / ".executed")
nb_execution_timeout = 300
nb_execution_raise_on_error = True

# Each script of the gallery is executed when it changes. Its page does not depend on what this machine has compiled before.
logging.getLogger("bayesftc").setLevel("WARNING")
sphinx_gallery_conf = {
    "examples_dirs": ["gallery_examples"],
    "gallery_dirs": ["gallery"],
    "within_subsection_order": "FileNameSortKey",
    "backreferences_dir": "gallery/uses",
    "doc_module": ("bayesftc",),
    "capture_repr": ("_repr_html_",),
    "ignore_repr_types": r"matplotlib|NotebookAnimation",  # shown as figures
    "matplotlib_animations": True,
    "reset_modules": ("matplotlib",),
    "show_memory": False,
    "write_computation_times": False,  # their pages take scripts from other addresses
    "show_signature": False,
    "remove_config_comments": True,
    "plot_gallery": "True",
    "run_stale_examples": False,
    "abort_on_example_error": False,
    "only_warn_on_example_error": False,
    "download_all_examples": False,
    "min_reported_time": 10,
    "thumbnail_size": (400, 280),
}

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
html_favicon = "_site/static/favicon.svg"
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_sidebars = {page: [] for page in ("index", "versions", "project/changelog", "search", "genindex")}  # of no part
html_search_scorer = str(Path(__file__).parent / "_site" / "scorer.js")  # the order of results
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "bayesftc"},
    "navbar_end": ["version", "theme-switcher"],
    "navbar_align": "left",
    "header_links_before_dropdown": 7,  # all parts; the changelog is under "More"
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
