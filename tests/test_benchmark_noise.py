"""The noise benchmark runs from end to end, and its Cramer-Rao bound is one."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

import noise  # noqa: E402


def test_the_benchmark_runs(capsys):
    for part in ("hammer", "intervals", "frequency response"):
        noise.main(["--seconds", "4", "--seeds", "1", "--repetitions", "2", "--jobs", "1", "--only", part])
    said = capsys.readouterr().out
    assert "5 %, hammer" in said and "Cramer-Rao bound" in said and "95 % intervals" in said
    rows = {line.split("  ")[0]: line.split("  ") for line in said.splitlines()}
    raw, iv = (float(next(x for x in rows[name][1:] if x).split()[0]) for name in ("ls, raw channels", "iv"))
    assert iv < 3 < 20 < raw


def test_the_bound_falls_with_noise_and_length(monkeypatch):
    """Errors are proportional to the noise, and to one over the root of the length."""
    monkeypatch.setattr(noise, "DURATION", 4.0)
    five, ten = noise.bound("5 %", 0), noise.bound("10 %", 0)
    np.testing.assert_allclose(ten / five, 2.0, rtol=1e-9)
    monkeypatch.setattr(noise, "DURATION", 16.0)
    assert np.median(five / noise.bound("5 %", 0)) == pytest.approx(2.0, rel=0.35)


def test_estimates_stay_above_the_bound_and_near_it():
    """Weighted instruments for the masses: within three of the smallest standard deviations there can be."""
    found = np.array([noise.quietly(noise.one, "5 %, hammer", "iv", seed) for seed in range(2)])
    ratio = np.sqrt(np.mean(found[:, : noise.N] ** 2)) / noise.bound("5 %, hammer", 0)[: noise.N].mean()
    assert 0.3 < ratio < 3.0
