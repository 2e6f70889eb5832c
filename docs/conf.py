"""Configuration of the documentation; `./scripts/docs` builds it."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "extensions")]

import ziamath  # noqa: E402

import spatial_pin  # noqa: E402

project = "spatial_pin"
author = "spatial_pin developers"
copyright = author
version = release = spatial_pin.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "citations",
    "formulas",
    "public_names",
    "library_pages",
    "still_to_come",
]
exclude_patterns = ["_build", "extensions"]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_ambiguous"]
default_role = "literal"

autodoc_member_order = "groupwise"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False
python_display_short_literal_types = True
python_maximum_signature_line_length = 88
add_module_names = False

html_theme = "furo"
html_title = "spatial_pin"
html_math_renderer = "mathml"
# a font whose brackets and roots grow with what they enclose; few readers have one
html_static_path = ["static", f"{Path(ziamath.__file__).parent}/fonts/STIXTwoMath-Regular.ttf"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_ignore = [r"http://127\.0\.0\.1.*"]
