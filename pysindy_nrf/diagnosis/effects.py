"""What a model holds besides linear storeys, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.restoring_force import RestoringForce
from ..laws.base import ForceLaw
from ..records.dataset import Dataset

# Share of the force of a site from which on a nonlinear term is named.
NAMED_SHARE = 0.02

Interval = tuple[float, float]
Bounds = Mapping[str, Interval]


class Effect(Protocol):
    """One effect that a search found: see :class:`pysindy_nrf.discrepancy.Step`."""

    @property
    def law(self) -> str:
        """Name of the law, such as ``"coulomb_friction"``."""

    @property
    def family(self) -> str:
        """Family of the law."""

    @property
    def site(self) -> str:
        """Where it acts."""

    @property
    def shape(self) -> Mapping[str, float | None]:
        """Shape parameters by name, SI units."""

    @property
    def parameters(self) -> Mapping[str, float | None]:
        """Coefficients and shape parameters, SI units."""

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters."""

    @property
    def intervals(self) -> Mapping[str, Interval]:
        """95 % intervals of the parameters."""

    @property
    def confirmed(self) -> bool:
        """Whether held-out data confirm it; the model holds confirmed effects only."""

    @property
    def sure(self) -> bool:
        """Whether its name is sure."""

    @property
    def carries(self) -> bool:
        """Whether the model has the law of this name, and not the general law."""

    @property
    def alternatives(self) -> list[str]:
        """Families that the data cannot distinguish from its own."""

    @property
    def laws_beside(self) -> list[str]:
        """Laws that may stand for one law together with it."""

    @property
    def sensors(self) -> list[str]:
        """Other sensors that the data could accuse as well."""

    @property
    def remainder(self) -> float:
        """Share of the effect that stays unexplained."""

    @property
    def reduction(self) -> float:
        """Fall of the cross-validated residual, dB."""

    @property
    def reduction_error(self) -> float:
        """Standard error of the reduction over folds, dB."""

    @property
    def error_before(self) -> float:
        """Held-out balance error without it, percent NRMSE."""

    @property
    def error_after(self) -> float:
        """Held-out balance error with it, percent NRMSE."""

    @property
    def free_run_before(self) -> float:
        """Held-out free-run error without it, percent NRMSE."""

    @property
    def free_run_after(self) -> float:
        """Held-out free-run error with it, percent NRMSE."""


def plain_name(name: object) -> str:
    """A name without underscores."""
    return str(name).replace("_", " ")


def capitalised(text: str) -> str:
    """A text with a capital at its start."""
    return text[:1].upper() + text[1:]


def as_sentence(text: str) -> str:
    """Words with a capital and a full stop."""
    text = text.strip().rstrip(".")
    return f"{capitalised(text)}." if text else ""


def law_at_site(effect: Effect) -> str:
    """An effect by its law and its site."""
    return f"{plain_name(effect.law)} at {effect.site}"


def not_told_apart(effect: Effect) -> list[str]:
    """What else the data allow instead of an effect."""
    texts = []
    if effect.alternatives:
        others = ", ".join(map(plain_name, effect.alternatives))
        family = plain_name(effect.family)
        text = f"At {effect.site} the data cannot distinguish {family} from {others}."
        texts.append(text)
    if effect.laws_beside:
        laws = sorted(map(plain_name, (effect.law, *effect.laws_beside)))
        together = f"{', '.join(laws[:-1])} and {laws[-1]}"
        texts.append(
            f"At {effect.site} {together} may together stand for one law that is not in"
            " the catalogue."
        )
    if effect.sensors:
        sensors = " or ".join(effect.sensors)
        texts.append(
            f"The same fault, reversed, at {sensors} explains as much as"
            f" {law_at_site(effect)}."
        )
    return texts


def described(effect: Effect) -> str:
    """An effect with its size and interval."""
    units = {}
    for name, unit in effect.units.items():
        if name not in effect.shape:
            units[name] = unit
    return effect_words(
        effect.law, effect.site, effect.parameters, effect.intervals, units
    )


def effect_words(
    law: str,
    site: str,
    values: Mapping[str, float | None],
    intervals: Mapping[str, Interval],
    units: Mapping[str, str],
) -> str:
    """An effect with its leading parameter and the interval of that.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.effects import effect_words
    >>> force, interval = {"Fc": 173.0}, {"Fc": (169.0, 189.0)}
    >>> effect_words(
    ...     "coulomb_friction", "storey 2", force, interval, {"Fc": "N"}
    ... )
    'dry friction of 173 N (169 to 189 N) in storey 2'
    """
    name = plain_name(law).removeprefix("ground ")
    if law == "coulomb_friction":
        name = "dry friction"
    if law == "harmonic_force":
        values, intervals = _amplitude(values, intervals)
    place = _place(site)

    for key, value in values.items():
        if value is None or key not in units:
            continue
        unit = unit_in_words(units[key], values)
        unit = f" {unit}" if unit else ""
        low, high = intervals.get(key, (np.nan, np.nan))
        text = f"{name} of {digits(low, high, float(value))}{unit}"
        if np.isfinite(high - low):
            text += f" ({digits(low, high)}{unit})"
        return f"{text} {place}"
    return f"{name} {place}"


def unit_in_words(unit: str, values: Mapping[str, float | None]) -> str:
    """A unit with raised numbers, and with the exponent n by its value.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.effects import unit_in_words
    >>> unit_in_words("N s^n/m^n", {"n": 0.45}), unit_in_words("N/m^3", {})
    ('N (s/m)^0.45', 'N/m³')
    """
    exponent = values.get("n")
    if exponent is not None:
        unit = unit.replace("s^n/m^n", f"(s/m)^{exponent:.2g}")
    return unit.replace("^2", "²").replace("^3", "³")


def _amplitude(
    values: Mapping[str, float | None], intervals: Mapping[str, Interval]
) -> tuple[dict[str, float | None], dict[str, Interval]]:
    """The amplitude of a harmonic force and its interval, as parameter A.

    A and B are the coefficients of its cosine and sine; their errors are independent.
    """
    parts = np.array([values.get("A") or 0.0, values.get("B") or 0.0])
    amplitude = float(np.hypot(*parts))
    unknown = (np.nan, np.nan)
    ends = np.array([intervals.get(name, unknown) for name in ("A", "B")])
    half_widths = np.diff(ends, axis=1)[:, 0] / 2
    half_width = float(np.hypot(*(parts * half_widths)) / max(amplitude, 1e-300))
    return {"A": amplitude}, {"A": (amplitude - half_width, amplitude + half_width)}


def _place(site: str) -> str:
    """Where a site is, in words."""
    kind, _, number = site.partition(" ")
    if kind == "ground":
        return f"between floor {number} and the ground"
    if kind == "dof":
        return f"on floor {number}"
    if kind == "sensors":
        return f"in all sensors of floor {number}"
    return f"in {site}"


def digits(low: float, high: float, *values: float) -> str:
    """The two ends of an interval with the digits that distinguish them.

    Or other values with the same digits.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.effects import digits
    >>> digits(1234.5, 1235.5), digits(1234.5, 1235.5, 1235.1)
    ('1234.5 to 1235.5', '1235.1')
    """
    needed = 3
    if high > low:
        largest = max(abs(low), abs(high))
        half_width = (high - low) / 2
        n_digits = np.floor(np.log10(largest)) - np.floor(np.log10(half_width)) + 1
        needed = int(np.clip(n_digits, 3, 7))
    return " to ".join(f"{value:.{needed}g}" for value in values or (low, high))


def shares_of(model: ChainModel, data: Dataset) -> dict[str, pd.Series]:
    """Rms of each term's force, percent of the rms of the force of its site.

    Returns
    -------
    dict of str to Series
        By site; the largest term first. Sites without a force are left out.
    """
    shares = {}
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue

        squares, total = np.zeros(len(force.coefficients)), 0.0
        for segment in data.segments:
            motion = segment.motion(site, segment.valid)
            terms = [law.features(motion) * law.coefficients for law in force.laws]
            columns = np.hstack(terms)
            squares += (columns**2).sum(axis=0)
            total += (columns.sum(axis=1) ** 2).sum()

        if total:
            percent = 100 * np.sqrt(squares / total)
            series = pd.Series(percent, index=force.coefficients.index)
            shares[str(site)] = series.sort_values(ascending=False)
    return shares


def nonlinear_parts(
    model: ChainModel,
    shares: Mapping[str, pd.Series],
    bounds: Bounds | None = None,
    kinds: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """What the laws of a model add to linear storeys, in words by site.

    Parameters
    ----------
    model : ChainModel
    shares : mapping of str to Series
        Percent of the force of each site that a term carries, as returned by
        :func:`shares_of`; terms that carry next to nothing are not named.
    bounds : mapping of str to (float, float), optional
        95 % intervals by parameter, such as ``"storey 2: Fc"``.
    kinds : mapping of str to str, optional
        Kinds of the nonlinear forces of power series by site, as returned by
        :attr:`~pysindy_nrf.diagnosis.significance.SeriesEstimate.kind`. Where a site
        has none, the sizes of single terms decide.
    """
    parts: dict[str, str] = {}
    for site, force in model.restoring_forces.items():
        carried = shares.get(str(site), pd.Series(dtype=float))
        texts = []
        for law in force.laws:
            if law.name == "power_series":
                kind = (kinds or {}).get(str(site))
                text = _of_power_series(str(site), law, carried, kind)
            else:
                text = _nonlinear_part(force, law, carried, bounds or {})
            if text:
                texts.append(text)
        if texts:
            parts[str(site)] = ", ".join(texts)
    return parts


def _nonlinear_part(
    force: RestoringForce, law: ForceLaw, carried: pd.Series, bounds: Bounds
) -> str:
    """What one law adds to a linear storey; empty if that is nothing."""
    site = str(force.site)
    values: dict[str, float | None] = {}
    units, intervals = {}, {}
    noticed = []
    for term, value in zip(law.terms(), np.asarray(law.coefficients, dtype=float)):
        if term.label in ("v", "s"):  # what is linear is no effect
            continue
        values[term.symbol] = float(value)
        units[term.symbol] = force.unit_system.of(term.unit)
        intervals[term.symbol] = bounds.get(f"{site}: {term.label}", (np.nan, np.nan))
        if carried.get(term.label, 0.0) > 100 * NAMED_SHARE:
            noticed.append(term.label)

    if not values or (len(carried) and not noticed):
        return ""
    return effect_words(law.name, site, values, intervals, units)


def _of_power_series(
    site: str, law: ForceLaw, carried: pd.Series, kind: str | None
) -> str:
    """What the nonlinear terms of a power series are; empty if there is none.

    ``kind`` is what a test of all of them says; None without a test.
    """
    labels = [term.label for term in law.terms() if term.label not in ("v", "s")]
    shares = carried.astype(float).reindex(labels).fillna(0.0)
    noticed = list(shares.index[shares > 100 * NAMED_SHARE])
    if kind is None:
        kind = _kind_of(noticed)
    if not kind or not labels:
        return ""

    letter = {"nonlinear stiffness": "s", "nonlinear damping": "v"}.get(kind, "")
    of_kind = [label for label in noticed or labels if letter in label] or labels
    first = of_kind[0] if noticed else str(shares[of_kind].idxmax())
    return f"{kind} in {site} ({first} carries {shares[first]:.2g} % of its force)"


def _kind_of(labels: list[str]) -> str:
    """The kind of a nonlinear force with some terms; empty without any."""
    if not labels:
        return ""
    of_drift = any("s" in label for label in labels)
    of_rate = any("v" in label for label in labels)
    if not of_rate:
        return "nonlinear stiffness"
    return "a nonlinear force" if of_drift else "nonlinear damping"
