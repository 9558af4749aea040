"""Pictures on the reader's own axes, and pages of results that say little, are doubtful or found nothing."""

import copy
from dataclasses import replace

import chains
import numpy as np
import pandas as pd
import pytest
import report_cases

from pysindy_nrf import ChainModel, NRFRegressor, Record, close_loop, datasets, excitation, laws, simulate
from pysindy_nrf.discrepancy.characterisation import characterise
from pysindy_nrf.discrepancy.evidence import Evidence
from pysindy_nrf.laws import Motion
from pysindy_nrf.mechanics.sites import Site
from pysindy_nrf.monitoring import find_onset
from pysindy_nrf.output.report.content import cautions, lead, of_loop, of_model
from pysindy_nrf.output.report.equations import as_text, law_equation, site_index
from pysindy_nrf.output.report.write import cell
from pysindy_nrf.regression.phase_plane_domain import VisitedRegion

plt = pytest.importorskip("matplotlib.pyplot")
from pysindy_nrf.output.displays import (  # noqa: E402
    ChangeMapDisplay,
    CoefficientsDisplay,
    EvidenceDisplay,
    FreeRunDisplay,
    ModesDisplay,
    OrderSelectionDisplay,
    RestoringForceSurfaceDisplay,
    TrackDisplay,
)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def orders(errors, **more):
    table = pd.DataFrame({"error": errors, "standard_error": 0.1 * np.abs(errors)}, index=["1", "2", "3"])
    table["chosen"] = [False, True, False]
    return table.assign(**more)


def test_errors_over_orders_of_magnitude_are_drawn_on_a_log_scale():
    """80 % to 0.01 % does not fit a linear axis; 5 to 8 % does, from zero; a score below zero has no such foot."""
    wide = OrderSelectionDisplay(orders([80.0, 0.01, 0.02])).plot().ax_
    even = OrderSelectionDisplay(orders([8.0, 5.0, 5.1])).plot().ax_
    score = OrderSelectionDisplay(orders([-8.0, -5.0, -5.1])).plot().ax_
    assert wide.get_yscale() == "log" and even.get_yscale() == "linear"
    assert even.get_ylim()[0] == 0 and score.get_ylim()[0] < -5
    both = OrderSelectionDisplay(orders([8.0, 5.0, 5.1], free_run_error=[20.0, 9.0, 9.5])).plot().ax_
    free = next(line for line in both.get_lines() if line.get_label() == "free run")
    np.testing.assert_array_equal(free.get_ydata(), [20.0, 9.0, 9.5])


def test_a_search_that_was_not_refitted_marks_nothing():
    from sklearn.model_selection import GridSearchCV

    case = chains.duffing(1, [1], seed=1, n_samples=900)
    search = GridSearchCV(NRFRegressor(), {"degree": [1, 3]}, cv=2, refit=False).fit(case.X, case.F)
    shown = OrderSelectionDisplay.from_estimator(search)
    assert list(shown.table.index) == ["1", "3"] and shown.table["chosen"].sum() <= 1


def test_everything_draws_on_axes_that_are_given():
    figure, axes = plt.subplots(2, 4)
    t = np.arange(4000) / 500
    s = np.sin(9 * t) + 0.7 * np.sin(23.1 * t)
    v = 9 * np.cos(9 * t) + 0.7 * 23.1 * np.cos(23.1 * t)
    evidence = Evidence("baseline", characterisation=characterise(20 * np.sign(v), Motion(s, v, t=t)))
    EvidenceDisplay(evidence).plot(axes[0, :3])
    index = pd.MultiIndex.from_tuples([("storey 1", "v"), ("storey 1", "s")])
    CoefficientsDisplay(pd.DataFrame({"truth": [0.1, 0.9]}, index=index)).plot(axes[0, 3:])
    ModesDisplay.from_estimator(datasets.demo_truth()).plot(axes[1, :1])
    track = pd.DataFrame({"record": "quake", "t": t[::500], "k1": 4e4, "k2": 3e4})
    TrackDisplay(track).plot(axes[1, 1])
    assert all(ax.has_data() for ax in [*axes[0], *axes[1, :2]]) and len(plt.get_fignums()) == 1
    assert not [text for text in axes[1, 1].texts if "s" in text.get_text()]  # no onset, no mark of one


def test_a_change_map_without_doubt_or_colours():
    """Every cell significant: no hatching, no legend; no bar of colours where the sheet has one already."""
    v, s = (g.ravel() for g in np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.002, 0.002, 9)))
    table = pd.DataFrame({"v": v, "s": s, "change": -4e3 * s, "error": 0.5, "significant": True, "visited": True})
    bare = ChangeMapDisplay(table, "storey 2", colorbar=False).plot()
    assert bare.ax_.get_legend() is None and len(bare.figure_.axes) == 1
    assert len(ChangeMapDisplay(table.assign(significant=False), "storey 2").plot().figure_.axes) == 2


def test_a_surface_without_a_reference_and_a_run_without_velocities():
    t = np.linspace(0, 6.3, 500)
    region = VisitedRegion.of(0.1 * np.cos(t), 0.001 * np.sin(t))
    model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])}, visited={"storey 1": region})
    labels = [x.get_text() for x in RestoringForceSurfaceDisplay.from_estimator(model, 1).plot().ax_.get_legend().texts]
    assert "paper" not in labels
    F = excitation.band_limited_random(1, 4.0, 500.0, dofs=1, rms=50.0, band=(1, 30), random_state=0)
    rec = simulate(model, F, 1 / 500)  # from rest: nothing is lost without the first velocity
    shown = FreeRunDisplay.from_estimator(model, rec.replace(velocity=None, acceleration=None))
    assert shown.error.max() < 1e-6


def test_a_change_in_words():
    """A spring that loses a fifth of its stiffness half-way is named with its place, size and time."""
    soft, stiff = (
        ChainModel([10.0, 8.0], {"storey 1": [laws.PowerSeries(1, [40.0, k])], "storey 2": [laws.PowerSeries(1, [30.0, 3e4])]})
        for k in (3.2e4, 4e4)
    )
    F = excitation.band_limited_random(2, 12.0, 250.0, dofs=[1, 2], rms=60.0, band=(1, 30), random_state=0)
    first = simulate(stiff, F[:1500], 1 / 250)
    end = {"x0": first.displacement[-1], "v0": first.velocity[-1]}
    rest = simulate(soft, F[1500:], 1 / 250, **end)
    keys = ("force", "acceleration", "velocity", "displacement")
    rec = Record(**{k: np.vstack([getattr(first, k), getattr(rest, k)]) for k in keys}, fs=250.0, name="quake")
    rec = report_cases.add_noise(rec, 0.01, random_state=0)
    model = NRFRegressor(degree=1).fit(*rec.to_features(smooth=False))
    X, F = rec.to_features(smooth=False)
    found = find_onset(model, X, F)
    assert found.storey == "storey 1" and found.time == pytest.approx(6.0, abs=0.5)
    assert str(found).startswith("The stiffness of storey 1 changed by -")
    assert found.change == pytest.approx(-20.0, abs=5.0)


# -- pages ------------------------------------------------------------------------------------


def test_signs_units_and_words_of_a_page():
    assert site_index(Site("storey 2")) == "2" and site_index(Site("link 4-2")) == "4,2"
    assert site_index(Site("dof 3")) == "dof 3"
    assert as_text("joint") == "joint" and as_text(0.25) == "0.25"
    assert cell(True).text == "yes" and cell(np.bool_(False)).text == ""
    free = ChainModel([1.0, 2.0], {"storey 1": [laws.PowerSeries(1, [3.0, 4.0])], "storey 2": []})
    assert "<mn>0</mn>" in "".join(law_equation(free.restoring_forces[2]))


def test_a_page_of_a_model_with_a_storey_that_holds_nothing(tmp_path):
    """A storey without a law is neither a room nor a loop nor an equation of the page."""
    model = ChainModel([8.0, 6.0], {"storey 1": [laws.PowerSeries(1, [30.0, 4e4])], "storey 2": []})
    F = excitation.band_limited_random(2, 4.0, 500.0, dofs=[1], rms=60.0, band=(1, 40), random_state=0)
    rec = simulate(model, F, 1 / 500)
    page = of_model(model, rec)
    assert [room.site for room in page.rooms] == ["storey 1"]
    hidden = rec.replace(force=np.full_like(rec.force, np.nan))
    assert "force unknown on DOF 1, 2" in of_model(model, hidden).measured[0][0].sentence


@pytest.fixture(scope="module")
def nothing_found():
    """A linear chain, and a catalogue that holds nothing it lacks."""
    return close_loop(report_cases.record(None, seed=3, noise=0.01), catalogue=[laws.CubicStiffness()], max_steps=2)


def test_a_loop_that_finds_nothing_says_so_on_its_page(nothing_found):
    assert not nothing_found.steps
    assert lead(nothing_found).endswith("the loop added nothing to it.")
    assert lead(nothing_found).startswith(f"The declared model leaves {nothing_found.table['held-out'].iloc[0]:.3g} %")
    page = of_loop(nothing_found)
    tiles = {name: (value, note) for name, value, note in page.tiles}
    assert tiles["Effects found"][0] == "0" and tiles["Held-out balance error"][1] == "the baseline's"
    assert tiles["Held-out free-run error"][1] == "" and [c.title for c in page.chapters] == ["What is left"]
    said = nothing_found.to_markdown()
    assert "No effect was added." in said


def test_a_page_without_evidence_or_free_run_leaves_them_out(nothing_found):
    """As of a report that was made before evidence was kept: no empty headings."""
    bare = copy.copy(nothing_found)
    bare.evidence, bare.measured, bare.settings = [], [], {}
    bare.candidates = nothing_found.candidates.iloc[:0]
    bare.table = nothing_found.table.assign(**{"free run": np.nan})
    page = of_loop(bare)
    assert "Held-out free-run error" not in [name for name, *_ in page.tiles]
    facts = dict(page.chapters[-1].facts)
    assert list(facts) == ["Why it stopped"] and not page.chapters[-1].tables
    said = bare.to_markdown()
    assert "Is it noise" not in said and "What was measured" not in said and "Settings" not in said


def test_doubts_about_a_step_are_said():
    """A free run that gets worse, rooms that disagree, a mass that is negative: each is a sentence."""
    report = report_cases.loop_report()
    step = report.steps[0]
    assert not any("worse than before" in said or "disagree" in said for said in cautions(report))
    doubtful = copy.copy(report)
    doubtful.steps = [replace(step, free_run_before=10.0, free_run_after=30.0)]
    first, *rest = report.evidence
    doubtful.evidence = [replace(first, chosen=first.localisation["share"].idxmin()), *rest]
    said = " ".join(cautions(doubtful))
    assert f"at {step.site} the held-out free run is worse than before (10 to 30 %)" in said
    assert "Localisation and the loop disagree about" in said
    doubtful.model = ChainModel([-1.0, 2.0, 3.0], report.model.laws, report.model.chain)
    assert "m1 came out not positive" in " ".join(cautions(doubtful))
    unknown = [replace(step, free_run_before=np.nan, free_run_after=np.nan, intervals=None)]
    doubtful.steps = unknown
    names = [name for name, _ in of_loop(replace_model(doubtful, report.model)).chapters[0].facts]
    assert "Held-out balance error" in names and "Held-out free-run error" not in names


def replace_model(report, model):
    out = copy.copy(report)
    out.model = model
    return out
