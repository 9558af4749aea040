"""The page holds what was measured, found and decided; it is whole by itself and safe
whatever the files hold.
"""

import json
import re
import sys
import warnings
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from chains import driven
from hypothesis import given
from hypothesis import strategies as st
from report_cases import (
    K3,
    NASTY,
    C,
    K,
    cubic,
    loop_report,
    nasty_report,
    record,
    regressor,
)

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    datasets,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.chain.latex import (
    Estimate,
    as_text,
    feature,
    law_equation,
    mathml,
    number,
)
from pysindy_nrf.exceptions import MissingExtraError, NRFError
from pysindy_nrf.report import write_html
from pysindy_nrf.report.content import cautions, lead, of_loop, of_model
from pysindy_nrf.report.write import page

pytest.importorskip("jinja2", reason="the page needs the extra 'report'")
pytest.importorskip("plotly", reason="the page needs the extra 'report'")

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Elements with their attributes, text by element, and the tree's errors."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.texts, self.errors = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), list(self.open)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), list(self.open)))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.errors.append(tag)

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, tag):
        return [attrs for name, attrs, _ in self.elements if name == tag]

    def text(self, *but):
        return " ".join(
            d for tag, d in self.texts if tag not in ("script", "style", *but)
        )


@pytest.fixture(scope="module")
def loop_page():
    return page(loop_report())


@pytest.fixture(scope="module")
def pages(loop_page):
    model, rec = regressor()
    return {
        "loop": Page(loop_page),
        "regressor": Page(page(model, rec)),
        "model": Page(page(model.model_)),
        "nasty": Page(page(nasty_report())),
    }


def figures(text):
    size, packed = re.search(
        r'<script type="text/plain" id="figures" data-size="(\d+)">(.*?)</script>', text
    ).groups()
    value = {
        sign: k
        for k, sign in enumerate(chr(c) for c in range(33, 127) if chr(c) not in "'<\\")
    }
    bits = "".join(
        f"{91 * value[a] + value[b]:013b}" for a, b in zip(packed[::2], packed[1::2])
    )
    return json.loads(
        zlib.decompress(
            bytes(int(bits[k : k + 8], 2) for k in range(0, 8 * int(size), 8))
        )
    )


@pytest.mark.parametrize("kind", ["loop", "regressor", "model", "nasty"])
def test_page_is_well_formed_and_asks_nothing_of_a_network(pages, kind):
    found = pages[kind]
    assert found.errors == [] and found.open == []
    for _, attrs, _ in found.elements:
        assert "src" not in attrs and attrs.get("href", "#").startswith("#")
        assert not any(name.startswith("on") for name in attrs)
    policy = next(
        a["content"]
        for a in found.all("meta")
        if a.get("http-equiv") == "Content-Security-Policy"
    )
    assert "default-src 'none'" in policy and "http" not in policy
    assert len(found.all("script")) == 3 and found.all("img") == []


def test_a_page_takes_two_megabytes_at_most(loop_page):
    record = datasets.load_demo()
    assert len(page(NRFRegressor(degree=3).fit(record), [record]).encode()) < 1.97e6
    assert len(loop_page.encode()) < 1.9e6
    floors = ChainModel(
        [10.0] * 10,
        {j: [laws.LinearElastic(1e5), laws.LinearViscous(60.0)] for j in range(1, 11)},
    )
    force = excitation.band_limited_random(
        10, 8.0, 500.0, excited=10, rms=100.0, band=(1, 60), random_state=0
    )
    tall = simulate(floors, force, 1 / 500)
    assert len(page(NRFRegressor(degree=3).fit(tall), [tall]).encode()) < 2e6


def test_numbers_under_the_pointer_have_their_units(loop_page):
    told = {
        figure["layout"]["yaxis"]["title"]["text"]: trace["hovertemplate"]
        for figure in figures(loop_page).values()
        if "yaxis" in figure["layout"]
        for trace in figure["data"]
    }
    assert (
        "%{x:.4g} mm<br>" in told["force R<sub>1</sub> (N)"]
        and "%{y:.4g} N<" in told["force R<sub>1</sub> (N)"]
    )
    assert (
        "%{x}<br>" in told["held-out balance error (% NRMSE)"]
        and "%{y:.4g} % NRMSE" in told["held-out balance error (% NRMSE)"]
    )


def test_digits_follow_the_interval_zeros_among_them():
    assert (
        as_text(Estimate(8.0, 7.966, 8.034)) == "8.000"
        and as_text(Estimate(3e4, 29880.0, 30120.0)) == "3.000×10⁴"
    )
    assert (
        as_text(Estimate(35070.0, 35055.0, 35085.0)) == "35070" and as_text(8.0) == "8"
    )
    assert Estimate(1.0, -2.0, 3.0).faint and not Estimate(1.0, 0.5, 1.5).faint


@pytest.mark.parametrize("kind", ["loop", "regressor", "model"])
def test_page_can_be_read_without_eyes_or_mouse(pages, kind):
    found = pages[kind]
    ids = [a["id"] for _, a, _ in found.elements if "id" in a]
    assert len(ids) == len(set(ids))
    targets = [a["href"][1:] for a in found.all("a")]
    assert set(targets) <= set(ids) and targets[0] == "main"
    levels = [
        int(tag[1]) for tag, _, _ in found.elements if re.fullmatch(r"h[1-6]", tag)
    ]
    assert (
        levels[0] == 1
        and levels.count(1) == 1
        and all(b <= a + 1 for a, b in zip(levels, levels[1:]))
    )
    plots = [a for a in found.all("div") if "plot" in a.get("class", "").split()]
    assert all(len(a["aria-label"]) > 30 for a in plots)
    assert all(a.get("tabindex") == "0" for a in plots if "turns" in a["class"])
    assert len(found.all("caption")) == len(found.all("table")) > 2
    assert all("scope" in a for a in found.all("th"))
    assert found.all("html")[0]["lang"] == "en"


def test_page_tells_the_story_with_its_evidence(pages):
    report, text = loop_report(), re.sub(r"\s+", " ", pages["loop"].text())
    step = report.steps[0]
    for said in (*str(report.evidence[0]).splitlines(), report.stopped_because):
        assert re.sub(r"\s+", " ", said) in text
    assert f"{step.error_before:.3g} → {step.error_after:.3g} %" in text
    assert "shaker <b>1</b>" in text  # as text, not as markup
    for said in (
        "random_state",
        "least gain",
        "draws",
        "numpy",
        "Symbols",
        "What was measured",
    ):
        assert said in text
    assert "<b>" not in [tag for tag, *_ in pages["loop"].elements]


def test_every_drawing_has_its_numbers_in_a_table(loop_page):
    drawn = figures(loop_page)
    assert len(drawn) >= 12
    kinds = {trace["type"] for figure in drawn.values() for trace in figure["data"]}
    assert {"surface", "scatter3d", "scatter", "bar"} <= kinds
    assert loop_page.count("<figure") == len(drawn)
    opened = re.findall(r'data-numbers="(.*?)"', loop_page)
    assert (
        opened == [name for name, figure in drawn.items() if figure["numbers"]]
        and len(opened) >= len(drawn) - 3
    )
    for name in opened:
        numbers = Page(drawn[name]["numbers"])
        assert (
            numbers.errors == [] and numbers.open == [] and len(numbers.all("tr")) > 1
        )


def test_surface_is_the_restoring_force_and_marks_what_was_visited(pages):
    model = regressor()[0].model_
    drawn = figures(page(model))
    surface = next(
        f
        for f in drawn.values()
        if f["data"][0]["type"] == "surface"
        and "s<sub>2</sub>" in f["layout"]["scene"]["xaxis"]["title"]["text"]
    )
    scale = {"m": 1.0, "mm": 1e-3, "m/s": 1.0, "mm/s": 1e-3, "N": 1.0, "kN": 1e3}
    titles = [surface["layout"]["scene"][f"{k}axis"]["title"]["text"] for k in "xy"]
    units = [
        re.search(r"\((.*)\)", text)[1]
        for text in (*titles, surface["layout"]["annotations"][0]["text"])
    ]
    top = surface["data"][0]
    s, v = np.meshgrid(
        scale[units[0]] * np.array(top["x"]), scale[units[1]] * np.array(top["y"])
    )
    R = scale[units[2]] * np.array(top["z"], dtype=float)
    seen = np.isfinite(R)
    region = model.visited["storey 2"]
    assert seen.any() and not seen.all() and region.contains(v, s)[seen].mean() > 0.98
    truth = K[1] * s + C[1] * v + K3 * s**3
    assert np.abs(R - truth)[seen].max() < 0.02 * np.abs(truth[seen]).max()


def test_force_that_depends_on_the_path_is_drawn_as_a_path():
    model = ChainModel(
        [10.0], {1: [laws.LinearElastic(1e4), laws.Dahl(sigma=1e4, Fd=20.0)]}
    )
    t = np.arange(3000) / 500
    x = 2e-3 * np.sin(7 * t)[:, None]
    rec = Record(
        displacement=x,
        velocity=14e-3 * np.cos(7 * t)[:, None],
        acceleration=-49 * x,
        force=0 * x + 1e-9,
        fs=500.0,
    )
    drawn = figures(page(model, rec))
    kinds = [trace["type"] for f in drawn.values() for trace in f["data"]]
    assert "surface" not in kinds and "scatter3d" in kinds


def test_markup_from_files_stays_text(pages):
    found = pages["nasty"]
    assert found.all("img") == [] and len(found.all("script")) == 3
    assert NASTY in found.text()
    assert "<img" not in nasty_report().to_markdown()
    rec = Record(
        displacement=np.sin(np.arange(50.0))[:, None],
        fs=10.0,
        name=NASTY,
        covariates={NASTY: np.arange(50.0)},
    )
    assert "<img" not in rec._repr_html_() and "&lt;img" in rec._repr_html_()


@given(
    st.text(
        alphabet=st.characters(codec="ascii", categories=["L", "N", "P", "S", "Zs"]),
        min_size=1,
    ),
    st.sampled_from(["", "2", "4,2"]),
)
def test_any_label_becomes_well_formed_mathml(label, index):
    ElementTree.fromstring(mathml([feature(label, index)]))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_becomes_latex_of_the_same_value(x):
    assert float(number(x, ".17g").replace(r"\times 10^{", "e").rstrip("}")) == x


def test_equation_holds_every_coefficient():
    model = ChainModel([1.0], {1: laws.PowerSeries(2, [100.0, 2e5, -3.0, 4.0, 5e-6])})
    force = model.restoring_forces["storey 1"]
    text = "".join(
        "".join(ElementTree.fromstring(mathml([piece])).itertext())
        for piece in law_equation(force)
    )
    assert (
        text.startswith("R1(s1,v1)=100v1+2×105s1")
        and "−3v12" in text
        and "5×10−6" in text
    )
    assert (
        r"R_{1}(s_{1}, v_{1}) &= 100\, v_{1} + 2\times 10^{5}\, s_{1} - 3\, v_{1}^{2}"
        in model.to_latex()
    )


def test_without_its_extra_the_page_names_it_and_leaves_the_old_file(
    monkeypatch, tmp_path
):
    old = tmp_path / "report.html"
    old.write_text("before")
    model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    for missing in ("plotly.offline", "jinja2"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, missing, None)
            with pytest.raises(MissingExtraError, match=r"pysindy_nrf\[report\]"):
                write_html(old, model)
    assert old.read_text() == "before" and list(tmp_path.iterdir()) == [old]
    write_html(old, model)
    assert old.read_text().startswith("<!doctype html>")


def test_other_things_are_refused():
    with pytest.raises(NRFError, match="cannot be reported"):
        write_html("never.html", {"masses": [1.0]})


def test_regressor_page_holds_intervals_and_warnings(pages, tmp_path):
    model, rec = regressor()
    text = pages["regressor"].text()
    assert "with 95 % intervals" in text and "Newton's third law" in text
    write_html(
        tmp_path / "r.html",
        model,
        rec,
        notes=["the roof was <wet>"],
        title="Frame & shaker",
    )
    found = Page((tmp_path / "r.html").read_text())
    assert "the roof was <wet>" in found.text() and found.all("wet") == []


def test_notebook_views_are_small_and_escaped():
    report, (est, rec) = loop_report(), regressor()
    for view in (report._repr_html_(), est.model_._repr_html_(), rec._repr_html_()):
        assert len(view) < 20_000 and Page(view).errors == []
    assert "storey 2" in report._repr_html_() and "<math" in est.model_._repr_html_()
    assert "displacement" in record(cubic)._repr_html_()


def test_what_further_terms_would_explain_is_said_with_units(tmp_path):
    with warnings.catch_warnings(action="ignore"):
        linear = NRFRegressor(degree=1).fit(datasets.load_demo())  # storey 1 is cubic
        write_html(tmp_path / "report.html", linear, datasets.load_demo())
    page = (tmp_path / "report.html").read_text("utf-8")
    table = page.split("What terms beyond the laws would explain", 2)[-1].split(
        "</table>"
    )[0]
    assert (
        "residual (% of its force)" in table and "mass moves with them by (%)" in table
    )
    rows = re.findall(r"<tr>(.*?)</tr>", table.split("<tbody>")[1], re.DOTALL)
    assert [
        "yes" if ">yes<" in row else "no" for row in rows if "balance of DOF 1" in row
    ] == ["yes"]
    assert sum(">no<" in row for row in rows) == 2


def test_a_page_of_a_model_with_a_storey_that_holds_nothing(tmp_path):
    """A storey without a law is no section of the page."""
    model = ChainModel(
        [8.0, 6.0], {"storey 1": [laws.PowerSeries(1, [30.0, 4e4])], "storey 2": []}
    )
    rec = driven(model, [1], 4.0, 500.0, 60.0, (1, 40))
    page = of_model(model, rec)
    assert [part.site for part in page.sites] == ["storey 1"]
    hidden = rec.replace(force=np.full_like(rec.force, np.nan))
    assert (
        "force unknown on DOF 1, 2" in of_model(model, hidden).measured[0][0].sentence
    )


@pytest.fixture(scope="module")
def nothing_found():
    """A linear chain, and a catalogue that holds nothing it lacks."""
    return close_loop(
        record(None, seed=3, noise=0.01), catalogue=[laws.CubicStiffness()], max_steps=2
    )


def test_a_loop_that_finds_nothing_says_so_on_its_page(nothing_found):
    assert not nothing_found.steps
    assert lead(nothing_found).endswith("the loop added nothing to it.")
    assert lead(nothing_found).startswith(
        f"The declared model leaves {nothing_found.table['held-out'].iloc[0]:.3g} %"
    )
    page = of_loop(nothing_found)
    tiles = {name: (value, note) for name, value, note in page.tiles}
    assert (
        tiles["Effects confirmed"] == ("0", "")
        and tiles["Held-out balance error"][1] == "the baseline's"
    )
    assert tiles["Held-out free-run error"][1] == "" and [
        c.title for c in page.chapters
    ] == ["What is left"]
    said = nothing_found.to_markdown()
    assert "No effect was added." in said


def test_doubts_about_a_step_are_said():
    """A free run that gets worse, a mass that is negative: each is a sentence."""
    report = loop_report()
    step = report.steps[0]
    assert not any("worse than before" in said for said in cautions(report))
    worse = replace(step, free_run_before=10.0, free_run_after=30.0)
    doubtful = replace(report, steps=[worse])
    said = " ".join(cautions(doubtful))
    assert (
        f"at {step.site} the held-out free run is worse than before (10 to 30 %)"
        in said
    )
    wrong = ChainModel([-1.0, 2.0, 3.0], report.model.laws, report.model.chain)
    doubtful = replace(doubtful, model=wrong)
    assert doubtful.verdict.state == "red" and "m1 = -1 kg" in doubtful.verdict.sentence
    without_run = replace(step, free_run_before=np.nan, free_run_after=np.nan)
    doubtful = replace(report, steps=[without_run])
    names = [name for name, _ in of_loop(doubtful).chapters[0].facts]
    assert "Held-out data" in names and "Held-out free-run error" not in names


def test_an_effect_that_held_out_data_do_not_confirm_is_not_counted():
    """Headline, tiles, chapter, table, figure, Markdown and notebook view say so; the
    errors are those of the model.
    """
    report = loop_report()
    step = report.steps[0]
    refused = replace(
        step, confirmed=False, sure=False, error_after=9.9, gain_heldout=-0.3
    )
    report = replace(report, steps=[refused], model=report.models[0])
    found = of_loop(report)
    before = report.table["held-out"].iloc[0]
    assert (
        "the loop added nothing to it. NOT CONFIRMED on held-out data, and not in the"
        " model: " in found.lead
    )
    tiles = {name: (value, note) for name, value, note in found.tiles}
    assert tiles["Effects confirmed"] == ("0", "1 more not confirmed")
    assert (
        tiles["Held-out balance error"][0] == f"{before:.3g} %"
        and tiles["Band"][1] == "found from the data"
    )
    assert found.chapters[0].state == "NOT CONFIRMED" and dict(found.chapters[0].facts)[
        "Held-out data"
    ].startswith("NOT")
    assert found.effects.rows[0][-1] == found.errors[0].rows[1][-1] == "NOT CONFIRMED"
    assert found.picture[0].marks[1].hatched and not found.picture[0].marks[0].hatched
    assert "band" not in found.errors[0].head
    assert "is NOT CONFIRMED: the held-out error goes from" in found.care[0]
    assert (
        "NOT CONFIRMED" in report._repr_html_()
        and "| NOT CONFIRMED |" in report.to_markdown()
    )
    both = replace(
        report,
        steps=[step, *report.steps],
        model=report.models[1],
        table=report.table.iloc[[0, 1, 1]],
    )
    assert (
        f"falls from {before:.3g} to {both.table['held-out'].iloc[1]:.3g} %. NOT"
        " CONFIRMED" in lead(both)
    )


def test_where_nothing_is_claimed_the_headline_gives_the_reason(nothing_found):
    why = "the best model leaves 85 % of the balance of DOF 2. Nothing is claimed"
    withdrawn = replace(nothing_found, stopped_because=why, nothing_claimed=True)
    assert lead(withdrawn).endswith(
        "The best model leaves 85 % of the balance of DOF 2. Nothing is claimed."
    )


def test_what_the_data_cannot_tell_apart_is_said_once():
    report = loop_report()
    step = report.steps[0]
    steps = [
        replace(
            step,
            sure=False,
            company=["dahl"],
            alternatives=["hysteresis"],
            tied=[("dahl", "storey 2", 4.2)],
        ),
        replace(step, law="dahl", sure=False, company=[step.law]),
    ]
    report = replace(report, steps=steps, table=report.table.iloc[[0, 1, 1]])
    said = [text for text in cautions(report) if "together" in text]
    assert said == [
        "At storey 2 coulomb friction and dahl may together stand for one law that is"
        " not in the catalogue."
    ]
    chapter = of_loop(report).chapters[0]
    assert (
        "cannot tell friction from hysteresis"
        in dict(chapter.facts)["What else it may be"]
    )
    assert [
        t.rows for t in chapter.tables if t.caption.startswith("The data cannot tell")
    ] == [[["dahl", "storey 2", 4.2]]]
