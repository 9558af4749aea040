"""Sphinx configuration: ``sphinx-build -W docs docs/_build/html``."""

import os
import sys
import warnings
from importlib import import_module
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx_gallery.sorting import FileNameSortKey

import pysindy_nrf

sys.path.insert(0, str(Path(__file__).parent))
law_catalogue = import_module("law_catalogue")

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

project = "pysindy_nrf"
author = "pysindy_nrf developers"
copyright = "pysindy_nrf developers"
release = pysindy_nrf.__version__
version = release

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "_build",
    "gallery/*.ipynb",
    "gallery/*.py",
    "gallery/*.md5",
    "gallery/*.json",
]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

templates_path = ["_templates"]
autosummary_generate = True
suppress_warnings = ["config.cache"]
autodoc_typehints = "none"
numpydoc_show_class_members = False

html_math_renderer = "mathml"  # formulas need neither a network nor a script
html_theme = "pydata_sphinx_theme"
html_title = "pysindy_nrf"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "use_edit_page_button": False,
    "navbar_center": [],
}
html_sidebars = {"**": ["globaltoc.html"]}
html_static_path = ["_static"]
html_css_files = ["narrow.css"]
html_show_sourcelink = False
html_context = {"default_mode": "auto"}

# Examples that read measured records run where PYSINDY_NRF_DATA names their folder.
measured = os.environ.get("PYSINDY_NRF_DATA")
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    # Files that are no plot_*.py hold what the examples share.
    "ignore_pattern": r"^(?!plot_)" if measured else r"^(?!plot_)|_measured",
    "within_subsection_order": FileNameSortKey,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,  # its page asks a network for a script
    "abort_on_example_error": True,
}

# A figure is drawn to a file and to the page alike.
warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")


def _skip_routing(app, what, name, obj, skip, options):
    """The metadata methods that scikit-learn adds to every estimator are described
    there.
    """
    return (
        True
        if name.startswith("set_")
        and name.endswith("_request")
        or name == "get_metadata_routing"
        else skip
    )


def _mathml(display):
    """A visitor that writes a formula as MathML."""

    def visit(translator, node):
        latex = node.astext()
        rows = (
            r"\begin{aligned}" + latex + r"\end{aligned}"
            if r"\\" in latex and r"\begin" not in latex
            else latex
        )
        formula = convert(rows, display=display)
        if display == "block":  # a long one scrolls by itself on a narrow screen
            formula = f'<div style="overflow-x: auto; margin: 1em 0">{formula}</div>'
        translator.body.append(formula)
        raise nodes.SkipNode

    return visit, None


def setup(app):
    app.add_html_math_renderer(
        "mathml", inline_renderers=_mathml("inline"), block_renderers=_mathml("block")
    )
    app.connect(
        "builder-inited",
        lambda app: law_catalogue.write(Path(app.srcdir) / "generated"),
    )
    app.connect("autodoc-skip-member", _skip_routing)
