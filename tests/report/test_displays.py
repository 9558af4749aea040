"""Public displays: what they draw is what the model and the data say."""

import numpy as np
import pytest
from report_cases import FC, TWO_STOREYS, loop_report, two_storeys

from pysindy_nrf import (
    FreeRunDisplay,
    HysteresisDisplay,
    IntervalsDisplay,
    ModesDisplay,
    NRFRegressor,
    ResidualDisplay,
    RestoringForceDisplay,
    StepsDisplay,
    datasets,
    excitation,
    simulate,
)
from pysindy_nrf.drawing.thinning import thinned
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.records.figures import coherence_figure, time_figures
from pysindy_nrf.records.spectra import density, spectra_of
from pysindy_nrf.report.figures.motion import measured_response_figure

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")
AbstractMovieWriter = pytest.importorskip("matplotlib.animation").AbstractMovieWriter


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def record():
    return datasets.load_demo()


@pytest.fixture(scope="module")
def model(record):
    return NRFRegressor(degree=3).fit(record)


DISPLAYS = [
    RestoringForceDisplay,
    HysteresisDisplay,
    FreeRunDisplay,
    ResidualDisplay,
    IntervalsDisplay,
    ModesDisplay,
]


@pytest.mark.parametrize("display", DISPLAYS)
def test_a_display_draws_itself_and_plots_again(display, model):
    shown = display.from_estimator(model)
    first = shown.figure_
    assert np.all([ax.has_data() for ax in np.ravel(shown.ax_)])
    assert shown.plot() is shown
    assert shown.figure_ is not first


def test_steps_of_a_loop_are_drawn():
    report = loop_report()
    shown = StepsDisplay.from_report(report)
    heights = [patch.get_height() for patch in shown.ax_.patches]
    held_out = report.table["held-out"]
    assert heights[0] == pytest.approx(held_out.iloc[0])
    assert held_out.iloc[-1] == pytest.approx(
        heights[len(heights) // len(report.table) * (len(report.table) - 1)]
    )


@pytest.mark.slow
def test_modes_swing_by_cosines_of_one_slowed_clock(model):
    """A mode takes a cycle of 0.8 s times the fastest frequency over its own."""

    class Tips(AbstractMovieWriter):
        """Where the modes have their largest entry, frame by frame."""

        def setup(self, fig, outfile, dpi=None):
            self.tips = []

        def grab_frame(self, **options):
            lines = shown.ax_.lines[:3]
            self.tips.append(
                [float(line.get_xdata()[k]) for line, k in zip(lines, tips)]
            )

        def finish(self):
            pass

    shown = ModesDisplay.from_estimator(model)
    tips = [int(np.argmax(np.abs(x.get_xdata()))) for x in shown.ax_.lines[:3]]
    writer = Tips(fps=25)
    shown.animate().save("not written", writer=writer)

    frequency = model.modes()["frequency"].to_numpy()
    cycle = 0.8 * frequency[-1] / frequency
    t = np.arange(len(writer.tips))[:, None] / 25
    assert len(t) == round(25 * cycle[0])
    np.testing.assert_allclose(writer.tips, np.cos(2 * np.pi * t / cycle), atol=1e-9)


def test_given_axes_are_used(model):
    _, axes = plt.subplots(2)
    shown = FreeRunDisplay.from_estimator(model, dof=1, ax=axes)
    assert list(shown.ax_) == list(axes)
    assert len(plt.get_fignums()) == 1


def test_a_surface_needs_axes_in_space(model):
    _, ax = plt.subplots()
    with pytest.raises(NRFError, match="in space"):
        RestoringForceDisplay.from_estimator(model, storey=1, ax=ax)


def test_the_error_below_a_free_run_is_its_difference(model):
    motion, error = FreeRunDisplay.from_estimator(model, dof=2).ax_
    measured, run = (line.get_ydata() for line in motion.lines)
    np.testing.assert_allclose(error.lines[0].get_ydata(), run - measured, atol=1e-9)


def test_unknown_dofs_are_refused(model):
    with pytest.raises(ChannelError, match="no DOF 7"):
        FreeRunDisplay.from_estimator(model, dof=7)
    with pytest.raises(ChannelError, match="DOF 7"):
        ResidualDisplay.from_estimator(model, dof=7)


def test_a_model_without_data_is_not_drawn(model):
    with pytest.raises(ChannelError, match="no data"):
        HysteresisDisplay.from_estimator(model.model_)


def test_a_model_is_drawn_over_a_record(model, record):
    shown = HysteresisDisplay.from_estimator(model.model_, record, storey=3)
    assert "s_{3}" in shown.ax_.get_xlabel()


def test_the_noise_of_the_channels_is_what_the_right_model_leaves(model):
    """The demo holds 2 % of white noise on every channel and no other error."""
    ax = ResidualDisplay.from_estimator(model, dof=2).ax_[0]
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    inside = slice(5, -5)
    ratio = lines["residual"][inside] / lines["noise of the channels"][inside]
    assert 0.8 < np.median(ratio) < 1.3


def test_the_missing_force_is_the_friction_that_was_simulated():
    """Friction of 9 N jumps between its two values as the rate changes sign."""
    axes = loop_report().plot().ax_
    (over_rate,) = [ax for ax in axes if "rate v" in ax.get_xlabel()]
    missing, law = over_rate.lines[:2]
    rate = missing.get_xdata()
    sizes = []
    for line in (missing, law):
        sides = [line.get_ydata()[side * rate > 0.3] for side in (1, -1)]
        sizes.append(0.5 * (np.median(sides[0]) - np.median(sides[1])))
    assert sizes == pytest.approx([FC, FC], rel=0.1)


# -- records -------------------------------------------------------------------


def test_a_record_is_drawn_channel_by_channel(record):
    drawn = record.plot()
    labels = [ax.get_ylabel().split()[0] for ax in drawn.ax_]
    # floors 1 and 3 are known to be unforced
    assert labels == ["F2", "a1", "a2", "a3", "x1", "x2", "x3"]


def test_a_channel_in_doubt_is_marked(record):
    reversed_laser = record.replace(displacement=-record.displacement)
    labels = [ax.get_ylabel() for ax in reversed_laser.plot().ax_]
    assert [label for label in labels if "in doubt" in label]
    assert all("in doubt" not in ax.get_ylabel() for ax in record.plot().ax_)


def test_thinning_keeps_the_extremes():
    t = np.arange(100_000) / 1000.0
    y = np.sin(3 * t)
    y[77_777] = 9.0
    x, values = thinned(t, y, 1000)
    assert len(values) <= 1000
    assert values.max() == 9.0
    assert (np.diff(x) > 0).all()


def test_densities_hold_the_power_of_the_line():
    white = np.random.default_rng(0).normal(scale=3.0, size=100_000)
    f, power = density(white, 200.0)
    assert np.trapezoid(power, f) == pytest.approx(9.0, rel=0.03)


def test_coherence_is_one_without_noise_and_falls_with_it():
    """An output with as much noise as signal has a coherence of a half."""
    rng = np.random.default_rng(1)
    force, noise = rng.normal(size=(2, 200_000, 1))
    exact = spectra_of(force, 2.0 * force, 100.0).coherence
    noisy = spectra_of(force, force + noise, 100.0).coherence
    assert exact.min() > 0.999
    assert np.mean(noisy) == pytest.approx(0.5, abs=0.05)


def test_coherence_counts_all_forces():
    """Two forces drive; either alone explains less."""
    measured = two_storeys(n=16_000)
    both = coherence_figure(measured)
    shares = np.concatenate([np.asarray(line.y)[10:60] for line in both.marks])
    assert np.median(shares) > 0.9


def test_measured_responses_lie_on_those_of_the_linear_truth():
    """A mode of a simulated linear frame, away from its peaks."""

    force = excitation.band_limited_random(
        2, 80.0, 500.0, excited=[2], rms=60.0, band=(1, 40), random_state=0
    )
    measured = simulate(TWO_STOREYS, force, 1 / 500.0)
    figure = measured_response_figure(measured, TWO_STOREYS, (3.0, 35.0))
    for panel in figure.panels:
        data, law = (np.asarray(line.y) for line in panel.marks)
        assert np.median(np.abs(np.log(data / law))) < 0.05


def test_time_figures_say_what_is_in_doubt(record):
    figures = time_figures(record, {"a2": ["clipped"]})
    (accelerations,) = [f for f in figures if f.title.startswith("Accel")]
    assert "a2" in accelerations.caption
