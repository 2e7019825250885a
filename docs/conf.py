"""Settings of the documentation site: ``make docs`` builds it into ``docs/_build/html``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

DOCS: Final = Path(__file__).parent
sys.path[:0] = [str(DOCS)]  # for the extensions of this folder

import loi_mitsuba  # noqa: E402, F401 - before Dr.Jit is imported, so that it gets an LLVM that works
from loi_core import __version__  # noqa: E402 - the path is set before

project = "loi"
author = "The loi authors"
copyright = author  # noqa: A001 - Sphinx's name for it
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "site_public_names",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "images/**"]

# Markdown: every heading has the anchor that GitHub gives it.
myst_heading_anchors = 4

# Docstrings say types in words, with shapes and units; annotations would repeat half of that.
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"loi {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [("play.js", {"defer": "defer"})]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#9a3412", "color-brand-content": "#9a3412"},
    "dark_css_variables": {"color-brand-primary": "#fdba74", "color-brand-content": "#fdba74"},
}
html_copy_source = False
copybutton_selector = "div.highlight-python pre, div.highlight-sh pre, div.highlight-toml pre"

linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_anchors = False  # the build checks the anchors within this site

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "ignore_pattern": r"(^|/)(?!plot_)[^/]*\.py$",  # shared helpers of the scripts
    "write_computation_times": False,
    "plot_gallery": os.environ.get("GALLERY") != "0",  # "0" shows the scripts without running them
    "download_all_examples": False,
    "show_memory": False,
}
