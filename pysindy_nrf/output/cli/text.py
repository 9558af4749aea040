"""Words of the commands, and the same as plain data."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..displays._figure import dof_words
from ..report.story import band_text, listed, not_positive
from .work import Outcome

# Above this share of a balance unexplained, the estimates deserve a warning.
LARGE_ERROR = 15.0


def heading(text: str) -> str:
    """A heading with a blank line above."""
    return f"\n{text}\n{'-' * len(text)}"


def indent(text: str) -> str:
    """Text moved in by two blanks."""
    return textwrap.indent(text, "  ")


def table(frame: pd.DataFrame, digits: int = 4) -> str:
    """A table of numbers."""
    return frame.to_string(float_format=lambda x: "-" if np.isnan(x) else f"{x:.{digits}g}")


def take_care(notes: Sequence[str]) -> str:
    """Warnings, one a paragraph, in lines that a terminal shows whole."""
    lines = textwrap.TextWrapper(
        110, initial_indent="  - ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines.fill(note) for note in notes)


def result(outcome: Outcome, band: Any, truth: Any = None) -> str:
    """Masses, equations, errors and modes of an outcome; ``truth`` is the model behind a simulated record."""
    est, model = outcome.estimator, outcome.estimator.model_
    known = dict(est.known_masses or {})
    said = [heading("Masses")]
    for j, mass in enumerate(model.masses, 1):
        note = "  (given)" if j in known else f"  (truth {truth.masses[j - 1]:g})" if truth is not None else ""
        said.append(f"  m{j} = {mass:.5g} kg{note}")
    said.append(heading("Restoring forces (N; v in m/s, s in m)"))
    for site, force in model.restoring_forces.items():
        if force.laws:
            said.append(f"  {force}")
        if str(site) in outcome.shares:
            said.append(f"    carried by {_carriers(outcome.shares[str(site)])}")
        if truth is not None:
            said.append(f"    truth: {truth.restoring_forces[site]}")
    said.append(heading(f"Errors, percent NRMSE, {band_text(band)}"))
    said += [f"  {line}" for line in (*_balance(est.errors_), *_gaps(est.third_law_gap_), *_free(outcome))]
    modes = outcome.modes
    if modes is not None:
        said += [heading("Modes of the linear part (Hz, share of critical damping, shape)"), indent(table(modes))]
    notes = outcome.warnings + advice(outcome)
    if notes:
        said += [heading("Take care"), take_care(notes)]
    return "\n".join(said)


def _carriers(shares: pd.Series, least: float = 1.0) -> str:
    """The terms that carry a force, e.g. ``"s 74 %, s^3 31 %; the other 7 terms below 1 % each"``."""
    large = shares[shares >= least]
    said = listed(f"{term} {share:.3g} %" for term, share in large.items())
    rest = len(shares) - len(large)
    return said + (f"; the other {rest} term{'s' if rest > 1 else ''} below {least:g} % each" if rest else "")


def _balance(errors: pd.DataFrame) -> list[str]:
    """Balance errors, one a line."""
    return [
        f"balance error, pooled: {row['error']:.4g} %"
        if name == "pooled"
        else f"balance error of {dof_words(name)}: {row['error']:.4g} % of the "
        f"{'applied force' if row['of'] == 'F' else 'inertia m a'} "
        f"({row['residual']:.4g} of {row['reference']:.4g} N rms)"
        for name, row in errors.iterrows()
    ]


def _gaps(gaps: pd.Series) -> list[str]:
    """How far two estimates of a storey differ."""
    said = listed(f"{site} {gap:.3g} %" for site, gap in gaps.items())
    return [f"Newton's third law, the two estimates of one storey differ by: {said}"] if said else []


def _free(outcome: Outcome) -> list[str]:
    """Free-run errors, or those of the frequency responses."""
    if outcome.response_error is not None:
        shown = listed(f"H{j} {e:.4g} %" for j, e in enumerate(outcome.response_error, 1))
        return [f"response error (the model's own frequency response against the measured one): {shown}"]
    lines = []
    for name, row in () if outcome.free_run is None else outcome.free_run.iterrows():
        shown = listed(f"{dof} {e:.4g} %" for dof, e in row.items())
        lines.append(f"free-run error of {name} (the model alone under the measured force): {shown}")
    return lines + ([f"no free run: {outcome.no_free_run}"] if outcome.no_free_run else [])


def advice(outcome: Outcome) -> list[str]:
    """Sentences on what makes the numbers doubtful."""
    said: list[str] = []
    errors = outcome.estimator.errors_.drop(index="pooled")["error"]
    poor = [f"{dof_words(k)} ({e:.3g} %)" for k, e in errors.items() if e > LARGE_ERROR]
    if poor and not outcome.warnings:
        cause = (
            "A law is missing, or the channels are noisy; either biases masses and stiffnesses, noise biases them "
            "low. Try another degree or law, or a band."
            if outcome.frf is None
            else "Noise in the responses biases all masses and stiffnesses low together; trust their ratios and the "
            "frequencies more than their size."
        )
        said.append(f"Much of the force is unexplained in the balance of {listed(poor)}. {cause}")
    said += not_positive(outcome.estimator.masses_, "negative")
    if outcome.free_run is not None and np.nanmax(outcome.free_run.to_numpy()) > 50:
        said.append(
            "The free run leaves the measured motion. A model can be right and still drift (a stage without a "
            "spring, a yielding storey, a record that starts in motion); check the figure."
        )
    return said


def as_data(outcome: Outcome, band: Any, records: list[dict[str, Any]]) -> dict[str, Any]:
    """The same as plain data, for ``--json``; ``records`` is what was understood."""
    est, model = outcome.estimator, outcome.estimator.model_
    free = None if outcome.free_run is None else {str(k): row.to_dict() for k, row in outcome.free_run.iterrows()}
    return {
        "records": records,
        "band_hz": None if band is None else list(band),
        "walk": str(est.walk_).splitlines(),
        "masses_kg": [float(m) for m in model.masses],
        "equations": model.equations(6),
        "balance_error_percent": est.errors_["error"],
        "third_law_gap_percent": {str(k): gap for k, gap in est.third_law_gap_.items()},
        "free_run_error_percent": free,
        "response_error_percent": outcome.response_error,
        "no_free_run": outcome.no_free_run or None,
        "modes": None if outcome.modes is None else outcome.modes.to_dict(orient="records"),
        "warnings": outcome.warnings + advice(outcome),
        "model": model.to_dict(),
    }
