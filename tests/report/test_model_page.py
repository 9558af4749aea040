"""The page of a model shows its equations, its forces and how well they fit."""

import re
import warnings

import numpy as np
import pytest
from chains import driven
from html_page import Page, figures, traces
from report_cases import K3, C, K, regressor

from pysindy_nrf import ChainModel, NRFRegressor, Record, datasets, laws, simulate
from pysindy_nrf.report import as_html, content_of, identification_of, write_html

pytest.importorskip("jinja2", reason="the page needs the extra 'report'")
pytest.importorskip("plotly", reason="the page needs the extra 'report'")

SI = {"m": 1.0, "mm": 1e-3, "m/s": 1.0, "mm/s": 1e-3, "N": 1.0, "kN": 1e3}


def unit_of(title):
    """The factor to SI of the unit in the title of an axis."""
    return SI[re.search(r"\((.*)\)", title)[1]]


@pytest.fixture(scope="module")
def surface():
    """The surface of storey 2 of a cubic spring, as it is drawn."""
    for figure in figures(as_html(regressor()[0].model_)).values():
        scene = figure["layout"].get("scene")
        if scene and "s<sub>2</sub>" in scene["xaxis"]["title"]["text"]:
            return figure


def test_surface_is_the_restoring_force_where_the_data_were(surface):
    layout = surface["layout"]
    top = surface["data"][0]
    drift = unit_of(layout["scene"]["xaxis"]["title"]["text"]) * np.array(top["x"])
    rate = unit_of(layout["scene"]["yaxis"]["title"]["text"]) * np.array(top["y"])
    force = np.array(top["z"], dtype=float)
    force *= unit_of(layout["annotations"][0]["text"])

    s, v = np.meshgrid(drift, rate)
    drawn = np.isfinite(force)
    region = regressor()[0].model_.visited["storey 2"]
    assert drawn.any()
    assert not drawn.all()
    assert region.contains(v, s)[drawn].mean() > 0.98

    truth = K[1] * s + C[1] * v + K3 * s**3
    largest = np.abs(truth[drawn]).max()
    assert np.abs(force - truth)[drawn].max() < 0.02 * largest


def test_force_that_depends_on_the_path_is_drawn_as_a_path():
    hysteresis = [laws.LinearElastic(1e4), laws.Dahl(sigma=1e4, Fd=20.0)]
    model = ChainModel([10.0], {1: hysteresis})
    t = np.arange(3000)[:, None] / 500
    x = 2e-3 * np.sin(7 * t)
    rec = Record(
        displacement=x,
        velocity=14e-3 * np.cos(7 * t),
        acceleration=-49 * x,
        force=0 * x + 1e-9,
        fs=500.0,
    )
    kinds = {trace["type"] for trace in traces(as_html(model, rec))}
    assert "surface" not in kinds
    assert "scatter3d" in kinds


def test_modes_move_with_their_ratio_of_frequencies():
    """Half cycles of style are as the periods of the modes; floors slide by shapes."""
    model = regressor()[0].model_
    shown = Page(as_html(model))
    half = [float(a["style"][7:-1]) for a in shown.all("svg") if "style" in a]
    frequency = model.modes()["frequency"].to_numpy()
    np.testing.assert_allclose(half, 0.4 * frequency[-1] / frequency, rtol=0.02)

    slid = [float(a["style"][5:-2]) for a in shown.all("rect") if "style" in a]
    shapes = model.modes().filter(like="dof").to_numpy()[:, ::-1]
    np.testing.assert_allclose(slid, 28 * shapes.ravel(), atol=0.06)


def test_intervals_and_the_third_law_are_shown():
    model, rec = regressor()
    text = Page(as_html(model, rec)).text
    assert "with 95 % intervals" in text
    assert "Newton's third law" in text


def test_a_page_over_the_records_of_the_fit_is_that_over_its_data():
    demo = datasets.load_demo()
    fitted = NRFRegressor(degree=3).fit(demo)
    over_records = identification_of(fitted, demo)
    over_data = identification_of(fitted)
    for again, first in zip(over_records.data.segments, over_data.data.segments):
        np.testing.assert_array_equal(again.F, first.F)
        # fused floor by floor again: by far less than the noise of 2 %
        np.testing.assert_allclose(again.s, first.s, atol=1e-3 * first.s.std())


@pytest.fixture(scope="module")
def missing_terms(tmp_path_factory):
    """The table of missing terms on the page of a linear fit to a cubic storey."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    with warnings.catch_warnings(action="ignore"):
        linear = NRFRegressor(degree=1).fit(datasets.load_demo())
        write_html(path, linear, datasets.load_demo())
    rest = path.read_text("utf-8").split("What terms beyond the laws would explain")[-1]
    return rest.split("</table>")[0]


def test_what_further_terms_would_explain_has_units(missing_terms):
    assert "residual (% of its force)" in missing_terms
    assert "mass moves with them by (%)" in missing_terms


def test_the_balance_that_lacks_a_law_is_marked(missing_terms):
    body = missing_terms.split("<tbody>")[1]
    rows = re.findall(r"<tr>(.*?)</tr>", body, re.DOTALL)
    biased = [row for row in rows if ">yes<" in row]
    assert len(rows) == 3
    assert len(biased) == 1
    assert "balance of DOF 1" in biased[0]


def empty_upper_storey():
    """A model whose storey 2 holds no law, and a record of it."""
    lower = laws.PowerSeries(1, [30.0, 4e4])
    model = ChainModel([8.0, 6.0], {"storey 1": [lower], "storey 2": []})
    return model, driven(model, [1], 4.0, 500.0, 60.0, (1, 40))


def test_a_storey_without_a_law_is_no_section():
    content = content_of(*empty_upper_storey())
    assert [section.site for section in content.model.sites] == ["storey 1"]
    assert content.frame.storeys[1].state == ""


def test_an_unknown_force_is_named_among_what_was_measured():
    model, rec = empty_upper_storey()
    hidden = rec.replace(force=np.full_like(rec.force, np.nan))
    content = content_of(model, hidden)
    assert content.measured[0].record.unknown == (1, 2)
    assert "unknown on every DOF" in content.care[0]


def test_a_law_that_reads_the_motion_of_the_base_is_drawn():
    """Friction against the ground slides with the velocity of the base."""
    storey = [laws.LinearElastic(4e4), laws.LinearViscous(30.0)]
    ground = [laws.GroundFriction(5.0)]
    model = ChainModel([10.0], {"storey 1": storey, "dof 1": ground})
    t = np.arange(4000) / 500
    ag = np.sin(12 * t) * np.sin(t)
    plain = ChainModel([10.0], {"storey 1": storey})
    rec = simulate(plain, np.zeros((4000, 1)), 1 / 500, base_acceleration=ag)
    content = content_of(model, rec)
    sites = {section.site: section for section in content.model.sites}
    assert sites["dof 1"].figures
