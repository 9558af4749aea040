"""Gram matrices by frequency band: the discrete Fourier transform written out, Parseval, and what weights on bands do."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from pysindy_nrf import Chain, laws
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.mechanics.identifiability import plan_solve_order
from pysindy_nrf.regression.chain_solve import groups_of, solve
from pysindy_nrf.regression.grams import band_edges, band_grams
from pysindy_nrf.regression.input_arrays import from_arrays
from pysindy_nrf.regression.layout import LawLayout, Layout, blocks_of

LAYOUT = Layout(Chain(2), {"storey 1": 2, "storey 2": 1})
GROUPS = [LAYOUT.group(dofs) for dofs in ((1,), (2,), (1, 2))]
MASSES = {1: 2.0, 2: 3.0}
DT, SIZE = 0.01, 64
EDGES = np.array([0.0, 2.0, 8.0, 20.0, 60.0])  # Hz


def _data(n=300, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)), rng.normal(size=(n, 2)), rng.normal(size=(n, 2))


def _columns(data, dofs):
    terms, a, F = data
    own = {(1,): [0, 1, 2], (2,): [2], (1, 2): [0, 1]}[dofs]
    if len(dofs) == 1:
        return np.column_stack([terms[:, own], a[:, dofs[0] - 1], F[:, dofs[0] - 1]])
    return np.column_stack([terms[:, own], F.sum(axis=1) - a @ [2.0, 3.0]])


def _grams(data, edges=EDGES, blocks=50):
    return band_grams(LAYOUT, GROUPS, [(blocks_of(*data, blocks), DT)], MASSES, length=SIZE * DT, edges=edges)


WINDOW = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(SIZE) / SIZE)


@pytest.mark.parametrize("dofs", [(1,), (2,), (1, 2)], ids=str)
def test_each_band_holds_the_products_of_its_lines(dofs):
    """The transform as a matrix, both signs of the frequency; divided by 3/4, the mean square of overlapping windows."""
    data = _data()
    grams = _grams(data)
    columns = _columns(data, dofs)
    k = np.arange(SIZE)
    fourier = np.exp(-2j * np.pi * np.outer(k, k) / SIZE)
    frequency = np.abs(np.fft.fftfreq(SIZE, DT))
    starts = range(0, 300 - SIZE + 1, SIZE // 2)
    assert grams.shape == (len(starts), 4) and np.array_equal(grams.edges, EDGES)
    for i, start in enumerate(starts):
        Z = fourier @ (WINDOW[:, None] * columns[start : start + SIZE])
        for band, (low, high) in enumerate(zip(EDGES[:-1], EDGES[1:])):
            own = Z[(frequency >= low) & (frequency < high)]
            wanted = (own.conj().T @ own).real / SIZE / 0.75
            assert np.allclose(grams.matrices[dofs][i, band], wanted, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("edges", [None, EDGES], ids=["logarithmic", "given"])
def test_all_bands_of_a_window_hold_its_products_in_time(edges):
    """Parseval, window by window."""
    data = _data()
    grams = _grams(data, edges)
    for dofs, matrix in grams.matrices.items():
        for i in range(len(grams)):
            rows = WINDOW[:, None] * _columns(data, dofs)[32 * i : 32 * i + SIZE]
            assert np.allclose(matrix[i].sum(axis=0), rows.T @ rows / 0.75, rtol=1e-11, atol=1e-10)
    assert grams.sizes[1,].sum(axis=1) == pytest.approx(32.0)  # half a window of samples each


def test_all_windows_of_a_long_record_hold_the_products_of_its_samples():
    data = _data(20_000)
    grams = _grams(data, blocks=4096).sum()
    for dofs, matrix in grams.matrices.items():
        columns = _columns(data, dofs)
        size = np.linalg.norm(columns, axis=0)
        assert np.abs((matrix - columns.T @ columns) / np.outer(size, size)).max() < 0.01
        assert grams.sizes[dofs] == pytest.approx(20_000, rel=0.01)


@pytest.mark.parametrize("blocks", [1, 31, 64, 1000])
def test_windows_do_not_depend_on_how_the_samples_come(blocks):
    data = _data()
    for dofs, matrix in _grams(data, blocks=blocks).matrices.items():
        assert np.allclose(matrix, _grams(data).matrices[dofs], rtol=1e-12, atol=1e-12)


def test_records_are_not_joined_and_unknown_forces_are_left_out():
    first, second = _data(200), _data(100, seed=1)
    second[2][:, 1] = np.nan
    records = [(blocks_of(*d, 50), DT) for d in (first, second, _data(40))]  # the last is shorter than a window
    grams = band_grams(LAYOUT, GROUPS, records, MASSES, length=SIZE * DT, edges=EDGES)
    assert grams.record.tolist() == [0] * 5 + [1] * 2
    assert np.allclose(grams.matrices[1,][5:], _grams(second).matrices[1,])
    for dofs in ((2,), (1, 2)):
        assert not grams.matrices[dofs][5:].any() and not grams.sizes[dofs][5:].any()
    assert np.allclose(grams.n_samples.sum(axis=1), 32.0)


def test_a_balance_holds_in_every_band():
    """Columns of a power series and friction: no leakage, so that any choice of bands and weights gives the truth."""
    rng = np.random.default_rng(0)
    s = np.cumsum(rng.normal(size=(4000, 1)), axis=0) * 1e-3
    v, a = np.gradient(s, DT, axis=0), rng.normal(size=(4000, 1))
    F = 10 * a + 3 * v + 500 * s + 4 * np.sign(v)
    layout = LawLayout(Chain(1), {1: [laws.PowerSeries(1), laws.CoulombFriction()]})
    solve_order = plan_solve_order(layout.chain, (1,), (), {}, "auto", layout.acting)
    segment = from_arrays(np.hstack([a, v, s]), F, dt=DT).segments[0]
    grams = band_grams(layout, groups_of(layout, solve_order), [(segment.blocks(layout), segment.dt)], length=2.0)
    for band in (3, 10, len(grams.edges) - 2):
        weights = np.zeros(grams.shape)
        weights[:, band - 2 : band + 1] = [1.0, 0.2, 7.0]
        found = solve(grams.sum(weights), solve_order)
        assert found.masses[1] == pytest.approx(10.0, rel=1e-8)
        assert found.coefficients["storey 1"].tolist() == pytest.approx([3.0, 500.0, 4.0], rel=1e-6)


def test_a_sine_lies_in_its_band():
    t = DT * np.arange(640)[:, None]
    s = np.sin(2 * np.pi * 12.5 * t)
    grams = _grams((np.hstack([s, 0 * s, 0 * s]), 0 * t + np.zeros(2), np.zeros((640, 2))), EDGES)
    power = grams.matrices[1,][:, :, 0, 0].sum(axis=0)
    assert power[2] / power.sum() > 0.999  # 8 to 20 Hz


def test_edges_are_even_on_a_logarithmic_axis_and_no_band_is_empty():
    edges = band_edges(4.0, 0.005)
    lines = np.fft.rfftfreq(800, 0.005)
    count = np.histogram(lines, edges)[0]
    assert count.min() > 0 and count.sum() == len(lines) and count[0] == 2  # the mean of a Hann window
    upper = np.log(edges[-8:])
    assert np.diff(upper) == pytest.approx(np.diff(upper).mean(), rel=0.05)


def test_memory_does_not_grow_with_the_record():
    """Spectra of a few windows at a time."""
    def peak(n):
        data = _data(n)
        tracemalloc.start()
        grams = band_grams(LAYOUT, GROUPS, [(blocks_of(*data), DT)], MASSES, length=20.48, edges=EDGES)
        assert grams.shape[0] == n // 1024 - 1
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    _grams(_data())
    assert peak(400_000) < 1.2 * peak(200_000) + 1e6


def test_what_has_no_clock_or_no_window_is_refused():
    with pytest.raises(ChannelError, match="need the sampling step"):
        band_grams(LAYOUT, GROUPS, [(blocks_of(*_data()), None)], MASSES, length=1.0)
    with pytest.raises(ChannelError, match="No record is as long as a window of 5 s"):
        band_grams(LAYOUT, GROUPS, [(blocks_of(*_data()), DT)], MASSES, length=5.0)
