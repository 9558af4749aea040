"""What the commands say."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from .work import Outcome

# Above this share of a balance unexplained, the estimates deserve a warning.
LARGE_ERROR = 15.0


def band_text(band: Any) -> str:
    """A band in words."""
    low, high = band if band is not None else (None, None)
    if not low and high is None:
        return "all frequencies"
    if high is None:
        return f"above {low:g} Hz"
    return f"{low or 0:g} to {high:g} Hz"


def heading(text: str) -> str:
    """A heading with a blank line above."""
    return f"\n{text}\n{'-' * len(text)}"


def indent(text: str) -> str:
    """Text moved in by two blanks."""
    return "\n".join(f"  {line}" for line in text.splitlines())


def table(frame: pd.DataFrame, digits: int = 4) -> str:
    """A table of numbers."""
    return frame.to_string(float_format=lambda x: "-" if np.isnan(x) else f"{x:.{digits}g}")


def result(outcome: Outcome, band: Any, truth: Any = None) -> str:
    """Masses, equations, errors and modes of an outcome."""
    est, model = outcome.estimator, outcome.estimator.model_
    known = dict(est.known_masses or {})
    said = [heading("Masses")]
    for j, mass in enumerate(model.masses, 1):
        note = "  (given)" if j in known else f"  (truth {truth.masses[j - 1]:g})" if truth is not None else ""
        said.append(f"  m{j} = {mass:.5g} kg{note}")
    said.append(heading("Restoring forces (N; v in m/s, s in m)"))
    for force, true in zip(model.restoring_forces.values(), truth.restoring_forces.values() if truth else [None] * 99):
        if force.laws:
            said.append(f"  {force}")
        if str(force.site) in outcome.shares:
            said.append(f"    carried by {_carriers(outcome.shares[str(force.site)])}")
        if true is not None:
            said.append(f"    truth: {true}")
    said.append(heading(f"Errors, percent NRMSE, {band_text(band)}"))
    said.append(indent(_balance(est.errors_)))
    if len(est.third_law_gap_):
        gaps = ", ".join(f"{site} {gap:.3g} %" for site, gap in est.third_law_gap_.items())
        said.append(f"  Newton's third law, the two estimates of one storey differ by: {gaps}")
    said += [f"  {line}" for line in _free(outcome, band)]
    modes = _modes(model)
    if modes is not None:
        said += [heading("Modes of the linear part (Hz, share of critical damping, shape)"), indent(table(modes))]
    notes = outcome.warnings + advice(outcome)
    if notes:
        said += [heading("Take care"), take_care(notes)]
    return "\n".join(said)


def take_care(notes: Sequence[str]) -> str:
    """Warnings, one a paragraph, in lines that a terminal shows whole."""
    lines = textwrap.TextWrapper(
        110, initial_indent="  - ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines.fill(note) for note in notes)


def _carriers(shares: pd.Series, least: float = 1.0) -> str:
    """The terms that carry a force, e.g. ``"s 74 %, s^3 31 %; the other 7 terms below 1 % each"``."""
    large = shares[shares >= least]
    said = ", ".join(f"{term} {share:.3g} %" for term, share in large.items())
    rest = len(shares) - len(large)
    return said + (f"; the other {rest} term{'s' if rest > 1 else ''} below {least:g} % each" if rest else "")


def _balance(errors: pd.DataFrame) -> str:
    lines = []
    for name, row in errors.iterrows():
        if name == "pooled":
            lines.append(f"balance error, pooled: {row['error']:.4g} %")
        else:
            what = "applied force" if row["of"] == "F" else "inertia m a"
            lines.append(
                f"balance error of {str(name).replace('dof', 'DOF')}: {row['error']:.4g} % of the {what} "
                f"({row['residual']:.4g} of {row['reference']:.4g} N rms)"
            )
    return "\n".join(lines)


def _free(outcome: Outcome, band: Any) -> list[str]:
    if outcome.frf is not None:
        errors = response_errors(outcome, band)
        shown = ", ".join(f"H{j} {e:.4g} %" for j, e in enumerate(errors, 1))
        return [f"response error (the model's own frequency response against the measured one): {shown}"]
    lines = []
    if outcome.free_run is not None:
        for name, row in outcome.free_run.iterrows():
            shown = ", ".join(f"{dof} {e:.4g} %" for dof, e in row.items())
            lines.append(f"free-run error of {name} (the model alone under the measured force): {shown}")
    if outcome.no_free_run:
        lines.append(f"no free run: {outcome.no_free_run}")
    return lines


def response_errors(outcome: Outcome, band: Any) -> list[float]:
    """Percent NRMSE of the model's frequency responses in the band, by DOF."""
    assert outcome.frf is not None
    frf, found = outcome.frf
    low, high = band if band is not None else (None, None)
    used = (frf.f >= (low or 0.0)) & (frf.f <= (np.inf if high is None else high))
    gap, whole = np.abs(found - frf.H)[used], np.abs(frf.H)[used]
    return [float(e) for e in 100 * np.sqrt((gap**2).mean(axis=0) / (whole**2).mean(axis=0))]


def _modes(model: Any) -> pd.DataFrame | None:
    if (model.masses <= 0).any() or (model.total_masses <= 0).any():
        return None
    modes = model.modes()
    return modes if (modes["damping"].abs() < 1).all() else None  # else a part does not swing


def advice(outcome: Outcome) -> list[str]:
    """Sentences on what makes the numbers doubtful."""
    est = outcome.estimator
    said: list[str] = []
    errors = est.errors_.drop(index="pooled")["error"]
    poor = [f"{str(k).replace('dof', 'DOF')} ({e:.3g} %)" for k, e in errors.items() if e > LARGE_ERROR]
    if poor and not outcome.warnings:
        if outcome.frf is not None:
            cause = (
                "Noise in the responses biases all masses and stiffnesses low together; trust their ratios and the "
                "frequencies more than their size."
            )
        else:
            cause = (
                "A law is missing, or the channels are noisy; either biases masses and stiffnesses, noise biases them "
                "low. Try another degree or law, or a band."
            )
        said.append(f"Much of the force is unexplained in the balance of {', '.join(poor)}. {cause}")
    negative = [f"m{j}" for j, m in enumerate(est.masses_, 1) if m < 0]
    if negative:
        said.append(f"{', '.join(negative)} came out negative: the data do not determine this balance.")
    if outcome.free_run is not None and est.model_.n_dof and np.nanmax(outcome.free_run.to_numpy()) > 50:
        said.append(
            "The free run leaves the measured motion. A model can be right and still drift (a stage without a "
            "spring, a yielding storey, a record that starts in motion); check the figure."
        )
    return said


def as_data(outcome: Outcome, band: Any, records: list[dict[str, Any]]) -> dict[str, Any]:
    """The same as plain data, for ``--json``."""
    est, model = outcome.estimator, outcome.estimator.model_
    modes = _modes(model)
    return {
        "records": records,
        "band_hz": None if band is None else list(band),
        "walk": str(est.walk_).splitlines(),
        "masses_kg": [float(m) for m in model.masses],
        "equations": model.equations(6),
        "balance_error_percent": _plain(est.errors_["error"]),
        "third_law_gap_percent": _plain(est.third_law_gap_),
        "free_run_error_percent": None
        if outcome.free_run is None
        else {str(k): _plain(row) for k, row in outcome.free_run.iterrows()},
        "response_error_percent": None if outcome.frf is None else response_errors(outcome, band),
        "no_free_run": outcome.no_free_run or None,
        "modes": None if modes is None else modes.to_dict(orient="records"),
        "warnings": outcome.warnings + advice(outcome),
        "model": model.to_dict(),
    }


def _plain(series: pd.Series) -> dict[str, float | None]:
    return {str(k): float(v) if np.isfinite(v) else None for k, v in series.items()}
