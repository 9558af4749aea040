"""What limits the estimate of a fitted model, and what would help."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..exceptions import BiasWarning, NRFError
from .bias import NoiseBias, sentences_of, wrong_zeros
from .effects import capitalised
from .facts import Facts
from .force_delays import Fitted, force_delay
from .rules import creates_energy, open_alternatives, residuals_above_noise

__all__ = ["diagnose"]

# Peak drift of a storey, as a share of the largest, below which it is hardly excited.
LEAST_DRIFT = 0.05
# Condition number of scaled terms from which on they are hard to tell apart.
ILL_CONDITIONED = 1e4
# Half-width of a 95 % interval, as a share, from which on a parameter is uncertain.
WIDE_INTERVAL = 0.05
# Percent of all balances unexplained, above which the estimate deserves a word.
LARGE_ERROR = 15.0
# Expected relative bias of a mass from which on it is named.
NAMED_BIAS = 0.01


class Result(Protocol):
    """What a diagnosis reads of the result of a fit."""

    @property
    def noise_biases(self) -> list[NoiseBias]:
        """What noise in the motion does to the estimate."""

    @property
    def facts(self) -> Facts:
        """What is known of the model and of its data."""


class FittedModel(Fitted, Protocol):
    """What a diagnosis reads of a fitted :class:`~pysindy_nrf.NRFRegressor`."""

    model_: ChainModel
    errors_: pd.DataFrame
    missing_terms_: pd.DataFrame
    jump_bias_: pd.DataFrame
    condition_: pd.Series
    data_warnings_: dict[str, list[str]]

    @property
    def result_(self) -> Result:
        """The result of the fit."""

    def confidence_intervals(
        self, level: float = 0.95, *, of: str = "parameters"
    ) -> pd.DataFrame:
        """Intervals of parameters or modes."""


@dataclass(frozen=True)
class Finding:
    """One limit of an estimate.

    Parameters
    ----------
    gravity : float
        The larger, the earlier it is named. A faulty channel causes many other
        findings, so it stands first.
    limit, where, message : str
    size : float
    """

    gravity: float
    limit: str
    where: str
    size: float
    message: str


@dataclass(frozen=True)
class Diagnosis:
    """The limits of an estimate, the gravest first.

    Parameters
    ----------
    table : DataFrame
        ``limit``, ``where``, ``size`` and ``message`` of each finding.
    """

    table: pd.DataFrame

    def __str__(self) -> str:
        if self.table.empty:
            return "Nothing limits the estimate noticeably."
        return "\n".join(self.table["message"])


def diagnose(model: FittedModel) -> Diagnosis:
    """Diagnose what limits the estimate of a fitted regressor.

    Parameters
    ----------
    model : fitted NRFRegressor

    Returns
    -------
    Diagnosis

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis.limits import diagnose
    >>> record = datasets.load_demo()  # its storey 1 is cubic
    >>> with warnings.catch_warnings(action="ignore"):
    ...     linear = NRFRegressor(degree=1).fit(record)
    >>> "missing law" in diagnose(linear).table["limit"].tolist()
    True
    """
    findings: list[Finding] = []
    for check in _CHECKS:
        findings += check(model)
    findings.sort(key=lambda finding: -finding.gravity)

    columns = ["limit", "where", "size", "message"]
    return Diagnosis(pd.DataFrame(findings, columns=["gravity", *columns])[columns])


def _warnings_of_fit(model: FittedModel) -> list[Finding]:
    """Faulty channels, contradicting balances, implausible masses."""
    # noise in the motion, if it is found, explains a doubtful mass: it stands first
    gravity = {"channels": 7.0, "records": 6.5, "forces": 6.0, "masses": 3.9}
    findings = []
    for key, messages in model.data_warnings_.items():
        limit = "channel" if key == "channels" else "doubt"
        for message in messages:
            findings.append(Finding(gravity[key], limit, key, np.nan, message))
    return findings


def _missing_laws(model: FittedModel) -> list[Finding]:
    """Balances with terms that the laws lack; a wrong zero imitates such terms."""
    zeros = wrong_zeros(model.missing_terms_)
    if zeros:
        size = float(model.missing_terms_["lasting"].max())
        return [Finding(6.0, "wrong zero", "sensors", size, text) for text in zeros]

    findings = []
    biased = model.missing_terms_["biased"].astype(bool)
    for name, row in model.missing_terms_[biased].iterrows():
        message = (
            f"{capitalised(name)}: {row['residual']:.2g} % is unexplained, and terms"
            f" that the laws lack explain {row['gain']:.0f} % of that. A law is"
            " missing, or the motion is noisy: fuse the channels, then add the law"
            " (laws=) or search for it (close_loop)."
        )
        size = float(row["missing"])
        gravity = 3.0 + size / 100
        findings.append(Finding(gravity, "missing law", name, size, message))
    return findings


def _jumps(model: FittedModel) -> list[Finding]:
    """Forces that jump, which a filter moves to other terms."""
    wrong = model.jump_bias_[model.jump_bias_["wrong"].astype(bool)]
    findings = []
    for name, text in zip(wrong.index, sentences_of(wrong)):
        lost = float(wrong.loc[name, "lost"])
        findings.append(Finding(2.7, "jump", str(name), lost, capitalised(text)))
    return findings


def _excitation(model: FittedModel) -> list[Finding]:
    """Storeys that hardly move."""
    peak_drifts = {}
    for site, region in model.model_.visited.items():
        if site.is_storey:
            peak_drifts[site] = max(abs(region.low[1]), abs(region.high[1]))
    largest = max(peak_drifts.values(), default=0.0)

    findings = []
    unit = model.model_.units.length
    for site, drift in peak_drifts.items():
        if drift < LEAST_DRIFT * largest:
            share = drift / largest
            message = (
                f"{site} moves {drift:.2g} {unit} at most, {100 * share:.1f} % of the"
                f" largest drift: its law is poorly determined. Hit floor {site.p}, or"
                " excite a mode that bends it."
            )
            gravity = 2.0 + LEAST_DRIFT - share
            findings.append(Finding(gravity, "excitation", str(site), drift, message))
    return findings


def _conditioning(model: FittedModel) -> list[Finding]:
    """Balances whose terms are nearly collinear."""
    findings = []
    for name, number in model.condition_.items():
        if number > ILL_CONDITIONED:
            message = (
                f"{capitalised(name)}: condition number {number:.1e}; some of its terms"
                " are nearly collinear. Excite more frequencies and amplitudes, lower"
                " the degree, or give what is known (known_masses, constraints)."
            )
            findings.append(Finding(1.5, "conditioning", name, float(number), message))
    return findings


def _uncertainty(model: FittedModel) -> list[Finding]:
    """Masses and stiffnesses with a wide interval, or why there is no interval."""
    try:
        with warnings.catch_warnings(action="error", category=BiasWarning):
            table = model.confidence_intervals()
    except (NRFError, BiasWarning) as error:
        message = f"No interval can be given: {error}"
        return [Finding(1.0, "uncertainty", "data", np.nan, message)]

    findings = []
    for row in table[table["estimate"] != 0].itertuples():
        half_width = (row.upper - row.lower) / 2 / abs(row.estimate)
        is_mass = row.parameter.startswith("m")
        is_stiffness = row.parameter.endswith(": s")
        if half_width > WIDE_INTERVAL and (is_mass or is_stiffness):
            message = (
                f"{row.parameter} is known to +-{100 * half_width:.0f} % only (95 %)."
                " Measure longer or hit harder nearer to it."
            )
            gravity = 1.0 + min(half_width, 1.0) / 2
            finding = Finding(
                gravity, "uncertainty", row.parameter, float(half_width), message
            )
            findings.append(finding)
    return findings


def _energy(model: FittedModel) -> list[Finding]:
    """Modes whose damping is negative beyond its error."""
    try:
        with warnings.catch_warnings(action="ignore", category=BiasWarning):
            table = model.confidence_intervals(of="modes").set_index("parameter")
    except (NRFError, np.linalg.LinAlgError):
        return []

    findings = []
    for name, row in table.iterrows():
        if name.startswith("damping") and row["upper"] < 0:
            damping = float(row["estimate"])
            message = creates_energy(name.split()[-1], damping)
            findings.append(Finding(3.8, "energy", name, damping, message))
    return findings


def _estimation(model: FittedModel) -> list[Finding]:
    """Instrumental variables that were wanted and could not be used."""
    facts = model.model_.info.get("estimation", {})
    notes = facts.get("notes", [])
    wanted = bool(notes) or facts.get("asked") == "iv"
    if not wanted or facts.get("found") != "ls":
        return []

    why = " ".join(notes or ["see the warning of fit"]).rstrip(".")
    message = (
        f"Instrumental variables could not be used ({why}): noise in the motion biases"
        " masses and stiffnesses low."
    )
    return [Finding(2.5, "estimation", "all", np.nan, message)]


def _delays(model: FittedModel) -> list[Finding]:
    """Forces that are late against the motion."""
    try:
        table = force_delay(model)
    except NRFError:
        return []
    findings = []
    for name, row in table[~table["aligned"].astype(bool)].iterrows():
        samples = float(row["samples"])
        findings.append(Finding(2.6, "delay", name, samples, row["message"]))
    return findings


def _noise(model: FittedModel) -> list[Finding]:
    """Masses that noise in the motion biases in least squares."""
    findings = []
    for bias in model.result_.noise_biases:
        if bias.mass >= NAMED_BIAS:
            message = (
                f"m{bias.dof} is expected to come out {100 * bias.mass:.0f} % low or"
                " more, and with it all that is solved from it: noise in the motion,"
                f" most in {bias.channel} ({100 * bias.share:.1f} % of its rms). Give"
                " the records so that the channels are fused, with estimation='iv'."
            )
            gravity = 4.0 + bias.mass
            finding = Finding(gravity, "noise", f"m{bias.dof}", bias.mass, message)
            findings.append(finding)
    return findings


def _other_explanations(model: FittedModel) -> list[Finding]:
    """Structures and channels that the data allow, and forces that are missing."""
    facts = model.result_.facts
    findings = []
    # noise that biases the estimate makes them seem open, and stands first
    for reason in open_alternatives(facts):
        message = reason.message
        finding = Finding(3.95, reason.kind, reason.place, reason.size, message)
        findings.append(finding)
    for reason in residuals_above_noise(facts):
        finding = Finding(3.85, "residual", reason.place, reason.size, reason.message)
        findings.append(finding)
    return findings


def _unexplained(model: FittedModel) -> list[Finding]:
    """A large share of all balances that nothing explains."""
    error = float(model.errors_.loc["pooled", "error"])
    if not error > LARGE_ERROR:
        return []
    message = (
        f"{error:.0f} % of the balances is unexplained in all. Is it noise"
        " (estimation='iv'), or is a law missing?"
    )
    return [Finding(0.9, "unexplained", "all", error, message)]


_CHECKS: tuple[Callable[[FittedModel], list[Finding]], ...] = (
    _warnings_of_fit,
    _missing_laws,
    _jumps,
    _excitation,
    _conditioning,
    _uncertainty,
    _energy,
    _estimation,
    _delays,
    _noise,
    _other_explanations,
    _unexplained,
)
