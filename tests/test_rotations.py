"""A drivetrain from its file to its results: torques, angles, inertias."""

import json
import re
from importlib.resources import files

import html_page
import jsonschema
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import (
    Chain,
    ChainModel,
    FreeRunDisplay,
    HysteresisDisplay,
    NRFRegressor,
    close_loop,
    datasets,
    excitation,
    io,
    laws,
    simulate,
)
from pysindy_nrf.cli import run
from pysindy_nrf.common.unit_system import ROTATION, TRANSLATION
from pysindy_nrf.exceptions import ChannelError, SimulationError
from pysindy_nrf.records.files import write_record
from pysindy_nrf.report import as_html, write_workbook

INERTIAS = [0.5, 0.2]  # kg m^2
STIFFNESSES = [800.0, 400.0]  # N m/rad
FRICTION = 2.0  # N m, in the lower shaft

# A force, a mass, a length or a velocity in the units of translations.
OF_TRANSLATIONS = re.compile(r"(?<!\w)(k?N(?! m\b)|kg(?! m[\^²])|mm|m/s)(?!\w)")


def shaft(stiffness):
    return [laws.LinearElastic(stiffness), laws.LinearViscous(5e-4 * stiffness)]


def drivetrain(friction=0.0):
    lower = shaft(STIFFNESSES[0])
    if friction:
        lower.append(laws.CoulombFriction(friction))
    by_site = {1: lower, 2: shaft(STIFFNESSES[1])}
    return ChainModel(INERTIAS, by_site, Chain(2, rotates=True))


def file_of(folder, friction=0.0):
    """A torque on the upper inertia and the motion of both, as a laboratory writes."""
    F = excitation.band_limited_random(
        2, 6.0, 500.0, excited=2, rms=20.0, band=(1, 40), random_state=0
    )
    measured = simulate(drivetrain(friction), F, 2e-3)
    table = pd.DataFrame({"t [s]": measured.time, "F2 [N m]": measured.force[:, 1]})
    for j in (1, 2):
        table[f"x{j} [rad]"] = measured.displacement[:, j - 1]
        table[f"v{j} [rad/s]"] = measured.velocity[:, j - 1]
        table[f"a{j} [rad/s^2]"] = measured.acceleration[:, j - 1]
    path = folder / "drivetrain.csv"
    table.to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return file_of(tmp_path_factory.mktemp("linear"))


@pytest.fixture(scope="module")
def path_with_friction(tmp_path_factory):
    return file_of(tmp_path_factory.mktemp("friction"), FRICTION)


@pytest.fixture(scope="module")
def fitted(path):
    return NRFRegressor(degree=1).fit(io.read_record(path))


def assert_no_translation(text):
    match = OF_TRANSLATIONS.search(text)
    assert match is None, text[max(0, match.start() - 60) : match.end() + 20]


@pytest.mark.parametrize(
    ("unit", "of_rotation"),
    [
        ("N", "N m"),
        ("kN", "kN m"),
        ("kg", "kg m^2"),
        ("mm", "mrad"),
        ("N s/m", "N m s/rad"),
        ("N/m^3", "N m/rad^3"),
        ("N/(m s)", "N m/(rad s)"),
        ("N (s/m)^0.45", "N m (s/rad)^0.45"),
        ("m/s²/N", "rad/s²/(N m)"),
        ("N^2", "(N m)^2"),
        ("1/m", "1/rad"),
        ("Hz", "Hz"),
        ("s", "s"),
    ],
)
def test_a_unit_reads_in_rotation_and_stays_in_translation(unit, of_rotation):
    assert ROTATION.of(unit) == of_rotation
    assert TRANSLATION.of(unit) == unit


def test_the_file_is_understood_as_rotations(path, capsys):
    assert run(["inspect", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "N m" in shown and "rad/s^2" in shown
    assert_no_translation(shown)


def test_a_fit_finds_inertias_and_stiffnesses_and_says_their_units(fitted):
    model = fitted.model_
    np.testing.assert_allclose(model.masses, INERTIAS, rtol=1e-6)
    k = [model.restoring_forces[i].coefficients["s"] for i in (1, 2)]
    np.testing.assert_allclose(k, STIFFNESSES, rtol=1e-6)

    table = fitted.summary().to_frame()
    assert table.loc["m1", "unit"] == "kg m^2"
    assert table.loc["storey 1: s", "unit"] == "N m/rad"
    assert table.loc["storey 2: v", "unit"] == "N m s/rad"
    for text in (str(model), str(fitted.summary()), model._repr_html_()):
        assert_no_translation(text)
    assert max(map(len, str(fitted.summary()).splitlines())) <= 92


def test_the_saved_model_is_of_rotations(fitted, tmp_path):
    path = tmp_path / "model.json"
    fitted.model_.to_json(path)
    schema = files("pysindy_nrf") / "common/schemas/chain_model.schema.json"
    jsonschema.validate(json.loads(path.read_text()), json.loads(schema.read_text()))

    again = ChainModel.from_json(path)
    assert again == fitted.model_ and str(again) == str(fitted.model_)
    assert again.chain.rotates and again.with_laws({}).chain.rotates
    as_translation = ChainModel(again.masses, again.laws)
    assert as_translation != again


def test_the_page_and_its_figures_are_of_rotations(fitted, path):
    text = as_html(fitted, io.read_record(path))
    page = html_page.Page(text)
    assert "N m/rad" in page.text
    assert_no_translation(page.text)
    drawn = json.dumps(html_page.figures(text), ensure_ascii=False)
    assert "rad" in drawn and "N m" in drawn
    assert_no_translation(drawn)


def test_displays_and_workbook_are_of_rotations(fitted, tmp_path):
    pytest.importorskip("matplotlib")
    axes = HysteresisDisplay.from_estimator(fitted, storey=1).ax_
    assert axes.get_xlabel().endswith("(rad)")
    assert axes.get_ylabel().endswith("(N m)")
    assert FreeRunDisplay.from_estimator(fitted).ax_[0].get_ylabel().endswith("(rad)")

    pytest.importorskip("openpyxl")
    target = write_workbook(tmp_path / "b.xlsx", fitted.summary(), fitted.model_)
    units = pd.read_excel(target, sheet_name="Masses")["unit"]
    assert set(units) == {"kg m^2"}


@pytest.mark.parametrize("command", ["identify", "forces"])
def test_commands_print_rotations(command, path, tmp_path, capsys):
    run([command, str(path), "-o", str(tmp_path / "out"), "--no-figures"])
    shown = capsys.readouterr().out
    assert "N m" in shown
    assert_no_translation(shown)


def test_hidden_friction_is_a_torque(path_with_friction):
    report = close_loop(io.read_record(path_with_friction))
    step = report.steps[0]
    assert (step.family, step.site, step.confirmed) == ("friction", "storey 1", True)
    assert step.parameters["Fc"] == pytest.approx(FRICTION, rel=0.02)
    assert step.units["Fc"] == "N m"
    assert "N m" in report.verdict.sentence
    for text in (report.verdict.sentence, report.to_markdown(), str(report.model)):
        assert_no_translation(text)
    assert report.model.chain.rotates

    page = as_html(report)
    assert_no_translation(html_page.Page(page).text)
    assert_no_translation(json.dumps(html_page.figures(page), ensure_ascii=False))


def test_a_floor_without_a_sensor_is_of_rotations_as_well(path):
    record = io.read_record(path)
    upper_alone = record.displacement * [np.nan, 1.0]
    measured = record.replace(
        acceleration=None, velocity=None, displacement=upper_alone
    )
    fitted = NRFRegressor(degree=1).fit(measured)
    np.testing.assert_allclose(fitted.masses_, INERTIAS, rtol=0.02)
    assert set(fitted.summary().to_frame()["unit"][:2]) == {"kg m^2"}
    assert_no_translation(str(fitted.model_))


def test_a_record_that_was_written_is_read_as_rotations(path, tmp_path, capsys):
    record = io.read_record(path)
    written = write_record(record, tmp_path / "again.csv")
    run(["inspect", str(written)])
    assert " in m" not in capsys.readouterr().out
    again = io.read_record(written)
    assert again.rotates
    np.testing.assert_array_equal(again.displacement, record.displacement)


def test_rotations_and_translations_are_no_one_chain(path):
    record = io.read_record(path)
    as_translation = record.with_quality(())
    for both in ([record, as_translation], [as_translation, record]):
        with pytest.raises(ChannelError, match="rotations"):
            NRFRegressor(degree=1).fit(both)
        with pytest.raises(ChannelError, match="rotations"):
            close_loop(both)


def test_a_chain_of_rotations_is_declared_for_arrays(fitted, path):
    X, F = io.read_record(path).with_quality(()).to_features()
    chain = Chain(2, rotates=True)
    model = NRFRegressor(degree=1, chain=chain, dt=2e-3).fit(X, F).model_
    assert "kg m^2" in str(model)
    assert eval(repr(chain)) == chain != Chain(2)


def test_masses_that_cannot_move_are_inertias():
    shaft_without_inertia = ChainModel(
        [0.5, -0.2],
        {1: laws.LinearElastic(800.0), 2: laws.LinearElastic(400.0)},
        Chain(2, rotates=True),
    )
    with pytest.raises(SimulationError, match=r"-0\.2 kg m\^2"):
        simulate(shaft_without_inertia, np.ones((10, 2)), 1e-3)


def test_translations_print_as_before():
    model = datasets.demo_truth()
    assert "kg  (R in N, s in m, v in m/s)" in str(model)
    assert "kg m" not in str(model) and "rad" not in str(model)
    assert "rotates" not in model.to_json()
    table = NRFRegressor(degree=1).fit(datasets.load_demo()).summary().to_frame()
    assert table.loc["m2", "unit"] == "kg"
    assert table.loc["storey 1: s", "unit"] == "N/m"
