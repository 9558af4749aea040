"""What is drawn is what the model says, on matplotlib's sheet and on plotly's page.

Numbers are SI; the sheet draws lengths in mm, the page chooses a prefix.
"""

import subprocess
import sys

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

from pysindy_nrf import ChainModel, NRFRegressor, Record, datasets, laws, simulate
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.monitoring import compare_tests
from pysindy_nrf.report import (
    Axis,
    Bars,
    Drawing,
    Figure,
    Line,
    as_plotly,
    order_figure,
)

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def frame():
    """The paper's four-storey frame with a damper, without noise."""
    return cases.four_storey(cases.INCOMPLETE_FRAME, 0.0, duration=8.0, blows=4)


@pytest.fixture(scope="module")
def features(frame):
    return frame.exact.to_features(smooth=False)


@pytest.fixture(scope="module")
def fitted(features):
    return NRFRegressor(degree=3).fit(*features)


# -- every display -------------------------------------------------------------


def surface(frame, features, fitted):
    law = published.FRAME_COMPLETE.model().restoring_forces[4]
    return RestoringForceSurfaceDisplay.from_estimator(fitted, 4, law, size=15)


def loops(frame, features, fitted):
    return HysteresisLoopDisplay.from_estimator(fitted, *features, 2)


def damper(frame, features, fitted):
    return DamperForceDisplay.from_estimator(
        fitted, frame.bare, features[0], 4, frame.damper[:, 3], "rate"
    )


def damper_over_time(frame, features, fitted):
    return DamperForceDisplay.from_estimator(
        fitted, frame.bare, features[0], 4, over="time"
    )


def energy(frame, features, fitted):
    return EnergyDisplay.from_estimator(fitted, features[0])


def free_run(frame, features, fitted):
    return FreeRunDisplay.from_estimator(fitted, frame.exact)


def change(frame, features, fitted):
    measured = frame.measured.to_features()
    report = compare_tests(NRFRegressor(degree=1), measured, measured, n_blocks=5)
    return ChangeMapDisplay.from_report(report, 2, size=15)


def modes(frame, features, fitted):
    return ModesDisplay.from_estimator(fitted, frame.exact)


def planes(frame, features, fitted):
    return PlanarityDisplay(planarity(fitted, *features, draws=2, random_state=0))


def record(frame, features, fitted):
    return RecordDisplay(frame.measured, "velocity")


def track(frame, features, fitted):
    linear = NRFRegressor(degree=1).fit(*features)
    return TrackDisplay.from_estimator(linear, *features, window=1.0, onset=3.0)


DISPLAYS = [
    surface,
    loops,
    damper,
    damper_over_time,
    energy,
    free_run,
    change,
    modes,
    planes,
    record,
    track,
]


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("made", DISPLAYS, ids=lambda made: made.__name__)
def test_every_display_is_drawn_with_units(frame, features, fitted, made, tmp_path):
    display = made(frame, features, fitted)
    assert display.plot() is display
    display.figure_.savefig(tmp_path / "picture.png", dpi=60)

    for figure in display.figures():
        for axis in figure.axes:
            has_no_unit = ("", "mode shape (largest entry 1)")
            assert axis.unit or axis.ticks or axis.label in has_no_unit


def test_everything_draws_on_axes_that_are_given():
    _, axes = plt.subplots(1, 3)
    index = pd.MultiIndex.from_tuples([("storey 1", "v"), ("storey 1", "s")])
    CoefficientsDisplay(pd.DataFrame({"truth": [0.1, 0.9]}, index=index)).plot(axes[:1])
    ModesDisplay.from_estimator(datasets.demo_truth()).plot(axes[1:2])
    table = pd.DataFrame({"record": "quake", "t": np.arange(8.0), "k1": 4e4, "k2": 3e4})
    TrackDisplay(table).plot(axes[2])

    assert all(ax.has_data() for ax in axes)
    assert len(plt.get_fignums()) == 1
    assert not axes[2].texts, "no onset, no mark of one"


def test_a_force_with_memory_is_no_surface():
    storey = [laws.PowerSeries(1, [1.0, 1e3]), laws.Dahl(sigma=1e4, Fd=5.0)]
    with pytest.raises(LawError, match="no surface"):
        RestoringForceSurfaceDisplay.from_estimator(ChainModel([10.0], {1: storey}), 1)


def test_wrong_requests_are_refused(frame, features, fitted):
    X, F = features
    with pytest.raises(ChannelError, match="over="):
        DamperForceDisplay.from_estimator(fitted, frame.bare, X, 1, over="colour")
    with pytest.raises(ChannelError, match="balances above"):
        HysteresisLoopDisplay.from_estimator(fitted, X, F, "dof 2")
    with pytest.raises(ChannelError, match="no displacement"):
        unmeasured = frame.exact.replace(displacement=None)
        FreeRunDisplay.from_estimator(fitted, unmeasured)


def test_importing_figures_imports_no_renderer():
    code = (
        "import sys; from pysindy_nrf.report import Figure, as_plotly;"
        "sys.exit('matplotlib' in sys.modules or 'plotly' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == 0


# -- the same on the sheet and on the page -------------------------------------


def test_curves_of_the_sheet_are_the_models(features, fitted):
    X, F = features
    display = HysteresisLoopDisplay.from_estimator(fitted, X, F, 2).plot()
    lines = {line.get_label(): line for line in display.ax_.lines}
    identified = lines["identified"]
    np.testing.assert_allclose(identified.get_xdata(), 1e3 * X["s2"])
    force = fitted.restoring_force(X)[:, 1]
    np.testing.assert_allclose(identified.get_ydata(), force)


def test_curves_of_the_page_are_the_models(features, fitted):
    X, F = features
    display = HysteresisLoopDisplay.from_estimator(fitted, X, F, 2)
    drawn = as_plotly(display.figures()[0])
    traces = {trace["name"]: trace for trace in drawn["data"]}
    titles = [drawn["layout"][f"{side}axis"]["title"]["text"] for side in "xy"]
    assert "(mm)" in titles[0]

    force = fitted.restoring_force(X)[:, 1]
    unit = 1e3 if "(kN)" in titles[1] else 1.0
    shown = unit * np.array(traces["identified"]["y"])
    # four digits of the largest number
    np.testing.assert_allclose(shown, force, atol=2e-4 * np.abs(force).max())


def lying_bars():
    bars = Bars([90.0, 40.0], low=[80.0, 10.0], high=[95.0, 60.0])
    names = Axis(ticks=["storey 1", "storey 2"])
    return Figure("", [bars], Axis("share", "%"), names, lying=True)


def test_lying_bars_have_the_same_length_and_ends_on_both():
    (ax,) = Drawing([lying_bars()]).plot().ax_
    trace = as_plotly(lying_bars())["data"][0]
    lengths = [patch.get_width() for patch in ax.patches]
    assert lengths == trace["x"] == [90.0, 40.0]
    assert trace["error_x"]["array"] == [5.0, 20.0]
    assert trace["error_x"]["arrayminus"] == [10.0, 30.0]


def test_lying_bars_stand_in_the_same_order_on_both():
    (ax,) = Drawing([lying_bars()]).plot().ax_
    axis = as_plotly(lying_bars())["layout"]["yaxis"]
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names == axis["ticktext"] == ["storey 1", "storey 2"]
    assert ax.yaxis_inverted()
    assert axis["autorange"] == "reversed"


def test_names_that_are_markup_stay_text_on_the_page():
    line = Line([0, 1], [0, 1], "<b>1</b>")
    drawn = as_plotly(Figure("", [line], Axis("drift s_{2}", "m"), Axis("a < b")))
    layout = drawn["layout"]
    assert drawn["data"][0]["name"] == "&lt;b&gt;1&lt;/b&gt;"
    assert layout["yaxis"]["title"]["text"] == "a &lt; b"
    assert layout["xaxis"]["title"]["text"] == "drift s<sub>2</sub> (m)"


# -- what single figures say ---------------------------------------------------


def test_loops_show_the_force_that_balances_the_inertia_above(frame, features):
    display = HysteresisLoopDisplay.from_estimator(frame.truth, *features, 2)
    assert np.allclose(display.measured, display.identified, atol=1e-6)


def test_a_stiffness_that_drops_by_a_fifth_is_drawn_as_twenty_percent():
    t = np.arange(1.0, 9.0, 0.25)
    k1 = np.where(t < 5, 4e4, 3.2e4)
    table = pd.DataFrame({"record": "quake", "t": t, "k1": k1, "k2": 3e4})
    first, second, onset = TrackDisplay(table, onset=5.0).figures()[0].marks
    assert first.y.iloc[-1] == pytest.approx(-20.0)
    assert (second.y == 0).all()
    assert onset.x == [5.0, 5.0]


def drawn_orders(errors, **more):
    """Axes of the errors (%) of degrees 1 to 3, of which 2 was chosen."""
    orders = ["1", "2", "3"]
    table = pd.DataFrame({"chosen": [False, True, False]} | more, index=orders)
    by_fold = np.outer(errors, [0.9, 1.1]) / 100
    figure = order_figure(table, by_fold, orders, "balance")
    (ax,) = Drawing([figure]).plot().ax_
    return ax


def test_errors_over_orders_of_magnitude_are_drawn_on_a_log_scale():
    """80 % to 0.01 % does not fit a linear axis."""
    assert drawn_orders([80.0, 0.01, 0.02]).get_yscale() == "log"


def test_errors_of_one_size_are_drawn_from_zero():
    ax = drawn_orders([8.0, 5.0, 5.1])
    assert ax.get_yscale() == "linear"
    assert ax.get_ylim()[0] == 0


def test_the_free_run_is_drawn_beside_the_folds():
    ax = drawn_orders([8.0, 5.0, 5.1], free_run_error=[20.0, 9.0, 9.5])
    lines = {line.get_label(): line for line in ax.get_lines()}
    np.testing.assert_array_equal(lines["free run"].get_ydata(), [20.0, 9.0, 9.5])


# -- a free run over absolute displacements ------------------------------------


def integral(rate, dt):
    """Integral from rest by the trapezoid rule."""
    return np.r_[0, np.cumsum(0.5 * (rate[1:] + rate[:-1])) * dt]


def absolute_record(model, n=4000, dt=1e-3):
    """The motion of a shaken frame, as seen from outside."""
    t = np.arange(n) * dt
    ag = 3 * np.sin(19 * t) * np.sin(2.5 * t)
    ag += 2 * np.sin(46 * t + 1) * np.sin(5.6 * t)
    vg = integral(ag, dt)
    xg = integral(vg, dt)
    relative = simulate(model, np.zeros((n, 2)), dt, base_acceleration=ag)
    return Record(
        acceleration=relative.acceleration,
        velocity=relative.velocity + vg[:, None],
        displacement=relative.displacement + xg[:, None],
        base_acceleration=ag,
        base_velocity=vg,
        base_displacement=xg,
        fs=1 / dt,
        coordinates="absolute",
    )


@pytest.mark.parametrize("left_out", ["", "base_velocity", "base_acceleration"])
def test_a_free_run_over_absolute_displacements_is_that_of_the_truth(left_out):
    linear = laws.PowerSeries(1, [60.0, 4e4])
    model = ChainModel([10.0, 12.0], {1: linear, 2: linear})
    record = absolute_record(model)
    if left_out:
        record = record.replace(**{left_out: None})
    assert FreeRunDisplay.from_estimator(model, record).error.max() < 0.1
