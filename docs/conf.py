"""The documents' site: Sphinx with MyST. `make docs` builds it into build/docs and checks it."""

import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # what the reference is made from is imported where it lies

from docs import docstrings, reference  # noqa: E402

project = "Rollcast"
author = "the Rollcast authors"
project_copyright = "the Rollcast authors, Apache License 2.0"
version = release = reference.package_version(ROOT / "pyproject.toml")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["decisions/0000-template.md", f"{reference.FOLDER}/{reference.PARTS}/*"]

myst_enable_extensions = ["colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 3
# The notebook holds its outputs: `python -m docs.notebook` makes them, and a test executes it.
nb_execution_mode = "off"
nb_merge_streams = True

autodoc_mock_imports = ["pybullet"]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88

nitpicky = True
# Names of other packages: their inventories lie on other hosts, and the site is built without any.
nitpick_ignore_regex = [
    (
        "py:.*",
        r"(annotated_types|collections|httpx2|jaxtyping|numpy|np|pandas|pathlib|PIL|pydantic"
        r"|pydantic_core|types|typing)\..*|ndarray|DataFrame|NoneType|FieldInfo",
    ),
    # Parts of annotations that are no names: limits, and the axes of arrays.
    ("py:class", r"Ge|Gt|Le|Lt|MinLen|MaxLen|FailFast|Strict|-?[0-9.]+|'.*'"),
    # Protocols and type variables, which say what is accepted and need no page of their own.
    ("py:(class|obj)", r"rollcast\..*\.(Supports\w+|FrameTensor|\w+T|_\w+)"),
    # What sessions of the client are made of.
    ("py:class", r"rollcast\.client\.(calls\.Call|connection\.Target)"),
    ("py:class", r"rollcast\.client\.(fake_session|sessions)\.\w+"),
    # Bodies whose fields only the description of the HTTP API has.
    ("py:class", r"rollcast\.schemas\.(BallPrompt|DetectResponse)|_PydanticGeneralMetadata"),
    # Two attributes that share a description.
    ("py:class", "x"),
]

html_theme = "furo"
html_title = "Rollcast"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#0b5f94",
        "color-brand-content": "#0b5f94",
        "color-brand-visited": "#0b5f94",
    },
    "dark_css_variables": {
        "color-brand-primary": "#7cc4ee",
        "color-brand-content": "#7cc4ee",
        "color-brand-visited": "#7cc4ee",
    },
}
copybutton_exclude = ".linenos, .gp, .go"


def setup(app: Sphinx) -> None:
    """Write the pages that are made from the code before Sphinx looks for pages."""
    app.connect("autodoc-process-docstring", docstrings.mend, priority=100)
    app.connect("config-inited", lambda app, _: reference.write(ROOT, Path(app.srcdir)))
