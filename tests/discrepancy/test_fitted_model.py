"""Models fitted and judged fold by fold, and scans beside them."""

from dataclasses import replace

import numpy as np
import pytest
from loop_parts import findings_of, first_state, start_of
from simulated_cases import Plan

from pysindy_nrf import ChainModel, Site, excitation, laws, simulate
from pysindy_nrf.discrepancy.candidate_search import general_promise
from pysindy_nrf.discrepancy.fitted_model import fit_model, quadratic_forms
from pysindy_nrf.discrepancy.model_extension import ModelExtension
from pysindy_nrf.discrepancy.spectra import BalanceSpectra
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records import Dataset
from pysindy_nrf.simulation import add_noise

SHORT = Plan(3, (1, 2, 3), noise=0.02, seed=75, n_samples=4000)
STOREYS = [Site(f"storey {i}") for i in (1, 2, 3)]


@pytest.fixture(scope="module")
def model():
    """The linear chain of three floors."""
    return first_state(SHORT).model


def test_kept_products_of_a_scan_serve_the_next_model(model):
    """Beside a further law they give the reductions of new products."""
    cubic, kept = laws.CubicStiffness(), {}
    with_friction = model.with_laws([(STOREYS[2], laws.CoulombFriction())])
    for one in (model, with_friction, model):
        extension = ModelExtension(one, [(STOREYS[1], cubic)])
        anew = extension.fit_each([(cubic,)]).reductions
        assert extension.fit_each([(cubic,)], kept).reductions == pytest.approx(
            anew, rel=1e-9
        )


def with_a_gap_that_is_never_closed(model):
    site = STOREYS[1]
    return {**model.laws, site: (*model.laws[site], laws.TwoSidedGap(gap=1e3))}


def test_a_law_that_does_not_act_is_refused(model):
    with pytest.raises(NRFError, match="depend on each other"):
        fit_model(model.spectra, model.base, with_a_gap_that_is_never_closed(model))


def test_a_law_that_does_not_act_is_left_out_of_simulated_records(model):
    measured = model.spectra
    simulated = BalanceSpectra(
        measured.data, measured.windows, measured.bands, strict=False
    )
    without = model.on(simulated)
    with_gap = fit_model(simulated, model.base, with_a_gap_that_is_never_closed(model))
    assert with_gap.powers.residual == pytest.approx(without.powers.residual, rel=1e-9)


def test_a_force_with_some_unknown_samples_counts_where_it_is_known(model):
    """A corrected delay leaves samples at an end unknown: they are zero for spectra."""
    data = model.spectra.data
    segment = data.data.segments[0]
    forces = segment.F.copy()
    forces[segment.valid][:3, 0] = np.nan
    cut = Dataset([replace(segment, F=forces)], data.data.n_samples)

    whole, found = (d.fixed([0])[data.n_dof] for d in (data, data.with_data(cut)))
    assert not found[:3].any()
    np.testing.assert_array_equal(found[3:], whole[3:])


def test_every_balance_is_fitted_as_it_is_judged():
    """Near a resonance the truth must leave no less than the fit.

    Laws that are found twice, and judged by the other one, leave 10 % more.
    """
    storey = [laws.LinearElastic(1e5), laws.LinearViscous(5.0)]
    truth = ChainModel([10.0, 12.0], {1: storey, 2: storey})
    F = excitation.band_limited_random(
        2, 16.0, 250.0, excited=(1, 2), rms=100.0, band=(1, 40), random_state=0
    )
    exact = simulate(truth, F, 1 / 250, hold="cubic")
    model = start_of(add_noise(exact, 0.01, random_state=1)).first.model

    values = np.zeros_like(model.coefficients[:1])
    values[0, :4] = 5.0, 1e5, 5.0, 1e5
    true_rows, _ = model.solver.rows(np.array([[10.0, 12.0]]), values)
    rows, _ = model.solver.rows(model.masses[:1], model.coefficients[:1])
    fitted, true = (
        (model.weights * quadratic_forms(x[0], model.summed)).sum(axis=1)
        for x in (rows, true_rows)
    )
    assert (fitted < 1.01 * true).all()


@pytest.mark.parametrize("kind", ["coulomb", "cubic", "bouc_wen", "two_sided_gap"])
def test_general_laws_show_where_a_law_of_the_motion_gains(kind):
    """At least half of what the law does there, and a tenth of that elsewhere.

    What they do not promise is not scanned.
    """
    state = first_state(
        Plan(3, (1, 2, 3), noise=0.02, effects=((kind, 2, 1, 0.12),), seed=72)
    )
    below, there, above = (general_promise(state.model, site) for site in STOREYS)
    catalogue = [laws.BoucWen(), laws.TwoSidedGap(), laws.CoulombFriction()]
    best = findings_of(state, [*catalogue, laws.CubicStiffness()])[0]
    assert there > 0.5 * best.value
    assert max(below, above) < 0.1 * there
