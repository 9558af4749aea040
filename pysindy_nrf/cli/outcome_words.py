"""The outcome of an identification in words, and as plain data."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import pandas as pd

from ..chain.model import ChainModel
from ..common.unit_system import UnitSystem
from ..drawing.figure import dof_words
from ..records.files.summary import summary
from ..records.record import Record
from ..report.words import band_text, listed
from .outcome import Outcome
from .printing import heading, table_text, verdict_data, verdict_text

# Percent of a force from which on a term is said to carry a part of it.
CARRIES = 1.0
_REFERENCES = {"F": "applied force", "m a": "inertia m a"}


def outcome_text(outcome: Outcome, truth: ChainModel | None = None) -> str:
    """Verdict, masses, equations, errors and modes.

    Parameters
    ----------
    outcome : Outcome
    truth : ChainModel, optional
        The model behind a simulated record.
    """
    estimator = outcome.estimator
    lines = [heading("Verdict"), verdict_text(outcome.verdict)]
    lines += [heading("Masses"), *_masses(outcome, truth)]
    units = estimator.model_.units
    motion = f"v in {units.of('m/s')}, s in {units.length}"
    lines += [heading(f"Restoring forces ({units.force}; {motion})")]
    lines += _forces(outcome, truth)
    lines += [heading(f"Errors, percent NRMSE, {band_text(estimator.band)}")]
    errors = _balance_errors(estimator.errors_, units)
    errors += _third_law(estimator.third_law_gap_)
    errors += _free_run_errors(outcome)
    if estimator.result_.smaller_order is not None:
        errors.append(str(estimator.result_.smaller_order))
    lines += [f"  {line}" for line in errors]
    if outcome.modes is not None:
        title = "Modes of the linear part (Hz, share of critical damping, shape)"
        shown = textwrap.indent(table_text(outcome.modes), "  ")
        lines += [heading(title), shown]
    return "\n".join(lines)


def _masses(outcome: Outcome, truth: ChainModel | None) -> list[str]:
    known = dict(outcome.estimator.known_masses or {})
    lines = []
    for j, mass in enumerate(outcome.estimator.model_.masses, 1):
        note = ""
        if j in known:
            note = "  (given)"
        elif truth is not None:
            note = f"  (truth {truth.masses[j - 1]:g})"
        unit = outcome.estimator.model_.units.mass
        lines.append(f"  m{j} = {mass:.5g} {unit}{note}")
    return lines


def _forces(outcome: Outcome, truth: ChainModel | None) -> list[str]:
    lines = []
    for site, force in outcome.estimator.model_.restoring_forces.items():
        if force.laws:
            lines.append(f"  {force}")
        if str(site) in outcome.shares:
            lines.append(f"    carried by {_carriers(outcome.shares[str(site)])}")
        if truth is not None:
            lines.append(f"    truth: {truth.restoring_forces[site]}")
    return lines


def _carriers(shares: pd.Series) -> str:
    """The terms that carry a force, and how many do not."""
    large = shares[shares >= CARRIES]
    text = listed(f"{term} {share:.3g} %" for term, share in large.items())
    n_small = len(shares) - len(large)
    if n_small:
        terms = "term" if n_small == 1 else "terms"
        text += f"; the other {n_small} {terms} below {CARRIES:g} % each"
    return text


def _balance_errors(errors: pd.DataFrame, units: UnitSystem) -> list[str]:
    """Balance errors, one a line."""
    lines = []
    for name, row in errors.iterrows():
        percent = f"{row['error']:.4g} %"
        if name == "pooled":
            lines.append(f"balance error, pooled: {percent}")
        elif row["of"] in _REFERENCES:
            reference = _REFERENCES[row["of"]]
            sizes = f"{row['residual']:.4g} of {row['reference']:.4g}"
            size = f"{sizes} {units.force} rms"
            of = f"of the {reference} ({size})"
            lines.append(f"balance error of {dof_words(name)}: {percent} {of}")
        else:
            lines.append(f"free-run error of {row['of']}, measured: {percent}")
    return lines


def _third_law(gaps: pd.Series) -> list[str]:
    """How far the two estimates of a storey differ."""
    if not len(gaps):
        return []
    shown = listed(f"{site} {gap:.3g} %" for site, gap in gaps.items())
    return [f"Newton's third law, the two estimates of one storey differ by: {shown}"]


def _free_run_errors(outcome: Outcome) -> list[str]:
    """Errors of free runs, or of frequency responses."""
    if outcome.responses is not None:
        errors = enumerate(outcome.responses.errors, 1)
        shown = listed(f"H{j} {error:.4g} %" for j, error in errors)
        return [
            "response error (the model's own frequency response against the measured"
            f" one): {shown}"
        ]
    lines = []
    for name, row in outcome.free.table.iterrows():
        shown = listed(f"{dof} {error:.4g} %" for dof, error in row.items())
        alone = "the model alone under the measured force"
        lines.append(f"free-run error of {name} ({alone}): {shown}")
    if outcome.free.why_not:
        lines.append(f"no free run: {outcome.free.why_not}")
    return lines


def outcome_data(outcome: Outcome, records: Sequence[Record]) -> dict[str, object]:
    """The same as plain data, for ``--json``."""
    estimator, responses = outcome.estimator, outcome.responses
    model = estimator.model_
    understood: list[dict[str, object]] = [summary(record) for record in records]
    response_errors = modes = None
    if responses is not None:
        frf = responses.measured
        facts = {"name": frf.name, "n_dof": frf.n_dof, "n_lines": len(frf.f)}
        understood = [{**facts, "excited": frf.excited}]
        response_errors = responses.errors
    if outcome.modes is not None:
        modes = outcome.modes.to_dict(orient="records")
    gaps = {str(site): gap for site, gap in estimator.third_law_gap_.items()}
    return {
        "verdict": verdict_data(outcome.verdict),
        "records": understood,
        "band_hz": estimator.band,
        "solve_order": str(estimator.solve_order_).splitlines(),
        "masses_kg": model.masses,
        "equations": model.equations(6),
        "balance_error_percent": estimator.errors_["error"],
        "third_law_gap_percent": gaps,
        "free_run_error_percent": outcome.free.table.to_dict("index") or None,
        "response_error_percent": response_errors,
        "no_free_run": outcome.free.why_not or None,
        "modes": modes,
        "warnings": [*outcome.verdict.reasons, *outcome.warnings],
        "model": model.to_dict(),
    }
