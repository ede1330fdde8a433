"""The site: ``pip install ".[docs]" && sphinx-build -W docs site``. Nothing is asked of the net."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import clplen

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))
# tutorials call the clplen that is documented
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["COLUMNS"] = "84"  # characters that a page shows without scrolling

project = "clplen"
author = "The clplen developers"
copyright = "2026, the clplen developers"
release = version = clplen.__version__

extensions = [
    "myst_nb",  # Markdown, and tutorials that run
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    # ours, in extensions/
    "api_examples",
    "api_pages",
    "claims_tables",
    "command_pages",
    "figure_pages",
    "name_links",
    "stream_output",
    "toml_tables",
]
exclude_patterns = ["site", "extensions/templates"]
templates_path = ["extensions/templates"]
nitpicky = False
suppress_warnings = ["config.cache"]  # functions in this file are no part of a cached state

# Markdown
myst_enable_extensions = ["colon_fence", "dollarmath", "substitution"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
nb_execution_mode = os.environ.get("CLPLEN_TUTORIALS", "force")  # "off": shown without results
nb_execution_timeout = 300  # seconds a cell, on two cores that tests use as well
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_merge_streams = True

smartquotes = False  # options begin with two hyphens, also in text

# docstrings
autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"  # the sections say the types
autodoc_member_order = "groupwise"
numpydoc_show_class_members = False  # the page of a class lists its methods
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = False  # name_links does this
default_role = "py:obj"

# pages
html_theme = "pydata_sphinx_theme"
html_title = "clplen"
html_static_path = ["static"]
html_favicon = "static/logo.svg"
html_css_files = ["clplen.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_copy_source = False
html_search_scorer = str(HERE / "extensions" / "search_scorer.js")
html_show_sourcelink = False
html_sourcelink_suffix = ""
html_last_updated_fmt = None
html_theme_options = {
    "logo": {
        "text": "clplen",
        "image_light": "static/logo.svg",
        "image_dark": "static/logo.svg",
        "alt_text": "clplen, start page",
    },
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "show_nav_level": 1,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "article_header_start": ["breadcrumbs"],
    "secondary_sidebar_items": ["page-toc"],
}
html_sidebars = {"gallery/**": [], "index": [], "tutorials/index": [], "howto/index": []}
mathjax_path = "mathjax/tex-svg.js"  # shipped: the site is read without a network
copybutton_prompt_text = r">>> |\.\.\. |\$ |In \[\d*\]: "
copybutton_prompt_is_regexp = True
