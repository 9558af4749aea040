"""The same input gives the same answer: on several cores, in another process, from the
same seed.
"""

import json
import os
import subprocess
import sys

import chains
import joblib
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, excitation, select_order
from pysindy_nrf.common import threads
from pysindy_nrf.exceptions import NRFError


@pytest.fixture
def cores(monkeypatch):
    """Pretend that there are so many cores, and that nobody asked for fewer."""

    def set_cores(count: int) -> None:
        for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(joblib, "cpu_count", lambda: count)

    return set_cores


@pytest.mark.parametrize(
    ("omp", "numba", "wanted"),
    [
        ("", "", 8),
        ("3", "", 3),
        ("", "2", 2),
        ("5", "2", 2),
        ("16", "", 8),
        ("4,2", "", 4),
        ("0", "many", 8),
        ("-1", "", 8),
    ],
)
def test_the_variables_that_workers_set_are_heard(
    cores, monkeypatch, omp, numba, wanted
):
    cores(8)
    monkeypatch.setenv("OMP_NUM_THREADS", omp)
    monkeypatch.setenv("NUMBA_NUM_THREADS", numba)
    assert threads.n_threads() == wanted


@pytest.mark.parametrize("forced", [[3], [1, 2, 3]], ids=["sequential", "complete"])
def test_a_fit_has_the_same_bits_on_any_number_of_cores(cores, forced):
    case = chains.duffing(3, forced, seed=4, n_samples=8000)
    X, F = (np.tile(y, (5, 1)) for y in (case.X, case.F))
    F += 0.02 * F.std(axis=0) * np.random.default_rng(0).standard_normal(F.shape)
    found = []
    for count in (1, 2, 3):
        cores(count)
        model, streamed = (
            NRFRegressor(degree=3).fit(*data) for data in ((X, F), (iter([(X, F)]),))
        )
        chosen = select_order(X, F, degrees=range(1, 5))
        masses = np.concatenate([model.masses_, streamed.masses_])
        found.append((masses, model.model_.to_dict(), chosen.fold_scores.to_numpy()))
    for masses, model, scores in found[1:]:
        np.testing.assert_array_equal(masses, found[0][0])
        np.testing.assert_array_equal(scores, found[0][2])
        assert model == found[0][1]
    np.testing.assert_allclose(found[0][0], np.tile(case.m, 2), rtol=0.02)


SCRIPT = """
import json, sys, warnings
import numpy as np
from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

warnings.simplefilter("ignore")
storey = [laws.LinearElastic(1e5), laws.LinearViscous(80.0)]
truth = ChainModel([10.0, 12.0, 9.0], {1: [*storey, laws.Dahl(sigma=3e3, Fd=30.0)], 2: storey, 3: storey})
F = excitation.band_limited_random(3, 2.0, 1000.0, excited=2, rms=100.0, band=(1, 60), random_state=3)
record = add_noise(simulate(truth, F, 1e-3), 0.01, random_state=4)
X, F = record.to_features()
model = NRFRegressor(degree=3, laws={1: [laws.PowerSeries(1), laws.Dahl()]}).fit(X, F)
plain = NRFRegressor(degree=3).fit(X, F)
found = {
    "features": X.to_numpy()[::97].ravel(),
    "masses": model.masses_,
    "sigma": [model.model_.laws["storey 1"][1].shape["sigma"]],
    "coefficients": np.concatenate([f.coefficients for f in plain.restoring_forces_.values()]),
    "intervals": plain.confidence_intervals()[["lower", "upper"]].to_numpy().ravel(),
    "modes": plain.modes().to_numpy().ravel(),
    "free run": model.simulate(F.to_numpy()[:800], dt=1e-3).displacement.ravel(),
}
if "loop" in sys.argv:
    report = close_loop(record, catalogue=[laws.CoulombFriction(), laws.Dahl(), laws.CubicStiffness()], max_steps=1, random_state=6)
    found["loop"] = report.table.select_dtypes("number").to_numpy(dtype=float).ravel()
    found["loop model"] = report.model.masses
print(json.dumps({k: [float(x).hex() for x in np.ravel(v)] for k, v in found.items()}))
"""


def answer(threads: int, *arguments: str) -> dict[str, np.ndarray]:
    names = (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
    )
    env = {
        **os.environ,
        **dict.fromkeys(names, str(threads)),
        "PYTHONHASHSEED": str(threads),
    }
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, *arguments],
        capture_output=True,
        text=True,
        env=env,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    return {
        k: np.array([float.fromhex(x) for x in v])
        for k, v in json.loads(run.stdout.splitlines()[-1]).items()
    }


@pytest.mark.slow
def test_the_same_input_gives_the_same_bits_in_another_process():
    """And on four threads of BLAS all but the last digits."""
    one, two, four = answer(1, "loop"), answer(1, "loop"), answer(4)
    assert one.keys() == two.keys() == four.keys() | {"loop", "loop model"}
    for name in one:
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)
    for name in four:
        scale = (
            0.0 if name == "coefficients" else np.abs(one[name]).max()
        )  # coefficients are ten orders apart
        np.testing.assert_allclose(
            four[name], one[name], rtol=1e-10, atol=1e-10 * scale, err_msg=name
        )


@pytest.mark.parametrize("seed", ["lucky", -1, 1.5, [1, "a"]])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(
        NRFError, match="random_state=.* is no seed. Give a whole number"
    ):
        excitation.band_limited_random(
            2, 1.0, 100.0, excited=1, rms=1.0, band=(1, 20), random_state=seed
        )


def test_seeds_and_generators():
    draw = [
        excitation.band_limited_random(
            1, 1.0, 100.0, excited=1, rms=1.0, band=(1, 20), random_state=s
        )
        for s in (3, 3, np.random.default_rng(3), 4)
    ]
    np.testing.assert_array_equal(draw[0], draw[1])
    np.testing.assert_array_equal(draw[0], draw[2])
    assert not np.allclose(draw[0], draw[3])
