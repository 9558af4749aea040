"""The regression of the evidence and its columns against least squares written out."""

from __future__ import annotations

import numpy as np
import pytest

from pysindy_nrf.discrepancy.characterisation import Regression, share_of

pytestmark = pytest.mark.slow


def test_the_regression_is_least_squares_on_the_other_folds():
    rng = np.random.default_rng(3)
    parts = [rng.standard_normal((n, 5)) * [1, 1, 1e3, 1e-2, 0] + [0, 0.5, 0, 0, 0] for n in (310, 95)]
    force = [p @ [2.0, -1.0, 1e-3, 30.0, 1.0] + rng.standard_normal(len(p)) for p in parts]
    groups = {"a": [p[:, :2] for p in parts], "b": [p[:, 2:4] for p in parts], "zero": [p[:, 4:] for p in parts]}
    fit = Regression.of({**groups, "f": force}, 13, 4)
    counts = [round(13 * 310 / 405), round(13 * 95 / 405)]
    blocks = [
        (p, f) for x, y, c in zip(parts, force, counts) for p, f in zip(np.array_split(x, c), np.array_split(y, c))
    ]
    assert fit.folds.tolist() == [k % 4 for k in range(sum(counts))]

    def left(columns):
        out = []
        for k, (p, f) in enumerate(blocks):
            others = [one for j, one in enumerate(blocks) if j % 4 != k % 4]
            A, y = np.vstack([q for q, _ in others])[:, columns], np.concatenate([g for _, g in others])
            w = np.linalg.lstsq(A, y, rcond=None)[0]
            out.append(((f - p[:, columns] @ w) ** 2).sum())
        return np.array(out)

    assert fit.left("f") == pytest.approx([f @ f for _, f in blocks])
    before, after = left([0, 1]), left([0, 1, 2, 3])
    assert fit.left("f", ["a"]) == pytest.approx(before, rel=2e-3)
    share, error = fit.share("f", ["b", "zero"], ["a"])
    assert share == pytest.approx(1 - after.sum() / before.sum(), abs=2e-4)
    ratios = [np.delete(after, k).sum() / np.delete(before, k).sum() for k in range(len(before))]
    n = len(ratios)
    assert error == pytest.approx(np.sqrt((n - 1) * np.var(ratios)), rel=2e-2)
    A, y = np.vstack([p[:, :4] for p in parts]), np.concatenate(force)
    found = fit.coefficients("f", ["b", "a"])
    assert [*found["a"], *found["b"]] == pytest.approx(np.linalg.lstsq(A, y, rcond=None)[0], rel=1e-5)
    assert Regression.of({"a": [np.ones((50, 1))], "f": [np.zeros(50)]}).share("f", ["a"]) == (0.0, 0.0)


def test_the_error_of_a_share_is_that_of_a_mean():
    after = np.array([0.3, 0.9, 0.4, 0.1, 0.7])
    assert share_of(np.ones(5), after) == (
        pytest.approx(1 - after.mean()),
        pytest.approx(after.std(ddof=1) / np.sqrt(5)),
    )
    assert np.isnan(share_of(np.ones(2), after[:2])[1])
    found = share_of(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    assert found[1] == pytest.approx(np.sqrt(2 * np.var([1.0, 0.5, 0.5])))
