"""Displays: scikit-learn's manner, units on the axes, matplotlib only when something is drawn."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import paper_cases as cases
import paper_published as published
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, laws
from pysindy_nrf.estimation import nonlinearity_location as planarity
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.monitoring import compare_tests

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from pysindy_nrf import displays  # noqa: E402


@pytest.fixture(scope="module")
def fitted():
    case = cases.four_storey(cases.INCOMPLETE_FRAME, 0.0, duration=8.0, blows=4)
    X, F = case.exact.to_features(smooth=False)
    return case, X, F, NRFRegressor(degree=3).fit(X, F)


@pytest.fixture(scope="module")
def made(fitted):
    case, X, F, model = fitted
    report = compare_tests(NRFRegressor(degree=1), case.measured.to_features(), case.measured.to_features(), n_blocks=5)
    return {
        "surface": displays.RestoringForceSurfaceDisplay.from_estimator(
            model, 4, published.FRAME_COMPLETE.model().restoring_forces[4], size=15
        ),
        "loops": displays.HysteresisLoopDisplay.from_estimator(model, X, F, 2),
        "damper": displays.DamperForceDisplay.from_estimator(model, case.bare, X, 4, case.damper[:, 3], "rate"),
        "damper over time": displays.DamperForceDisplay.from_estimator(model, case.bare, X, 4, over="time"),
        "energy": displays.EnergyDisplay.from_estimator(model, X),
        "free run": displays.FreeRunDisplay.from_estimator(model, case.exact),
        "change": displays.ChangeMapDisplay.from_report(report, 2, size=15),
        "modes": displays.ModesDisplay.from_estimator(model, case.exact),
        "planarity": displays.PlanarityDisplay(planarity(model, X, F, draws=2, random_state=0)),
        "record": displays.RecordDisplay(case.measured, "velocity"),
        "track": displays.TrackDisplay.from_estimator(NRFRegressor(degree=1).fit(X, F), X, F, window=1.0, onset=3.0),
    }


NAMES = [
    "surface", "loops", "damper", "damper over time", "energy", "free run", "change", "modes", "planarity", "record", "track",
]  # fmt: skip
UNITS = ("(N)", "(m/s)", "(mm)", "(s)", "(J)", "(%", "(Hz)", "(kg)", "(m/s", "(largest entry 1)", "% of")
WITHOUT_UNIT = {"floor", ""}


def labels(figure):
    for axis in figure.axes:
        yield axis.get_xlabel()
        yield axis.get_ylabel()
        if hasattr(axis, "get_zlabel"):
            yield axis.get_zlabel()


@pytest.mark.parametrize("name", NAMES)
def test_plot_returns_self_and_labels_carry_units(made, name, tmp_path):
    display = made[name]
    assert display.plot() is display
    texts = list(labels(display.figure_))
    assert any(texts)
    for text in texts:
        assert text in WITHOUT_UNIT or any(unit in text for unit in UNITS), text
    display.figure_.savefig(tmp_path / "picture.png", dpi=60)
    plt.close(display.figure_)


@pytest.mark.parametrize("name", ["loops", "damper", "energy", "change", "planarity", "track"])
def test_given_axes_are_used(made, name):
    figure, ax = plt.subplots()
    display = made[name].plot(ax)
    assert display.ax_ is ax and display.figure_ is figure and len(figure.axes) <= 2
    plt.close(figure)


def test_surface_marks_what_was_visited(made):
    display = made["surface"]
    share = display.surface["visited"].mean()
    assert 0.05 < share < 1.0  # a free decay does not fill its rectangle
    assert display.reference.shape == (225,)


def test_free_run_of_the_true_model_lies_on_the_measured_one(fitted):
    case, *_ = fitted
    assert displays.FreeRunDisplay.from_estimator(case.truth, case.exact).error.max() < 1e-6


def test_loops_show_the_force_that_balances_the_inertia_above(fitted):
    case, X, F, _ = fitted
    display = displays.HysteresisLoopDisplay.from_estimator(case.truth, X, F, 2)
    assert np.allclose(display.measured, display.identified, atol=1e-6)


def test_a_force_with_memory_is_no_surface():
    model = ChainModel([10.0], {1: [laws.PowerSeries(1, [1.0, 1e3]), laws.Dahl(sigma=1e4, Fd=5.0)]})
    with pytest.raises(LawError, match="no surface"):
        displays.RestoringForceSurfaceDisplay.from_estimator(model, 1)


def test_wrong_requests_are_refused(fitted):
    case, X, F, model = fitted
    with pytest.raises(ChannelError, match="over="):
        displays.DamperForceDisplay.from_estimator(model, case.bare, X, 1, over="colour")
    with pytest.raises(ChannelError, match="balances above"):
        displays.HysteresisLoopDisplay.from_estimator(model, X, F, "dof 2")
    with pytest.raises(ChannelError, match="no displacement"):
        displays.FreeRunDisplay.from_estimator(model, case.exact.replace(displacement=None))


def test_importing_displays_does_not_import_matplotlib():
    code = "import sys, pysindy_nrf.output.displays; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
