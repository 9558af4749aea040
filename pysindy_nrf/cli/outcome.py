"""An identification by the command line: features, fit and free run; the result in
words, as data and in files.
"""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .. import report
from ..diagnosis.verdict import FreeRuns, Verdict, shares_of, verdict_on
from ..discrepancy.residual import loops_of
from ..identification.noise_spectra import transfer
from ..records.files import write_table
from ..records.files.frequency_response import FrequencyResponse, in_band
from ..records.files.summary import summary
from ..records.input_arrays import from_arrays
from ..records.record import Record
from ..records.zero_phase_filter import filters_of
from ..report.content import band_text, listed
from ..report.figures.figure import dof_words
from ..report.figures.forces import loop_figures
from ..report.figures.matplotlib_renderer import available, save
from ..report.figures.motion import free_run_figure, response_figures
from .options import Session, heading, table, verdict_words, warned, working

RED = 4  # exit code


@dataclass
class Outcome:
    """A fitted model and how well it does."""

    estimator: Any
    verdict: Verdict
    free: FreeRuns = field(default_factory=lambda: FreeRuns(pd.DataFrame()))
    shares: dict[str, pd.Series] = field(default_factory=dict)
    frf: FrequencyResponse | None = None
    responses: tuple[
        np.ndarray, ...
    ] = ()  # frequencies in the band (Hz), measured and found responses there
    warnings: list[str] = field(default_factory=list)

    @property
    def response_error(self) -> list[float] | None:
        """Percent NRMSE of the model's frequency responses in the band, by DOF."""
        if self.frf is None:
            return None
        _, measured, found = self.responses
        ratio = (np.abs(found - measured) ** 2).mean(axis=0) / (
            np.abs(measured) ** 2
        ).mean(axis=0)
        return [float(e) for e in 100 * np.sqrt(ratio)]

    @property
    def modes(self) -> pd.DataFrame | None:
        """Modes of the linear part; None if a mass is not positive or a part does not
        swing.
        """
        model = self.estimator.model_
        if (model.masses <= 0).any() or (model.total_masses <= 0).any():
            return None
        modes = model.modes()
        return modes if (modes["damping"].abs() < 1).all() else None


def identify_records(records: Sequence[Record], estimator: Any, raw: bool) -> Outcome:
    """Identify a chain from records (``raw``: no fusion) and run the model free."""
    with warned() as messages, working("fitting, running free, checking"):
        data = estimator.fit(
            from_arrays(records, smooth=False) if raw else records
        ).fit_data("")
        shares = shares_of(estimator.model_, data)
        outcome = Outcome(estimator, estimator.verdict(), estimator.free_runs(), shares)
    outcome.warnings = [one for one in messages() if one not in outcome.verdict.reasons]
    return outcome


def identify_frf(frf: FrequencyResponse, estimator: Any) -> Outcome:
    """Identify a linear chain from its frequency responses."""
    with warned() as messages:
        estimator.fit(frf)
    mobility = transfer(estimator.model_.matrices(), frf.f)[:, :, frf.excited - 1]
    response, used = (
        2j * np.pi * frf.f[:, None] * mobility,
        in_band(frf.f, estimator.band),
    )
    responses = tuple(x[used] for x in (frf.f, frf.H, response))
    known = estimator.problem_.known_masses
    verdict = verdict_on(
        estimator.model_, {}, [], None, estimator.bounds()[0], known_masses=known
    )
    return Outcome(
        estimator, verdict, frf=frf, responses=responses, warnings=messages()
    )


def result(outcome: Outcome, truth: Any = None) -> str:
    """Masses, equations, errors and modes of an outcome; ``truth`` is the model behind
    a simulated record.
    """
    est, model = outcome.estimator, outcome.estimator.model_
    known = dict(est.known_masses or {})
    said = [heading("Verdict"), verdict_words(outcome.verdict), heading("Masses")]
    for j, mass in enumerate(model.masses, 1):
        note = (
            "  (given)"
            if j in known
            else f"  (truth {truth.masses[j - 1]:g})"
            if truth is not None
            else ""
        )
        said.append(f"  m{j} = {mass:.5g} kg{note}")
    said.append(heading("Restoring forces (N; v in m/s, s in m)"))
    for site, force in model.restoring_forces.items():
        if force.laws:
            said.append(f"  {force}")
        if str(site) in outcome.shares:
            said.append(f"    carried by {_carriers(outcome.shares[str(site)])}")
        if truth is not None:
            said.append(f"    truth: {truth.restoring_forces[site]}")
    said.append(heading(f"Errors, percent NRMSE, {band_text(est.band)}"))
    gaps = listed(f"{site} {gap:.3g} %" for site, gap in est.third_law_gap_.items())
    third = (
        [f"Newton's third law, the two estimates of one storey differ by: {gaps}"]
        if gaps
        else []
    )
    said += [f"  {line}" for line in (*_balance(est.errors_), *third, *_free(outcome))]
    modes = outcome.modes
    if modes is not None:
        said.append(
            heading("Modes of the linear part (Hz, share of critical damping, shape)")
        )
        said.append(textwrap.indent(table(modes), "  "))
    return "\n".join(said)


def _carriers(shares: pd.Series) -> str:
    """The terms that carry a force, e.g. ``"s 74 %, s^3 31 %; the other 7 terms below 1
    % each"``.
    """
    large = shares[shares >= 1.0]
    said = listed(f"{term} {share:.3g} %" for term, share in large.items())
    rest = len(shares) - len(large)
    return said + (
        f"; the other {rest} term{'s' if rest > 1 else ''} below 1 % each"
        if rest
        else ""
    )


def _balance(errors: pd.DataFrame) -> list[str]:
    """Balance errors, one a line."""
    of, out = {"F": "applied force", "m a": "inertia m a"}, []
    for name, row in errors.iterrows():
        size = f"{row['residual']:.4g} of {row['reference']:.4g} N rms"
        what, more = f"free-run error of {row['of']}, measured", ""
        if name == "pooled":
            what = "balance error, pooled"
        elif row["of"] in of:
            what, more = (
                f"balance error of {dof_words(name)}",
                f" of the {of[row['of']]} ({size})",
            )
        out.append(f"{what}: {row['error']:.4g} %{more}")
    return out


def _free(outcome: Outcome) -> list[str]:
    """Free-run errors, or those of the frequency responses."""
    if outcome.response_error is not None:
        shown = listed(
            f"H{j} {e:.4g} %" for j, e in enumerate(outcome.response_error, 1)
        )
        return [
            "response error (the model's own frequency response against the measured"
            f" one): {shown}"
        ]
    rows = (
        (name, listed(f"{dof} {e:.4g} %" for dof, e in row.items()))
        for name, row in outcome.free.table.iterrows()
    )
    lines = [
        f"free-run error of {name} (the model alone under the measured force): {shown}"
        for name, shown in rows
    ]
    return lines + (
        [f"no free run: {outcome.free.why_not}"] if outcome.free.why_not else []
    )


def as_data(outcome: Outcome, records: Sequence[Record]) -> dict[str, Any]:
    """The same as plain data, for ``--json``."""
    est, model, frf = outcome.estimator, outcome.estimator.model_, outcome.frf
    understood = [summary(record) for record in records]
    if frf is not None:
        understood = [
            {
                "name": frf.name,
                "n_dof": frf.n_dof,
                "n_lines": len(frf.f),
                "excited": frf.excited,
            }
        ]
    return {
        "verdict": asdict(outcome.verdict),
        "records": understood,
        "band_hz": est.band,
        "solve_order": str(est.solve_order_).splitlines(),
        "masses_kg": [float(m) for m in model.masses],
        "equations": model.equations(6),
        "balance_error_percent": est.errors_["error"],
        "third_law_gap_percent": {str(k): gap for k, gap in est.third_law_gap_.items()},
        "free_run_error_percent": outcome.free.table.to_dict("index") or None,
        "response_error_percent": outcome.response_error,
        "no_free_run": outcome.free.why_not or None,
        "modes": (
            None if outcome.modes is None else outcome.modes.to_dict(orient="records")
        ),
        "warnings": [*outcome.verdict.reasons, *outcome.warnings],
        "model": model.to_dict(),
    }


def write_all(
    outcome: Outcome, folder: Path, figures: bool, records: Sequence[Record]
) -> list[Path]:
    """Write model, tables, figures (with matplotlib), the page of the records, and what
    was asked for beside them.
    """
    est, model = outcome.estimator, outcome.estimator.model_
    written = [folder / "model.json"]
    model.to_json(written[0])
    masses = pd.DataFrame({"dof": range(1, model.n_dof + 1), "mass_kg": model.masses})
    errors = est.errors_.reset_index(names="balance").rename(
        columns={
            "error": "error_percent",
            "residual": "residual_N_rms",
            "reference": "reference_N_rms",
        }
    )
    frames = {
        "masses": masses,
        "coefficients": coefficients(model),
        "balance_errors": errors,
    }
    if (model.masses > 0).all() and (model.total_masses > 0).all():
        frames["modes"] = (
            model.modes().reset_index().rename(columns={"frequency": "frequency_Hz"})
        )
    if len(outcome.free.table):
        frames["free_run_errors"] = outcome.free.table.add_suffix(
            "_percent"
        ).reset_index(names="record")
    written += [
        write_table(frame, folder / f"{name}.csv") for name, frame in frames.items()
    ]
    if figures:
        written += _figures(outcome, folder)
    if outcome.frf is None:
        said = {"notes": tuple(outcome.warnings), "band": est.band}
        written += page(
            lambda path: report.write_html(path, est, records, **said),
            folder / "report.html",
        )
    return written


def page(write: Callable[[Path], Any], path: Path) -> list[Path]:
    """Write a page if the packages of the extra ``report`` are installed."""
    if not report.available():
        return []
    write(path)
    return [path]


def coefficients(model: Any) -> pd.DataFrame:
    """All coefficients of a model: ``site``, ``term``, ``value``, ``unit``."""
    rows = [
        (str(site), term, value, unit)
        for site, force in model.restoring_forces.items()
        for (term, value), unit in zip(force.coefficients.items(), force.units)
    ]
    return pd.DataFrame(rows, columns=["site", "term", "value", "unit"])


def _figures(outcome: Outcome, folder: Path) -> list[Path]:
    """Draw the restoring forces and the free run, or the frequency responses."""
    band = outcome.estimator.band
    if outcome.frf is not None:
        title = f"Accelerance, force on DOF {outcome.frf.excited}, {band_text(band)}"
        return save(
            folder / "frequency_response.png",
            response_figures(*outcome.responses),
            title=title,
        )
    model, data = outcome.estimator.model_, outcome.estimator.fit_data("")
    loops = loop_figures(model, loops_of(model, data, filters_of(band, data)))
    written = save(folder / "restoring_forces.png", loops, columns=2)
    return written + save(folder / "free_run.png", free_run_figure(outcome.free))


def finish(
    session: Session,
    outcome: Outcome,
    figures: bool,
    records: Sequence[Record] = (),
    truth: Any = None,
) -> int:
    """Say what was found in the records, if it is not from frequency responses, and
    write it. The exit code.
    """
    session.say(result(outcome, truth))
    session.warnings += outcome.warnings
    outcome.estimator.model_.info.update(session.provenance())
    with session.aside() as folder:
        written = write_all(outcome, folder, figures, records)
    session.finish(as_data(outcome, records), written)
    if figures and not available():
        session.say(
            "No figures: matplotlib is not installed; pip install 'pysindy-nrf[plot]'"
            " brings it."
        )
    if outcome.frf is None and not any(p.suffix == ".html" for p in written):
        session.say("No page: pip install 'pysindy-nrf[report]' brings what it needs.")
    return exit_code(outcome.verdict)


def exit_code(verdict: Verdict) -> int:
    """Exit code of a verdict: 4 if it is red."""
    return RED if verdict.state == "red" else 0
