"""Displays: what is drawn is what the model says, in SI units, on matplotlib's sheet
and on plotly's page alike.
"""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import paper_cases as cases
import paper_published as published
import pytest
from paper_displays import (
    ChangeMapDisplay,
    CoefficientsDisplay,
    DamperForceDisplay,
    EnergyDisplay,
    FreeRunDisplay,
    HysteresisLoopDisplay,
    ModesDisplay,
    RecordDisplay,
    RestoringForceSurfaceDisplay,
    TrackDisplay,
)
from planarity import PlanarityDisplay, planarity

from pysindy_nrf import ChainModel, NRFRegressor, datasets, laws, simulate
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.monitoring import compare_tests
from pysindy_nrf.report.figures.figure import Axis, Bars, Figure, Line
from pysindy_nrf.report.figures.matplotlib_renderer import Drawing
from pysindy_nrf.report.figures.plotly_renderer import as_plotly

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from pysindy_nrf import Record  # noqa: E402
from pysindy_nrf.report.figures.motion import order_drawing  # noqa: E402


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def fitted():
    case = cases.four_storey(cases.INCOMPLETE_FRAME, 0.0, duration=8.0, blows=4)
    X, F = case.exact.to_features(smooth=False)
    return case, X, F, NRFRegressor(degree=3).fit(X, F)


@pytest.fixture(scope="module")
def made(fitted):
    case, X, F, model = fitted
    report = compare_tests(
        NRFRegressor(degree=1),
        case.measured.to_features(),
        case.measured.to_features(),
        n_blocks=5,
    )
    law = published.FRAME_COMPLETE.model().restoring_forces[4]
    return {
        "surface": RestoringForceSurfaceDisplay.from_estimator(model, 4, law, size=15),
        "loops": HysteresisLoopDisplay.from_estimator(model, X, F, 2),
        "damper": DamperForceDisplay.from_estimator(
            model, case.bare, X, 4, case.damper[:, 3], "rate"
        ),
        "damper over time": DamperForceDisplay.from_estimator(
            model, case.bare, X, 4, over="time"
        ),
        "energy": EnergyDisplay.from_estimator(model, X),
        "free run": FreeRunDisplay.from_estimator(model, case.exact),
        "change": ChangeMapDisplay.from_report(report, 2, size=15),
        "modes": ModesDisplay.from_estimator(model, case.exact),
        "planarity": PlanarityDisplay(planarity(model, X, F, draws=2, random_state=0)),
        "record": RecordDisplay(case.measured, "velocity"),
        "track": TrackDisplay.from_estimator(
            NRFRegressor(degree=1).fit(X, F), X, F, window=1.0, onset=3.0
        ),
    }


NAMES = [
    "surface",
    "loops",
    "damper",
    "damper over time",
    "energy",
    "free run",
    "change",
    "modes",
    "planarity",
    "record",
    "track",
]


@pytest.mark.parametrize("name", NAMES)
def test_plot_returns_self_and_labels_carry_units(made, name, tmp_path):
    display = made[name]
    assert display.plot() is display
    for figure in display.figures():
        for axis in (figure.x, figure.y, figure.z):
            assert (
                axis is None
                or axis.unit
                or axis.ticks
                or axis.label in ("", "mode shape (largest entry 1)")
            )
    display.figure_.savefig(tmp_path / "picture.png", dpi=60)


def test_curves_are_the_models_on_the_sheet_and_on_the_page(fitted):
    """A force in N over a drift in m, drawn over mm; the page takes kN where the force
    is large.
    """
    _, X, F, model = fitted
    display = HysteresisLoopDisplay.from_estimator(model, X, F, 2).plot()
    drift, force = X["s2"].to_numpy(), model.restoring_force(X)[:, 1]
    line = next(line for line in display.ax_.lines if line.get_label() == "identified")
    np.testing.assert_allclose(line.get_xdata(), 1e3 * drift)
    np.testing.assert_allclose(line.get_ydata(), force)
    drawn = as_plotly(display.figures()[0])
    trace = next(trace for trace in drawn["data"] if trace["name"] == "identified")
    unit = 1e3 if "(kN)" in drawn["layout"]["yaxis"]["title"]["text"] else 1.0
    assert "(mm)" in drawn["layout"]["xaxis"]["title"]["text"]
    np.testing.assert_allclose(
        unit * np.array(trace["y"]), force, atol=2e-4 * np.abs(force).max()
    )


def test_loops_show_the_force_that_balances_the_inertia_above(fitted):
    case, X, F, _ = fitted
    display = HysteresisLoopDisplay.from_estimator(case.truth, X, F, 2)
    assert np.allclose(display.measured, display.identified, atol=1e-6)


def test_a_stiffness_that_drops_by_a_fifth_is_drawn_as_twenty_percent():
    t = np.arange(1.0, 9.0, 0.25)
    table = pd.DataFrame(
        {"record": "quake", "t": t, "k1": np.where(t < 5, 4e4, 3.2e4), "k2": 3e4}
    )
    first, second, onset = TrackDisplay(table, onset=5.0).figures()[0].marks
    assert (
        first.y.iloc[-1] == pytest.approx(-20.0)
        and (second.y == 0).all()
        and onset.x == [5.0, 5.0]
    )


def test_bounds_and_order_of_lying_bars_are_the_same_on_both():
    bars = Bars([90.0, 40.0], low=[80.0, 10.0], high=[95.0, 60.0])
    figure = Figure(
        "", [bars], Axis("share", "%"), Axis(ticks=["storey 1", "storey 2"]), lying=True
    )
    (ax,) = Drawing([figure]).plot().ax_
    trace, layout = as_plotly(figure)["data"][0], as_plotly(figure)["layout"]
    assert [p.get_width() for p in ax.patches] == trace["x"] == [90.0, 40.0]
    assert trace["error_x"]["array"] == [5.0, 20.0] and trace["error_x"][
        "arrayminus"
    ] == [10.0, 30.0]
    assert (
        [text.get_text() for text in ax.get_yticklabels()]
        == layout["yaxis"]["ticktext"]
        == ["storey 1", "storey 2"]
    )
    assert ax.yaxis_inverted() and layout["yaxis"]["autorange"] == "reversed"


def test_names_that_are_markup_stay_text_on_the_page():
    figure = Figure(
        "", [Line([0, 1], [0, 1], "<b>1</b>")], Axis("drift s_{2}", "m"), Axis("a < b")
    )
    drawn = as_plotly(figure)
    assert (
        drawn["data"][0]["name"] == "&lt;b&gt;1&lt;/b&gt;"
        and drawn["layout"]["yaxis"]["title"]["text"] == "a &lt; b"
    )
    assert drawn["layout"]["xaxis"]["title"]["text"] == "drift s<sub>2</sub> (m)"


def test_a_force_with_memory_is_no_surface():
    model = ChainModel(
        [10.0], {1: [laws.PowerSeries(1, [1.0, 1e3]), laws.Dahl(sigma=1e4, Fd=5.0)]}
    )
    with pytest.raises(LawError, match="no surface"):
        RestoringForceSurfaceDisplay.from_estimator(model, 1)


def test_wrong_requests_are_refused(fitted):
    case, X, F, model = fitted
    with pytest.raises(ChannelError, match="over="):
        DamperForceDisplay.from_estimator(model, case.bare, X, 1, over="colour")
    with pytest.raises(ChannelError, match="balances above"):
        HysteresisLoopDisplay.from_estimator(model, X, F, "dof 2")
    with pytest.raises(ChannelError, match="no displacement"):
        FreeRunDisplay.from_estimator(model, case.exact.replace(displacement=None))


def orders(errors, **more):
    scores = pd.DataFrame(-np.outer(errors, [0.9, 1.1]), index=["1", "2", "3"])
    return SimpleNamespace(
        fold_scores=scores,
        scoring="balance",
        table=pd.DataFrame({"chosen": [False, True, False]} | more),
    )


def test_errors_over_orders_of_magnitude_are_drawn_on_a_log_scale():
    """80 % to 0.01 % does not fit a linear axis; 5 to 8 % does, from zero."""
    (wide,), (even,) = (
        order_drawing(orders(e)).plot().ax_
        for e in ([80.0, 0.01, 0.02], [8.0, 5.0, 5.1])
    )
    assert wide.get_yscale() == "log" and even.get_yscale() == "linear"
    assert even.get_ylim()[0] == 0
    (both,) = (
        order_drawing(orders([8.0, 5.0, 5.1], free_run_error=[20.0, 9.0, 9.5]))
        .plot()
        .ax_
    )
    free = next(line for line in both.get_lines() if line.get_label() == "free run")
    np.testing.assert_array_equal(free.get_ydata(), [20.0, 9.0, 9.5])


def test_everything_draws_on_axes_that_are_given():
    _, axes = plt.subplots(1, 3)
    index = pd.MultiIndex.from_tuples([("storey 1", "v"), ("storey 1", "s")])
    CoefficientsDisplay(pd.DataFrame({"truth": [0.1, 0.9]}, index=index)).plot(axes[:1])
    ModesDisplay.from_estimator(datasets.demo_truth()).plot(axes[1:2])
    track = pd.DataFrame({"record": "quake", "t": np.arange(8.0), "k1": 4e4, "k2": 3e4})
    TrackDisplay(track).plot(axes[2])
    assert all(ax.has_data() for ax in axes) and len(plt.get_fignums()) == 1
    assert not [
        text for text in axes[2].texts if "s" in text.get_text()
    ]  # no onset, no mark of one


def test_importing_displays_does_not_import_matplotlib():
    code = (
        "import sys, pysindy_nrf.report.figures; sys.exit('matplotlib' in sys.modules"
        " or 'plotly' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


LINEAR = laws.PowerSeries(1, [60.0, 4e4])


def absolute(model, **left_out):
    """The same motion relative to the base, and absolute."""
    t = np.arange(4000) * 1e-3
    ag = 3 * np.sin(19 * t) * np.sin(2.5 * t) + 2 * np.sin(46 * t + 1) * np.sin(5.6 * t)
    vg = np.r_[0, np.cumsum(0.5 * (ag[1:] + ag[:-1])) * 1e-3]
    xg = np.r_[0, np.cumsum(0.5 * (vg[1:] + vg[:-1])) * 1e-3]
    own = simulate(model, np.zeros((4000, 2)), 1e-3, base_acceleration=ag)
    given = dict(
        acceleration=own.acceleration,
        velocity=own.velocity + vg[:, None],
        displacement=own.displacement + xg[:, None],
        base_acceleration=ag,
        base_velocity=vg,
        base_displacement=xg,
        fs=1000.0,
        coordinates="absolute",
    )
    return Record(**(given | left_out))


@pytest.mark.parametrize("left_out", ["", "base_velocity", "base_acceleration"])
def test_a_free_run_over_absolute_displacements_is_that_of_the_true_model(left_out):
    model = ChainModel([10.0, 12.0], {1: LINEAR, 2: LINEAR})
    record = absolute(model, **({left_out: None} if left_out else {}))
    assert FreeRunDisplay.from_estimator(model, record).error.max() < 0.1
