"""Frequency responses: rows of the balances, noise that biases nothing, faults."""

import warnings

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning, FileFormatError
from pysindy_nrf.records import FrequencyResponse
from pysindy_nrf.records.files import frf_to_features, read_frf, read_table

MASSES = np.array([5.0, 4.0, 6.0])
DAMPING = np.array([3.0, 2.0, 4.0])
STIFFNESS = np.array([3e4, 4e4, 2e4])


def receptance(f, excited):
    """Of a chain on the ground, from its matrices: (K - w^2 M + i w C)^-1."""
    drifts = np.eye(3) - np.eye(3, k=-1)
    damping = drifts.T @ np.diag(DAMPING) @ drifts
    stiffness = drifts.T @ np.diag(STIFFNESS) @ drifts
    w = 2 * np.pi * f[:, None, None]
    dynamic_stiffness = stiffness - w**2 * np.diag(MASSES) + 1j * w * damping
    return np.linalg.inv(dynamic_stiffness)[:, :, excited - 1]


def accelerance(f, excited):
    return (2j * np.pi * f[:, None]) ** 2 * receptance(f, excited)


def linear_part(model, name):
    """A coefficient of each of the three storeys."""
    return [model.restoring_forces_[i].linear_part()[name] for i in (1, 2, 3)]


F = np.linspace(2.0, 25.0, 120)
H = accelerance(F, 2)


@pytest.mark.parametrize("excited", [1, 2, 3])
def test_every_parameter_comes_out_exactly(excited):
    f = np.linspace(2, 30, 300)
    X, forces = frf_to_features(f, accelerance(f, excited), excited)
    model = NRFRegressor(degree=1).fit(X, forces)
    np.testing.assert_allclose(model.masses_, MASSES, rtol=1e-9)
    np.testing.assert_allclose(linear_part(model, "c"), DAMPING, rtol=1e-8)
    np.testing.assert_allclose(linear_part(model, "k"), STIFFNESS, rtol=1e-8)


@pytest.mark.parametrize(
    ("kind", "power"), [("receptance", 0), ("mobility", 1), ("accelerance", 2)]
)
def test_kinds_are_one_response(kind, power):
    iw = 2j * np.pi * F[:, None]
    response = FrequencyResponse.from_arrays(F, iw**power * receptance(F, 2), 2, kind)
    np.testing.assert_allclose(response.H, H, rtol=1e-12)


def test_text_with_a_header_i_and_a_line_at_zero(tmp_path):
    f = np.array([0.0, 1.0, 2.0])
    response = np.array([[0, 0], [1 + 2j, -3e-3 - 4j], [0.5j, 7]])
    lines = ["f;H1;H2"]
    for frequency, row in zip(f, response):
        numbers = [f"{z.real:.17g}{z.imag:+.17g}i" for z in row]
        lines.append(";".join([str(frequency), *numbers]))
    (tmp_path / "H.csv").write_text("\n".join(lines) + "\n")

    frf = read_frf(tmp_path / "H.csv", excited=2)
    np.testing.assert_array_equal(frf.f, f[1:])
    np.testing.assert_array_equal(frf.H, response[1:])


def test_arrays_as_one_matrix_or_one_by_one(tmp_path):
    np.savez(tmp_path / "matrix.npz", f=F, H=H)
    np.savez(tmp_path / "lines.npz", freq=F, H1=H[:, 0], H2=H[:, 1], H3=H[:, 2])
    for name in ("matrix.npz", "lines.npz"):
        np.testing.assert_array_equal(read_frf(tmp_path / name, excited=2).H, H)


BAD_TEXTS = {
    "row 3.*oops": "f;H1\n1;0.1+0.2j\n2;oops\n3;0.1j\n",
    "no complex": "f;H1\n1;0.1\n2;0.2\n",
    "row 1.* is not 2 numbers": "1;0.1j;0.2\n2;0.1j\n",
    "one column": "just words\n",
    "holds no rows": "# only words\n% and more\n\n",
    "no rows of numbers": "f;H1\n",
    "H.csv": "f;H1 [m/s²/N]\n1;0.1j\n".encode("latin-1"),
}


@pytest.mark.parametrize(("words", "text"), BAD_TEXTS.items())
def test_errors_name_row_and_cure(written, words, text):
    with pytest.raises(FileFormatError, match=words):
        read_frf(written(text, "H.csv"))


@pytest.mark.parametrize(
    "content",
    [{"freq": F, "H1": H[:, 0], "H2": H[:-1, 1]}, {"f": F, "H": np.abs(H)}],
    ids=["uneven", "real"],
)
def test_arrays_that_are_no_response(tmp_path, content):
    np.savez(tmp_path / "H.npz", **content)
    with pytest.raises(FileFormatError, match="complex responses 'H'"):
        read_frf(tmp_path / "H.npz")


def one_spoilt(array, position, value):
    """A copy with another value in one place."""
    spoilt = array.copy()
    spoilt[position] = value
    return spoilt


IMPOSSIBLE = {
    "frequencies are complex": {"f": F + 1j},
    r"\(119,\) frequencies.*\(120, 3\)": {"f": F[:-1]},
    "kind='inertance' is unknown.*receptance": {"kind": "inertance"},
    "row 0 is -3": {"f": F - 5.0},
    "row 94 is nan": {"f": one_spoilt(F, 94, np.nan)},
    "does not rise after row 0": {"f": F[::-1]},
    "excited=4 is not one": {"excited": 4},
    "H2 is not finite in row 1": {"H": one_spoilt(H, (1, 1), np.nan)},
}


@pytest.mark.parametrize(("words", "change"), IMPOSSIBLE.items())
def test_a_response_that_cannot_be_one(words, change):
    response = {"f": F, "H": H, "excited": 2} | change
    with pytest.raises(ChannelError, match=words):
        FrequencyResponse.from_arrays(**response)


def test_a_line_of_weight_zero_is_not_used():
    """Rows of a balance that close exactly close under any weight."""
    spoilt = one_spoilt(H, 30, 3.0 * H[30])
    weight = one_spoilt(1.0 / F, 30, 0.0)
    X, forces = frf_to_features(F, spoilt, 2, weight=weight)
    model = NRFRegressor(degree=1).fit(X, forces)
    np.testing.assert_allclose(model.masses_, MASSES, rtol=1e-8)


@pytest.mark.parametrize(
    "weight", [np.ones(119), -np.ones(120), np.full(120, np.nan)], ids=range(3)
)
def test_weights_are_positive_and_as_many_as_lines(weight):
    with pytest.raises(ChannelError, match="weight has the shape"):
        frf_to_features(F, H, 2, weight=weight)


def test_a_band_without_lines_is_refused():
    with pytest.raises(ChannelError, match="no line in the band"):
        frf_to_features(F, H, 1, band=(27, 29))


LINES = np.linspace(1.0, 25.0, 500)
W = 2 * np.pi * LINES[:, None]
TRUE = accelerance(LINES, 2)
REAL, IMAGINARY = 0.01 * np.random.default_rng(4).normal(size=(2, 500, 3)) / np.sqrt(2)
NOISE = REAL + 1j * IMAGINARY  # 1 % rms


@pytest.mark.parametrize(
    "size",
    [np.abs(TRUE), np.sqrt((np.abs(TRUE) ** 2).mean(axis=0))],
    ids=["relative", "white"],
)
def test_one_percent_noise_biases_no_mass_and_accuses_nothing(size):
    """Least squares on the same rows misses by 7 % (relative) and 93 % (white)."""
    response = FrequencyResponse.from_arrays(LINES, TRUE + size * NOISE, 2)
    with warnings.catch_warnings(action="error"):
        model = NRFRegressor(degree=1).fit(response)
    np.testing.assert_allclose(model.masses_, MASSES, rtol=0.01)
    np.testing.assert_allclose(linear_part(model, "k"), STIFFNESS, rtol=0.01)


FAULTS = {
    "DOF 2, 3.*sign.*H3": {"factor": [1, 1, -1.0]},
    "unit.*H3": {"factor": [1, 1, 1 / 9.80665]},
    "gain.*H3": {"factor": [1, 1, 1.2]},
    "delay of .*H3": {"factor": np.exp(-4e-3j * W * [0, 0, 1.0])},
    "order of the channels": {"order": [1, 0, 2]},
    "the force .is it late": {"factor": np.exp(-4e-3j * W)},
    "kind": {"kind": "mobility"},
    "the force acts on DOF 2": {"excited": 3},
    "H2.*gives energy back": {"factor": -1.0},
}


@pytest.mark.parametrize(("words", "fault"), FAULTS.items())
def test_a_fault_of_a_response_is_named(words, fault):
    measured = TRUE * (1 + NOISE) * np.asarray(fault.get("factor", 1.0))
    response = FrequencyResponse.from_arrays(
        LINES,
        measured[:, fault.get("order", [0, 1, 2])],
        excited=fault.get("excited", 2),
        kind=fault.get("kind", "accelerance"),
    )
    with pytest.warns(DataQualityWarning, match=words):
        NRFRegressor(degree=1).fit(response)


def in_two_columns(form):
    """The responses as columns of real numbers."""
    columns = {"f": F}
    for j, h in enumerate(H.T, 1):
        if form == "parts":
            columns |= {f"H{j}_re": h.real, f"H{j}_im": h.imag}
        elif form == "words":
            columns |= {f"Real(H{j})": h.real, f"Imag(H{j})": h.imag}
        elif form == "degrees":
            columns |= {
                f"|H{j}| mag": abs(h),
                f"H{j} phase [deg]": np.angle(h, deg=True),
            }
        else:
            columns |= {f"H{j} dB": 20 * np.log10(abs(h))}
            columns |= {f"H{j} phase (rad)": np.angle(h)}
    return columns


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("form", ["parts", "words", "degrees", "decibel"])
def test_responses_in_two_columns(tmp_path, form, separator):
    path = tmp_path / "h.csv"
    pd.DataFrame(in_two_columns(form)).to_csv(path, index=False, sep=separator)
    np.testing.assert_allclose(read_frf(path, excited=2).H, H, rtol=1e-9)


@pytest.mark.parametrize(
    ("unit", "factor", "power"),
    [("m/N", 1.0, 0), ("mm/kN", 1e6, 0), ("m/s/N", 1.0, 1), ("g/N", 1 / 9.80665, 2)],
)
def test_units_of_responses_say_their_kind(tmp_path, unit, factor, power):
    response = factor * (2j * np.pi * F[:, None]) ** power * receptance(F, 2)
    columns = {"Frequency (Hz)": F}
    for k, line in enumerate(response.T, 1):
        columns[f"H{k} mag ({unit})"] = abs(line)
        columns[f"H{k} phase (deg)"] = np.angle(line, deg=True)
    file = tmp_path / "test.csv"
    pd.DataFrame(columns).to_csv(file, index=False)

    measured = read_frf(file, excited=2)

    np.testing.assert_allclose(measured.H, H, rtol=1e-9)


def test_a_kind_against_the_units_is_refused(tmp_path):
    file = tmp_path / "test.csv"
    file.write_text("f,H1 (mm/N)\n1.0,0.1+0.1j\n2.0,0.2+0.1j\n")
    with pytest.raises(ChannelError, match="receptance"):
        read_frf(file, kind="accelerance")


def test_a_phase_in_no_unit_is_asked_for(tmp_path):
    path = tmp_path / "h.csv"
    columns = {"f": F, "mag": abs(H[:, 0]), "phase": np.angle(H[:, 0])}
    pd.DataFrame(columns).to_csv(path, index=False)
    with pytest.raises(FileFormatError, match="unit of the column 'phase'"):
        read_frf(path)


def test_responses_by_a_mapping(tmp_path):
    path = tmp_path / "h.csv"
    columns = {"Freq": F}
    for j, h in enumerate(H.T, 1):
        columns |= {f"A{j}": h.real, f"B{j}": h.imag}
    pd.DataFrame(columns).to_csv(path, index=False)
    mapping = {"f": "Freq"} | {f"H{j}": f"complex(A{j}, B{j})" for j in (1, 2, 3)}
    np.testing.assert_allclose(read_frf(path, excited=2, mapping=mapping).H, H)
    with pytest.raises(ChannelError, match="one response for each DOF"):
        read_frf(path, mapping={"f": "Freq", "H2": "A2"})
    with pytest.raises(ChannelError, match="no channel of a frequency response"):
        read_frf(path, mapping={"f": "Freq", "a1": "A2"})


def uff_response(node, values, reference=12, **more):
    """A frequency response of a node to a force on another, in m/s^2/N."""
    return {
        "type": 58,
        "func_type": 4,
        "binary": 0,
        "id1": "NONE",
        "rsp_node": node,
        "rsp_dir": 3,
        "ref_node": reference,
        "ref_dir": 3,
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 13,
        "data": values,
        "x": F,
    } | more


def test_responses_of_a_universal_file(uff):
    """Nodes 11, 12 and 13 are DOFs 1, 2 and 3; the force is on node 12."""
    g = {"ordinate_axis_units_lab": "g", "orddenom_axis_units_lab": "kN"}
    sets = [uff_response(10 + j, H[:, j - 1] * 1e3 / 9.80665, **g) for j in (3, 1, 2)]
    spectrum = uff_response(11, abs(H[:, 0]), func_type=2)
    frf = read_frf(uff(*sets, spectrum))
    assert frf.excited == 2
    np.testing.assert_allclose(frf.f, F, rtol=1e-5)
    np.testing.assert_allclose(frf.H, H, rtol=1e-5)


def test_the_force_of_a_universal_file_is_chosen(uff):
    sets = []
    for excited in (1, 2):
        for j, h in enumerate(accelerance(F, excited).T, 1):
            sets.append(uff_response(j, h, reference=excited))
    path = uff(*sets)
    with pytest.raises(FileFormatError, match="several nodes"):
        read_frf(path)
    np.testing.assert_allclose(read_frf(path, excited=2).H, H, rtol=1e-5)


def test_a_universal_file_of_spectra(uff):
    with pytest.raises(FileFormatError, match="no frequency response"):
        read_frf(uff(uff_response(11, abs(H[:, 0]), func_type=2)))
    with pytest.raises(FileFormatError, match="--frf"):
        read_table(uff(uff_response(11, H[:, 0])))
