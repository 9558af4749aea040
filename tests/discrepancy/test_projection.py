"""The compiled walk that ranks candidates is the chain solve, on every kind of walk."""

import numpy as np
import pytest

from pysindy_nrf import Chain, Record, Site, excitation, laws, simulate
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.regression.chain_model import ChainModel
from pysindy_nrf.simulation.noise import add_noise

LINEAR = [laws.LinearElastic(4e4), laws.LinearViscous(30.0)]
TRUTH = ChainModel(
    [12.0, 9.0, 11.0],
    {"storey 1": LINEAR, "storey 2": [*LINEAR, laws.CoulombFriction(6.0)], "storey 3": LINEAR},
)


def forced(dofs, seed=0):
    F = excitation.band_limited_random(3, 4.0, 500.0, dofs=dofs, rms=40.0, band=(1, 40), random_state=seed)
    return add_noise(simulate(TRUTH, F, 2e-3), 0.02, random_state=seed)


def shaken():
    rng = np.random.default_rng(4)
    ag = np.convolve(rng.standard_normal(2000), np.hanning(25), "same")
    run = simulate(TRUTH, np.zeros((2000, 3)), 2e-3, base_acceleration=ag)
    return add_noise(run, 0.02, random_state=1)


def unknown_in_one():
    second = forced((1, 2), seed=1)
    return [forced((1, 3)), second.replace(force=np.where([True, True, False], second.force, np.nan))]


CASES = {
    "complete": (lambda: forced((1, 2, 3)), {}, "auto"),
    "joint": (lambda: forced((1, 2, 3)), {}, "joint"),
    "one floor forced": (lambda: forced((3,)), {}, "auto"),
    "middle floor forced": (lambda: forced((2,)), {}, "auto"),
    "base excitation": (shaken, {1: 12.0, 2: 9.0, 3: 11.0}, "auto"),
    "one mass known": (lambda: forced((1, 2)), {3: 11.0}, "auto"),
    "a force unknown in one record": (unknown_in_one, {}, "auto"),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("place", ["storey 2", "link 3-1", "ground 3"])
def test_errors_are_those_of_the_chain_solve(name, place):
    records, known, strategy = CASES[name]
    data = prepare(records()).data
    work = Workspace(data, [None] * len(data.segments), *split(data.segments), known, strategy)
    stage = Stage(work, Chain(3), {Site(f"storey {i}"): (laws.PowerSeries(1),) for i in (1, 2, 3)})
    site = Site(place)
    law = laws.StribeckFriction(vs=0.5 * work.scales(site)[1])
    blocks = np.arange(len(work.search))
    slot = stage.slot(site, law)
    trial = stage.with_law(site, law).trial()
    slow = [trial.error(trial.solve(blocks[blocks != k]), [k]) for k in blocks]
    assert slot.folds(law) == pytest.approx(slow, rel=1e-7)
    assert trial.fold_errors() == pytest.approx(slow, rel=1e-7)
    whole = trial.error(trial.solve(blocks), blocks)
    assert slot.search_error(law) == pytest.approx(whole, rel=1e-7)
    plain = stage.trial()
    assert plain.search_error() == pytest.approx(plain.error(plain.solve(blocks), blocks), rel=1e-7)


def test_columns_that_depend_on_each_other_are_refused():
    data = prepare(forced((1, 2, 3))).data
    work = Workspace(data, [None], *split(data.segments), {}, "auto")
    stage = Stage(work, Chain(3), {Site(f"storey {i}"): (laws.PowerSeries(1),) for i in (1, 2, 3)})
    far = laws.TwoSidedGap(gap=1.0)  # never reached: a column of zeros
    assert stage.slot(Site("storey 1"), far).errors([far])[0] == np.inf
    with pytest.raises(NRFError):
        stage.slot(Site("storey 1"), laws.LinearElastic()).errors([laws.LinearElastic()])
    assert isinstance(forced((1,)), Record)
