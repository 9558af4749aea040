"""The page is whole by itself, can be read by anybody, and is safe.

Names of files and channels are text on it, whatever they hold.
"""

import re
import sys

import numpy as np
import pytest
from html_page import Page, figures, traces
from report_cases import NASTY, cubic, loop_report, nasty_report, record, regressor

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    datasets,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import MissingExtraError, NRFError
from pysindy_nrf.report import as_html, write_html

pytest.importorskip("jinja2", reason="the page needs the extra 'report'")
pytest.importorskip("plotly", reason="the page needs the extra 'report'")

KINDS = ("loop", "regressor", "model", "nasty")
MEGABYTE = 1e6
LIBRARY = re.compile(r'<script [^>]*id="plotly".*?</script>', re.DOTALL)


@pytest.fixture(scope="module")
def loop_page():
    return as_html(loop_report())


@pytest.fixture(scope="module")
def pages(loop_page):
    model, rec = regressor()
    return {
        "loop": Page(loop_page),
        "regressor": Page(as_html(model, rec)),
        "model": Page(as_html(model.model_)),
        "nasty": Page(as_html(nasty_report())),
    }


# -- whole by itself -----------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_page_is_well_formed(pages, kind):
    assert pages[kind].is_well_formed


@pytest.mark.parametrize("kind", KINDS)
def test_page_asks_nothing_of_a_network(pages, kind):
    shown = pages[kind]
    for _, attrs in shown.elements:
        assert "src" not in attrs
        assert attrs.get("href", "#").startswith("#")

    metas = shown.all("meta")
    policies = [meta["content"] for meta in metas if "http-equiv" in meta]
    assert len(policies) == 1
    assert "default-src 'none'" in policies[0]
    assert "http" not in policies[0]


@pytest.mark.parametrize("kind", KINDS)
def test_page_runs_no_script_but_its_own(pages, kind):
    shown = pages[kind]
    assert len(shown.all("script")) == 3
    handlers = [name for _, attrs in shown.elements for name in attrs]
    assert not [name for name in handlers if name.startswith("on")]


def own_size(page):
    """Bytes of a page without the plotting library, which differs by its version."""
    own, n_libraries = LIBRARY.subn("", page)
    assert n_libraries == 1
    return len(own.encode())


def test_a_loop_adds_little_to_the_plotting_library(loop_page):
    assert own_size(loop_page) < 0.3 * MEGABYTE


def test_a_fit_adds_little_to_the_plotting_library():
    demo = datasets.load_demo()
    text = as_html(NRFRegressor(degree=3).fit(demo), [demo])
    assert own_size(text) < 0.3 * MEGABYTE


@pytest.mark.slow
def test_a_tall_building_adds_little_to_the_plotting_library():
    storey = [laws.LinearElastic(1e5), laws.LinearViscous(60.0)]
    floors = ChainModel([10.0] * 10, {j: storey for j in range(1, 11)})
    force = excitation.band_limited_random(
        10, 8.0, 500.0, excited=10, rms=100.0, band=(1, 60), random_state=0
    )
    tall = simulate(floors, force, 1 / 500)
    text = as_html(NRFRegressor(degree=3).fit(tall), [tall])
    assert own_size(text) < 0.4 * MEGABYTE


@pytest.mark.parametrize("missing", ["plotly.offline", "jinja2"])
def test_without_its_extra_the_old_page_stays(monkeypatch, tmp_path, missing):
    old = tmp_path / "report.html"
    old.write_text("before")
    model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})

    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match=r"pysindy_nrf\[report\]"):
        write_html(old, model)

    assert old.read_text() == "before"
    assert list(tmp_path.iterdir()) == [old]


def test_a_new_page_takes_the_place_of_the_old_one(tmp_path):
    old = tmp_path / "report.html"
    old.write_text("before")
    write_html(old, ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])}))
    assert old.read_text().startswith("<!doctype html>")


def test_other_things_are_refused():
    with pytest.raises(NRFError, match="cannot be reported"):
        write_html("never.html", {"masses": [1.0]})


# -- read without eyes or mouse ------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_links_lead_to_places_of_the_page(pages, kind):
    shown = pages[kind]
    targets = [link["href"].removeprefix("#") for link in shown.all("a")]
    assert len(shown.ids) == len(set(shown.ids))
    assert set(targets) <= set(shown.ids)
    assert targets[0] == "main"


@pytest.mark.parametrize("kind", KINDS)
def test_headings_go_down_by_one(pages, kind):
    headings = [
        tag for tag in pages[kind].tags if tag in ("h1", "h2", "h3", "h4", "h5")
    ]
    levels = np.array([int(tag[1]) for tag in headings])
    assert levels[0] == 1
    assert (levels[1:] > 1).all()
    assert np.diff(levels).max() <= 1


@pytest.mark.parametrize("kind", KINDS)
def test_figures_are_described_and_turn_by_keys(pages, kind):
    plots = pages[kind].of_class("plot")
    assert min(len(plot["aria-label"]) for plot in plots) > 30
    for surface in pages[kind].of_class("turns"):
        assert surface["tabindex"] == "0"


@pytest.mark.parametrize("kind", KINDS)
def test_tables_have_captions_and_heads(pages, kind):
    shown = pages[kind]
    assert len(shown.all("caption")) == len(shown.all("table")) > 2
    assert all("scope" in head for head in shown.all("th"))
    assert shown.all("html")[0]["lang"] == "en"


def test_every_figure_is_drawn_and_has_its_numbers(loop_page):
    drawn = figures(loop_page)
    assert len(drawn) >= 12
    shown = Page(loop_page)
    in_frames = len(shown.of_class("card")) - len(shown.of_class("mode"))
    assert in_frames == len(drawn)

    numbers = [figure["numbers"] for figure in drawn.values() if figure["numbers"]]
    assert len(numbers) >= len(drawn) - 3
    for table in map(Page, numbers):
        assert table.is_well_formed
        assert len(table.all("tr")) > 1


def test_figures_are_of_all_kinds(loop_page):
    kinds = {trace["type"] for trace in traces(loop_page)}
    assert {"surface", "scatter3d", "scatter", "bar"} <= kinds


def test_numbers_under_the_pointer_have_their_units(loop_page):
    templates = {}
    for figure in figures(loop_page).values():
        if "yaxis" in figure["layout"]:
            title = figure["layout"]["yaxis"]["title"]["text"]
            templates[title] = figure["data"][0]["hovertemplate"]

    force = templates["force R<sub>1</sub> (N)"]
    assert "%{x:.4g} mm<br>" in force
    assert "%{y:.4g} N<" in force
    error = templates["held-out balance error (% NRMSE)"]
    assert "%{x}<br>" in error
    assert "%{y:.4g} % NRMSE" in error


# -- safe ----------------------------------------------------------------------


def test_markup_from_files_stays_text(pages):
    shown = pages["nasty"]
    assert shown.all("img") == []
    assert NASTY in shown.text


def test_markup_from_files_stays_text_in_markdown():
    assert "<img" not in nasty_report().to_markdown()


def test_markup_from_files_stays_text_in_notebooks():
    wave = np.sin(np.arange(50.0))
    nasty = Record(
        displacement=wave[:, None], fs=10.0, name=NASTY, covariates={NASTY: wave}
    )
    view = nasty._repr_html_()
    assert "<img" not in view
    assert "&lt;img" in view


def test_markup_of_the_user_stays_text(tmp_path):
    model, rec = regressor()
    path = tmp_path / "r.html"
    write_html(path, model, rec, notes=["the roof was <wet>"], title="Frame & shaker")
    shown = Page(path.read_text())
    assert "the roof was <wet>" in shown.text
    assert "Frame & shaker" in shown.text
    assert shown.all("wet") == []


@pytest.mark.parametrize("kind", ["loop", "model", "record"])
def test_notebook_views_are_small_and_well_formed(kind):
    views = {
        "loop": (loop_report(), "storey 2"),
        "model": (regressor()[0].model_, "<math"),
        "record": (record(cubic), "displacement"),
    }
    shown, holds = views[kind]
    view = shown._repr_html_()
    assert holds in view
    assert len(view) < 20_000
    assert Page(view).is_well_formed
