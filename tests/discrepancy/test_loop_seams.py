"""What one part of the loop hands to the next, on real short runs: search, evidence,
decision, report, pages, files.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from loop_parts import search_data, start_of
from simulated_cases import Plan, simulated

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.cli import run
from pysindy_nrf.discrepancy import Location
from pysindy_nrf.equations import nrmse
from pysindy_nrf.simulation import add_noise


class CubicOfMine(laws.CubicStiffness):
    """A law that a user wrote."""

    name = "cubic_of_mine"


CATALOGUE = [
    CubicOfMine(),
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.LinkSpringDashpot(),
    laws.ConstantForce(),
]
HIDDEN = Plan(3, (1, 2, 3), noise=0.005, effects=(("cubic", 2, 1, 0.25),), seed=51)


def rows_of(record, rows):
    """Some rows of the channels of a record, from a clock of their own."""
    names = ("force", "acceleration", "velocity", "displacement")
    return record.replace(**{name: getattr(record, name)[rows] for name in names})


@pytest.fixture(scope="module")
def whole_record():
    """A test of a chain with a hidden cubic spring in storey 2."""
    return Record(**simulated(HIDDEN).channels, name="searched")


@pytest.fixture(scope="module")
def searched(whole_record):
    """What the search sees of it."""
    return rows_of(whole_record, slice(0, 2 * whole_record.n_samples // 3))


@pytest.fixture(scope="module")
def heldout(whole_record):
    """What only the last line sees."""
    n_samples = whole_record.n_samples
    return rows_of(whole_record, slice(2 * n_samples // 3, n_samples))


@pytest.fixture(scope="module")
def loop_report(searched, heldout):
    """A loop that finds the spring."""
    return close_loop(searched, catalogue=CATALOGUE, heldout=heldout, max_steps=2)


@pytest.fixture(scope="module")
def silent():
    """A loop that finds nothing, because nothing is hidden."""
    plan = Plan(3, (1, 2, 3), noise=0.01, seed=52)
    record = Record(**simulated(plan).channels)
    return close_loop(record, catalogue=CATALOGUE, max_steps=2)


@pytest.fixture(params=["loop_report", "silent"])
def report(request):
    """Either loop."""
    return request.getfixturevalue(request.param)


# -- the final estimate --------------------------------------------------------


def test_the_model_is_the_estimate_of_its_laws_by_a_fit(searched, loop_report):
    """One number has one interval, whoever is asked."""
    fit = NRFRegressor(laws=loop_report.model.laws, band=loop_report.band).fit(searched)
    assert loop_report.model.masses == pytest.approx(fit.masses_, rel=1e-9)
    assert loop_report.bounds == fit.bounds()[0]
    assert loop_report.verdict.state == fit.verdict().state


# -- long records --------------------------------------------------------------


@pytest.fixture(scope="module")
def long_record():
    """A minute at 1 kHz with friction in storey 1."""
    linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    friction = [*linear, laws.CoulombFriction(20.0)]
    F = excitation.band_limited_random(
        2, 60.0, 1000.0, excited=2, rms=100.0, band=(1, 60), random_state=0
    )
    run = simulate(ChainModel([10.0, 10.0], {1: friction, 2: linear}), F, 1e-3)
    return add_noise(run, 0.005, random_state=1)


def test_a_long_record_is_searched_by_excerpts(long_record):
    """One for each fold, a record of its own."""
    first = start_of(long_record).first
    folds = first.model.spectra.data.search
    n_rows = sum(fold.rows.stop - fold.rows.start for fold in folds)
    assert len(first.records.records) == len(folds)
    assert 10_000 <= 1.1 * n_rows < 0.5 * long_record.n_samples


def test_a_long_record_is_fitted_on_all_samples(long_record):
    """One sample in four is enough to find what the estimate of all samples sizes."""
    tried = [laws.RegularizedFriction(), laws.QuadraticDamping()]
    report = close_loop(long_record, catalogue=tried, max_steps=1)
    (step,) = report.steps
    assert (step.law, step.site) == ("regularized_friction", "storey 1")
    assert step.confirmed
    assert step.parameters["Fc"] == pytest.approx(20.0, rel=0.05)
    assert report.model.masses == pytest.approx([10.0, 10.0], rel=0.01)


# -- catalogue to search -------------------------------------------------------


def test_the_law_of_a_user_takes_part_in_the_search(loop_report):
    (step,) = loop_report.steps
    assert (step.law, step.site) == ("cubic_of_mine", "storey 2")
    listed = loop_report.settings["loop"]["catalogue"].split(", ")
    assert listed == [law.name for law in CATALOGUE]


def test_the_best_of_the_last_round_are_listed(searched):
    """Laws of the catalogue where they make sense."""
    tried = [
        laws.QuinticStiffness(),
        laws.AbsoluteQuadraticStiffness(),
        laws.CoulombFriction(),
    ]
    report = close_loop(searched, catalogue=tried, max_steps=1)
    sites_of_springs_and_friction = {"storey 1", "storey 2", "storey 3"}
    sites_of_springs_and_friction |= {"ground 2", "ground 3"}
    assert len(report.candidates)
    general = {"general_curve", "general_hysteresis"}
    assert set(report.candidates["law"]) <= general | {law.name for law in tried}
    for sites in report.candidates["site"]:
        assert set(sites.split(", ")) <= sites_of_springs_and_friction


# -- evidence to report --------------------------------------------------------


def test_there_is_evidence_for_the_baseline_and_after_every_step(report):
    n_models = len(report.steps) + 1
    assert len(report.evidence) == len(report.models) == len(report.table) == n_models
    sites = [step.site for step in report.steps]
    assert [evidence.chosen for evidence in report.evidence] == [*sites, ""]


def test_where_there_is_nothing_to_locate_no_site_is_named(report):
    last = report.evidence[-1]
    assert last.localisation.verdict == Location.NOTHING and last.site == ""
    for evidence in (last, replace(last, chosen="storey 1")):
        sentence = evidence.sentences["localisation"]
        assert sentence.endswith("nothing to locate.")
        assert "storey" not in sentence and "dof" not in sentence


def test_what_needs_no_answer_is_no_reason(report):
    last = report.evidence[-1]
    assert last.characterisation is None
    assert last.not_possible["characterisation"].expected
    assert "evidence" not in {ground.kind for ground in report.verdict.grounds}


# -- verdicts to words ---------------------------------------------------------


def test_every_verdict_reaches_the_pages_in_the_same_words(report):
    text = report.to_markdown()
    for evidence in report.evidence:
        for sentence in evidence.sentences.values():
            assert sentence.replace("<", "&lt;") in text
    assert report.stopped_because in str(report)
    assert report.stopped_because in text


def test_a_sure_step_is_named_and_an_unsure_one_is_the_closest_law(loop_report):
    (step,) = loop_report.steps
    assert ("closest law" in step.sentence) == (not step.sure)
    text = loop_report.to_markdown()
    assert "cubic of mine at storey 2" in text
    assert step.sentence in text


# -- steps to table, files, model ----------------------------------------------


def test_the_table_has_the_errors_of_the_steps(loop_report):
    table, (step,) = loop_report.table, loop_report.steps
    assert list(table.index) == ["baseline", "cubic_of_mine at storey 2"]
    assert [step.error_before, step.error_after] == table["held-out"].tolist()
    assert [step.free_run_before, step.free_run_after] == table["free run"].tolist()
    text = loop_report.to_markdown()
    for value in table["held-out"]:
        assert f" {value:.4g} |" in text


def test_the_model_holds_the_law_with_the_numbers_of_its_step(loop_report):
    (step,) = loop_report.steps
    (law,) = [law for law in loop_report.model.laws["storey 2"] if law.name == step.law]
    assert law.parameters == step.parameters
    truth = simulated(HIDDEN).effects[0].par[0]
    assert step.parameters["k3"] == pytest.approx(truth, rel=0.02)
    low, high = step.intervals["k3"]
    assert low < step.parameters["k3"] < high


def test_the_command_writes_the_report_and_a_model_that_is_read_again(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    plan = Plan(1, (1,), effects=(("cubic", 1, 0, 0.25),), seed=53, n_samples=2000)
    Record(**simulated(plan).channels).to_frame().to_csv("test.csv")
    assert run(["close-loop", "test.csv", "--steps", "1", "--json", "-o", "out"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (step,) = printed["steps"]
    assert (step["law"], step["site"]) == ("cubic_stiffness", "storey 1")

    model = ChainModel.from_json("out/closed_loop.json")
    by_name = {law.name: law for law in model.laws["storey 1"]}
    assert model.to_dict() == printed["model"]
    assert by_name["cubic_stiffness"].parameters == step["parameters"]
    assert step["sentence"] in (tmp_path / "out/closed_loop.md").read_text()
    names = {f"closed_loop.{ending}" for ending in ("json", "md", "png", "html", "csv")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *names,
        "manifest.json",
    }


def balance_errors(model, X, F):
    """Error of each balance of a plain chain by hand, percent."""
    n = F.shape[1]
    a, v, s = np.split(X, 3, axis=1)
    forces = np.zeros((len(X), n + 1))
    for i in range(n):
        for law in model.laws[f"storey {i + 1}"]:
            forces[:, i] += law.force(laws.Motion(s[:, i], v[:, i]))
    predicted = model.masses * a + forces[:, :-1] - forces[:, 1:]
    inside = np.isfinite(predicted).all(axis=1)
    return [nrmse(F[inside, j], predicted[inside, j]) for j in range(n)]


def test_the_heldout_error_is_the_error_of_the_model_on_the_heldout_record(
    loop_report, heldout
):
    """Nearly: the report leaves means and uninformative bands out."""
    X, F = heldout.to_features(smooth=True)
    for name, model in zip(loop_report.table.index, loop_report.models):
        by_hand = balance_errors(model, X.to_numpy(), F.to_numpy())
        for j, error in enumerate(by_hand, 1):
            reported = loop_report.table.loc[name, f"held-out dof {j}"]
            assert reported == pytest.approx(error, rel=0.25)


@pytest.fixture(scope="module")
def found_beside_noise(searched, heldout):
    """The same loop with held-out forces full of noise."""
    noise = np.random.default_rng(0).standard_normal((heldout.n_samples, 3))
    spoilt = heldout.replace(force=heldout.force.std() * noise)
    return close_loop(searched, catalogue=CATALOGUE, heldout=spoilt, max_steps=2)


def test_heldout_data_change_nothing_that_the_search_says(
    loop_report, found_beside_noise
):
    """The same steps, parameters, gains and search errors to the last digit."""
    (step,), (other,) = loop_report.steps, found_beside_noise.steps
    for name in (
        "law",
        "site",
        "parameters",
        "intervals",
        "reduction",
        "reduction_error",
    ):
        assert getattr(step, name) == getattr(other, name)
    assert step.share == other.share
    assert loop_report.band == found_beside_noise.band
    sizes = [report.evidence[0].sizes for report in (loop_report, found_beside_noise)]
    assert sizes[0].equals(sizes[1])
    errors = ["search", "validation"]
    assert loop_report.table[errors].equals(found_beside_noise.table[errors])


def test_heldout_data_have_the_last_word(loop_report, found_beside_noise):
    (step,), (other,) = loop_report.steps, found_beside_noise.steps
    assert step.confirmed
    assert other.error_after > 10 * step.error_after


def test_channels_without_noise_are_used_where_the_rate_of_the_base_is_not_measured():
    omega, t = 2 * np.pi * 1.3, np.arange(6000) / 200.0
    xg = 1e-3 * np.sin(omega * t)
    vg = 1e-3 * omega * np.cos(omega * t)
    ag = -(omega**2) * xg
    storey = [laws.LinearElastic(4e3), laws.LinearViscous(8.0)]
    chain = ChainModel([10.0, 8.0], {1: storey, 2: storey})
    motion = simulate(chain, None, 0.005, base_acceleration=ag, hold="cubic")
    record = Record(
        acceleration=motion.acceleration,
        velocity=motion.velocity + vg[:, None],
        displacement=motion.displacement + xg[:, None],
        base_acceleration=ag,
        base_displacement=xg,
        coordinates="absolute",
        fs=200.0,
    )
    (segment,) = search_data(record).data.segments
    drift = np.diff(motion.displacement, axis=1, prepend=0.0)[segment.valid]
    tiny = 1e-3 * np.abs(drift).max()
    np.testing.assert_allclose(segment.s[segment.valid], drift, atol=tiny)
