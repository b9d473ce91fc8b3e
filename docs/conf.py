"""Configuration of the documentation."""

project = "imgscale"
author = "The imgscale developers"
copyright = "2026, The imgscale developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
autodoc_typehints = "none"  # the docstrings say it in words
exclude_patterns = ["_build"]
html_theme = "alabaster"
# room for code of 100 columns
html_theme_options = {"page_width": "1200px", "body_max_width": "none"}
html_title = "imgscale"
numpydoc_show_class_members = False
