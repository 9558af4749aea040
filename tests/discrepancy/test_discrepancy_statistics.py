"""The regression of the evidence and its columns against least squares written out."""

from __future__ import annotations

import numpy as np
import pytest

from pysindy_nrf.discrepancy.characterisation import Basis, Regression, share_of
from pysindy_nrf.laws import Motion

pytestmark = pytest.mark.slow


def motion(n=400, seed=0, **more):
    t = np.arange(n) / 50
    rng = np.random.default_rng(seed)
    w, p = rng.uniform(2.0, 9.0, 3), rng.uniform(0, 6, 3)
    s = sum(np.sin(w_ * t + p_) for w_, p_ in zip(w, p)) * 0.02
    v = sum(w_ * np.cos(w_ * t + p_) for w_, p_ in zip(w, p)) * 0.02
    return Motion(s, v, t=t, **more)


def test_groups_of_columns_hold_what_they_are_named_after():
    """Least squares on all samples: each group explains the force it stands for, and the simpler ones do not."""
    m = motion(4000, 1, covariates={"T": np.linspace(-1.0, 2.0, 4000)})
    slider = [0.0]
    for ds in np.diff(m.s):
        slider.append(np.clip(slider[-1] + ds / (0.3 * m.s.std()), -1.0, 1.0))
    forces = {
        "powers": m.s**3, "drift": np.maximum(np.abs(m.s) - 0.02, 0) * np.sign(m.s), "rate": np.tanh(2 * m.v / m.v.std()), "jump": np.sign(m.v),
        "surface": m.v * np.abs(m.s), "sliders": np.array(slider), "time": m.s * m.t, "covariate T": np.sign(m.v) * m.covariates["T"],
    }  # fmt: skip
    groups = Basis([m]).of(m)
    base = np.hstack([groups["constant"], groups["linear"]])

    def left(columns, f):
        return np.var(f - columns @ np.linalg.lstsq(columns, f, rcond=1e-10)[0]) / np.var(f)

    for name, f in forces.items():
        assert left(np.hstack([base, groups[name]]), f) < 0.05 < 2 * left(base, f), name


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
