"""Frequency responses: rows of the balances, exact in theory; noise that biases
nothing; faults that are named.
"""

import warnings

import numpy as np
import pytest

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning, FileFormatError
from pysindy_nrf.records.files import frf_to_features, read_frf
from pysindy_nrf.records.files.frequency_response import frequency_response

M, C, K = (
    np.array([5.0, 4.0, 6.0]),
    np.array([3.0, 2.0, 4.0]),
    np.array([3e4, 4e4, 2e4]),
)


def receptance(f, excited):
    """Of a chain on the ground, from its matrices: (K - w^2 M + i w C)^-1."""
    B = np.eye(3) - np.eye(3, k=-1)
    w = 2 * np.pi * f[:, None, None]
    Z = B.T @ np.diag(K) @ B - w**2 * np.diag(M) + 1j * w * (B.T @ np.diag(C) @ B)
    return np.linalg.inv(Z)[:, :, excited - 1]


F = np.linspace(2.0, 25.0, 120)
H = -((2 * np.pi * F[:, None]) ** 2) * receptance(F, 2)


@pytest.mark.parametrize("excited", [1, 2, 3])
def test_every_parameter_comes_out_exactly(excited):
    f = np.linspace(2, 30, 300)
    w = 2 * np.pi * f[:, None]
    X, F = frf_to_features(f, -(w**2) * receptance(f, excited), excited)
    model = NRFRegressor(degree=1).fit(X, F)
    np.testing.assert_allclose(model.masses_, M, rtol=1e-9)
    for i in (1, 2, 3):
        part = model.restoring_forces_[i].linear_part()
        np.testing.assert_allclose(
            [part["c"], part["k"]], [C[i - 1], K[i - 1]], rtol=1e-8
        )


def test_kinds_are_one_response():
    f = np.linspace(2, 30, 50)
    x = receptance(f, 2)
    iw = 2j * np.pi * f[:, None]
    for kind, H in {
        "receptance": x,
        "mobility": iw * x,
        "accelerance": iw**2 * x,
    }.items():
        np.testing.assert_allclose(
            frequency_response(f, H, 2, kind).H, iw**2 * x, rtol=1e-12
        )


def test_text_round_trip_with_header_i_and_zero_line(tmp_path):
    f = np.array([0.0, 1.0, 2.0])
    H = np.array([[0, 0], [1 + 2j, -3e-3 - 4j], [0.5j, 7]])
    rows = [
        ";".join([f"{a:.17g}", *(f"{z.real:.17g}{z.imag:+.17g}i" for z in row)])
        for a, row in zip(f, H)
    ]
    (tmp_path / "H.csv").write_text("\n".join(["f;H1;H2", *rows]) + "\n")
    frf = read_frf(tmp_path / "H.csv", excited=2)
    np.testing.assert_array_equal(frf.f, f[1:])
    np.testing.assert_array_equal(frf.H, H[1:])
    np.savez(tmp_path / "H.npz", f=f, H=H)
    np.testing.assert_array_equal(read_frf(tmp_path / "H.npz").H, H[1:])
    np.savez(tmp_path / "one_by_one.npz", freq=f, H1=H[:, 0], H2=H[:, 1])
    np.testing.assert_array_equal(
        read_frf(tmp_path / "one_by_one.npz", excited=2).H, H[1:]
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("f;H1\n1;0.1+0.2j\n2;oops\n3;0.1j\n", "row 3.*oops"),
        ("f;H1\n1;0.1\n2;0.2\n", "no complex"),
        ("1;0.1j;0.2\n2;0.1j\n", "row 1.* is not 2 numbers"),
        ("just words\n", "one column"),
        ("# only words\n% and more\n\n", "holds no rows"),
        ("f;H1\n", "no rows of numbers"),
        ("f;H1 [m/s²/N]\n1;0.1j\n".encode("latin-1"), "H.csv"),
    ],
)
def test_errors_name_row_and_cure(written, text, words):
    with pytest.raises(FileFormatError, match=words):
        read_frf(written(text, "H.csv"))


@pytest.mark.parametrize(
    "content",
    [{"freq": F, "H1": H[:, 0], "H2": H[:-1, 1]}, {"f": F, "H": np.abs(H)}],
    ids=["uneven", "real"],
)
def test_arrays_that_are_no_response(tmp_path, content):
    np.savez(tmp_path / "H.npz", **content)
    with pytest.raises(
        FileFormatError, match="no frequencies 'f' and complex responses 'H'"
    ):
        read_frf(tmp_path / "H.npz")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(f=F + 1j), "the frequencies are complex"),
        (dict(f=F[:-1]), r"\(119,\) frequencies for responses of shape \(120, 3\)"),
        (dict(kind="inertance"), "kind='inertance' is unknown. .*receptance"),
        (dict(f=F - 5.0), "the frequency in row 0 is -3"),
        (dict(f=np.where(F > 20, np.nan, F)), "the frequency in row 94 is nan"),
        (dict(f=F[::-1]), "does not rise after row 0"),
        (dict(excited=4), "excited=4 is not one of the 3 DOFs"),
        (
            dict(H=np.where(np.arange(360).reshape(120, 3) == 4, np.nan, H)),
            "H2 is not finite in row 1",
        ),
    ],
)
def test_a_response_that_cannot_be_one(change, words):
    with pytest.raises(ChannelError, match=words):
        frequency_response(**(dict(f=F, H=H, excited=2) | change))


def test_weights_leave_an_exact_response_exact_and_are_checked():
    """Rows of a balance that close exactly close under any weight; a line of weight
    zero is not used.
    """
    spoilt = H.copy()
    spoilt[30] *= 3.0
    X, forces = frf_to_features(
        F, spoilt, 2, weight=np.where(np.arange(120) == 30, 0.0, 1.0 / F)
    )
    np.testing.assert_allclose(
        NRFRegressor(degree=1).fit(X, forces).masses_, M, rtol=1e-8
    )
    for weight in (np.ones(119), -np.ones(120), np.full(120, np.nan)):
        with pytest.raises(
            ChannelError, match="for 120 lines, or is not positive and finite"
        ):
            frf_to_features(F, H, 2, weight=weight)
    with pytest.raises(ChannelError, match="no line in the band"):
        frf_to_features(F, H, 1, band=(27, 29))


LINES = np.linspace(1.0, 25.0, 500)
W = 2 * np.pi * LINES[:, None]
NOISE = 0.01 * np.random.default_rng(4).standard_normal((2, 500, 3)) / np.sqrt(2)
TRUE = -(W**2) * receptance(LINES, 2)


@pytest.mark.parametrize(
    "size",
    [np.abs(TRUE), np.sqrt((np.abs(TRUE) ** 2).mean(axis=0))],
    ids=["relative", "white"],
)
def test_one_percent_noise_biases_no_mass_and_accuses_nothing(size):
    """Least squares on the same rows is 7 % off with relative noise, and 93 % with
    white noise.
    """
    response = frequency_response(LINES, TRUE + size * (NOISE[0] + 1j * NOISE[1]), 2)
    with warnings.catch_warnings(action="error"):
        model = NRFRegressor(degree=1).fit(response)
    np.testing.assert_allclose(model.masses_, M, rtol=0.01)
    np.testing.assert_allclose(
        [model.restoring_forces_[i].linear_part()["k"] for i in (1, 2, 3)], K, rtol=0.01
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(factor=[1, 1, -1.0]), "DOF 2, 3.*sign.*H3"),
        (dict(factor=[1, 1, 1 / 9.80665]), "unit.*H3"),
        (dict(factor=[1, 1, 1.2]), "gain.*H3"),
        (dict(factor=np.exp(-4e-3j * W * [0, 0, 1.0])), "delay of .*H3"),
        (dict(order=[1, 0, 2]), "order of the channels"),
        (dict(factor=np.exp(-4e-3j * W)), "the force .is it late"),
        (dict(kind="mobility"), "kind"),
        (dict(excited=3), "the force acts on DOF 2 .excited=2"),
        (dict(factor=-1.0), "H2, where the force acts, gives energy back"),
    ],
    ids=[
        "sign",
        "unit",
        "gain",
        "delay",
        "swapped",
        "late force",
        "kind",
        "floor",
        "all signs",
    ],
)
def test_a_fault_of_a_response_is_named(change, words):
    noisy = (
        TRUE * (1 + NOISE[0] + 1j * NOISE[1]) * np.asarray(change.get("factor", 1.0))
    )
    response = frequency_response(
        LINES,
        noisy[:, change.get("order", [0, 1, 2])],
        change.get("excited", 2),
        change.get("kind", "accelerance"),
    )
    with pytest.warns(DataQualityWarning, match=words):
        NRFRegressor(degree=1).fit(response)
