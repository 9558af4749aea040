"""Cross-validated ridge regression on blocks of samples, by hand."""

import numpy as np
import pytest

from pysindy_nrf.equations import Regression, in_blocks

FOLDS, BLOCKS = 4, 13
SIZES = (310, 95)
COLUMNS = {"a": slice(0, 2), "b": slice(2, 4), "zero": slice(4, 5)}


@pytest.fixture(scope="module")
def records():
    """Columns of two records, of many sizes, and a target that they explain in part."""
    rng = np.random.default_rng(3)
    scale, offset = [1, 1, 1e3, 1e-2, 0], [0, 0.5, 0, 0, 0]
    columns = [rng.standard_normal((n, 5)) * scale + offset for n in SIZES]
    targets = []
    for lines in columns:
        explained = lines @ [2.0, -1.0, 1e-3, 30.0, 1.0]
        targets.append(explained + rng.standard_normal(len(lines)))
    return columns, targets


@pytest.fixture(scope="module")
def regression(records):
    columns, targets = records
    groups = {}
    for name, chosen in COLUMNS.items():
        groups[name] = [lines[:, chosen] for lines in columns]
    return Regression.of({**groups, "f": targets}, BLOCKS, FOLDS)


@pytest.fixture(scope="module")
def blocks(records):
    """The blocks by hand: each record in its share of them."""
    out = []
    for columns, target in zip(*records):
        count = round(BLOCKS * len(target) / sum(SIZES))
        out += zip(np.array_split(columns, count), np.array_split(target, count))
    return out


def left_by_hand(blocks, chosen):
    """Squares left in each block by least squares on the blocks of other folds."""
    squares_by_fold = []
    for k, (columns, target) in enumerate(blocks):
        others = [b for j, b in enumerate(blocks) if j % FOLDS != k % FOLDS]
        A = np.vstack([other for other, _ in others])[:, chosen]
        y = np.concatenate([other for _, other in others])
        w = np.linalg.lstsq(A, y, rcond=None)[0]
        squares_by_fold.append(((target - columns[:, chosen] @ w) ** 2).sum())
    return np.array(squares_by_fold)


def test_it_is_least_squares_on_the_other_folds(regression, blocks):
    assert regression.folds.tolist() == [k % FOLDS for k in range(len(blocks))]
    squares = [target @ target for _, target in blocks]
    assert regression.unexplained("f") == pytest.approx(squares)
    by_hand = left_by_hand(blocks, [0, 1])
    assert regression.unexplained("f", ["a"]) == pytest.approx(by_hand, rel=2e-3)


def test_a_share_and_its_error_are_those_of_the_jackknife(regression, blocks):
    before, after = left_by_hand(blocks, [0, 1]), left_by_hand(blocks, [0, 1, 2, 3])
    share, error = regression.share("f", ["b", "zero"], ["a"])
    assert share == pytest.approx(1 - after.sum() / before.sum(), abs=2e-4)

    ratio = (after.sum() - after) / (before.sum() - before)
    jackknife = np.sqrt((len(ratio) - 1) * np.var(ratio))
    assert error == pytest.approx(jackknife, rel=2e-2)


def test_coefficients_are_those_of_all_data(regression, records):
    columns, targets = records
    A, y = np.vstack([lines[:, :4] for lines in columns]), np.concatenate(targets)
    coefficients = regression.coefficients("f", ["b", "a"])
    exact = np.linalg.lstsq(A, y, rcond=None)[0]
    assert [*coefficients["a"], *coefficients["b"]] == pytest.approx(exact, rel=1e-5)


def test_of_a_target_of_zeros_nothing_is_explained():
    fit = Regression.of({"a": [np.ones((50, 1))], "f": [np.zeros(50)]})
    assert fit.share("f", ["a"]) == (0.0, 0.0)


def test_blocks_are_contiguous_and_about_equal():
    records = [np.arange(100), np.arange(100, 160)]
    blocks = in_blocks(records, 8)
    assert np.concatenate(blocks).tolist() == list(range(160))
    assert {len(block) for block in blocks} == {20}
