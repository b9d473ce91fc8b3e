"""Configuration of the documentation; nothing in it, and nothing built by it, needs a network."""

import enum
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE))

project = "imgscale"
author = "The imgscale developers"
copyright = "2026, The imgscale developers"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "_ext.links",
    "_ext.mathml",
    "_ext.plots",
    "_ext.prior_rows",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
templates_path = ["_templates"]
default_role = "literal"  # single backticks in docstrings are names
nitpicky = True

# --- pages

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
highlight_options = {"python": {"stripnl": True}}  # doctests end with an empty line
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# --- the reference

autosummary_generate = sorted(page.name for page in _HERE.glob("api*.md"))
autosummary_filename_map = {  # one file where upper case does not count
    "imgscale.measuring.Extent": "imgscale.measuring.Extent-class"
}
autodoc_typehints = "none"  # the docstrings say it in words
numpydoc_show_class_members = False
toc_object_entries_show_parents = "hide"

# --- the gallery, and the figures of pages

_WITHOUT_RAY = "" if find_spec("ray") else "(?!parquet_with_ray)"  # shown, but not run
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": rf"/{_WITHOUT_RAY}[a-z]\w*\.py$",
    "ignore_pattern": r"/_\w*\.py$",
    "within_subsection_order": "ExampleTitleSortKey",
    "abort_on_example_error": True,
    "image_scrapers": ("matplotlib",),
    "reset_modules": ("matplotlib",),
    "backreferences_dir": "gallery/backreferences",
    "doc_module": ("imgscale",),
    "log_level": {"backreference_missing": "info"},
    "capture_repr": ("_repr_html_",),
    "notebook_extensions": set(),
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
}

plot_formats = [("png", 100)]
plot_html_show_formats = False
plot_html_show_source_link = False

# --- what it looks like

html_theme = "furo"
html_title = "imgscale"
html_static_path = ["_static"]
html_css_files = ["imgscale.css"]
html_show_sourcelink = False
html_copy_source = False
_COLOURED = ("brand-primary", "brand-content", "api-name", "api-pre-name")
html_theme_options = {
    "light_css_variables": {f"color-{part}": "#0b5c8a" for part in _COLOURED},
    "dark_css_variables": {f"color-{part}": "#56b4e9" for part in _COLOURED},
}


def _without_call(  # what autodoc passes
    _app: Sphinx,
    _kind: str,
    _name: str,
    documented: Any,
    _options: Any,
    arguments: str,
    returns: str,
) -> tuple[str, str] | None:
    """Leave the arguments out of what nobody calls: protocols and enumerations."""
    uncalled = isinstance(documented, enum.EnumType) or getattr(documented, "_is_protocol", False)
    return ("", returns) if uncalled and arguments else None


def _remove_stale(_app: Sphinx) -> None:
    """Remove generated pages of names and examples that are gone; they would be orphans."""
    shutil.rmtree(_HERE / "api", ignore_errors=True)
    for page in (_HERE / "gallery").glob("*.rst"):
        if page.stem != "index" and not (_HERE.parent / "examples" / f"{page.stem}.py").exists():
            page.unlink()


def _load_lazily(app: Sphinx) -> None:
    """Let browsers load pictures when they come into view."""
    app.env.settings["image_loading"] = "lazy"


def setup(app: Sphinx) -> None:
    """Connect what no extension does."""
    app.connect("builder-inited", _load_lazily)
    app.connect("builder-inited", _remove_stale, priority=0)
    app.connect("autodoc-process-signature", _without_call)
