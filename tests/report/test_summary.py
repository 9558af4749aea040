"""The summary: every estimate once, with the same numbers in every form."""

import numpy as np
import pytest
from report_cases import loop_report

from pysindy_nrf import ChainModel, NRFRegressor, datasets, excitation, laws, simulate
from pysindy_nrf.report import Summary, write_workbook
from pysindy_nrf.simulation import add_noise


@pytest.fixture(scope="module")
def summary():
    return NRFRegressor(degree=1).fit(datasets.load_demo()).summary()


def test_the_text_names_method_data_errors_and_verdict(summary):
    text = str(summary)
    for word in ("method", "samples", "sampling rate", "band", "condition", "free-run"):
        assert word in text
    assert summary.verdict.state.upper() in text
    assert "4000" in text
    assert max(map(len, text.splitlines())) <= 92


def test_every_parameter_stands_in_every_form(summary):
    table = summary.to_frame()
    assert list(table["site"].unique()) == ["", "storey 1", "storey 2", "storey 3"]
    text, html, latex = str(summary), summary.as_html(), summary.as_latex()
    for site in ("storey 1", "storey 3"):
        assert site in text and site in html and site in latex
    assert latex.count(r"\\") == len(table) + 5
    assert html.count("<td>N/m</td>") == 3


def test_shares_of_a_linear_storey_are_nearly_its_spring(summary):
    table = summary.to_frame()
    springs = table[table["term"] == "s"]
    assert (springs["share"] > 90).all()
    assert table.loc["m1", "share"] != table.loc["m1", "share"]


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_tests():
    """The scatter of twelve noisy tests of one frame, within its own uncertainty."""
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 11.0], {1: storey, 2: storey})
    force = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[1, 2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    exact = simulate(truth, force, 1 / 500.0)
    estimates, errors = [], []
    for seed in range(12):
        noisy = add_noise(exact, 0.01, random_state=seed)
        table = NRFRegressor(degree=1, estimation="iv").fit(noisy).summary().to_frame()
        estimates.append(table.loc["storey 2: s", "estimate"])
        errors.append(table.loc["storey 2: s", "std_error"])
    scatter = np.std(estimates, ddof=1)
    # 95 % of chi(11) / sqrt(11) lie within 0.59 and 1.41
    assert 0.5 < np.median(errors) / scatter < 1.7


def test_a_workbook_holds_every_table_as_numbers(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    report = loop_report()
    path = write_workbook(
        tmp_path / "m.xlsx", report.summary(), report.model, report.loops
    )
    book = openpyxl.load_workbook(path)
    assert {"Summary", "Masses", "Coefficients", "Forces"} <= set(book.sheetnames)
    masses = [row[1].value for row in book["Masses"].iter_rows(min_row=2)]
    assert masses == pytest.approx(list(report.model.masses), rel=1e-12)
    sites = {row[0].value for row in book["Forces"].iter_rows(min_row=2)}
    assert sites == {"storey 1", "storey 2", "storey 3"}


def test_no_text_of_a_workbook_is_a_formula(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    summary = Summary("x", [("file", '=HYPERLINK("http://x")')], loop_table())
    path = write_workbook(tmp_path / "m.xlsx", summary, loop_report().model)
    cell = openpyxl.load_workbook(path)["Summary"]["B2"]
    assert cell.data_type == "s"
    assert not cell.value.startswith("=")


def loop_table():
    return loop_report().summary().to_frame()


def test_names_from_files_stay_text():
    html = loop_report().summary().as_html()
    assert "<b>1</b>" not in html
