"""Stiffness, damping and friction against time: what a fit with ``varying`` gives."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ...chain.sites import Site, SiteName
from ...diagnosis.stiffness_change import StiffnessChange
from ...drawing.matplotlib_renderer import Drawing
from ...exceptions import ChainError
from ...report.figures.courses import course_figures

if TYPE_CHECKING:
    from ...drawing.figure import Figure

# Kinds of ``changes``.
CONSTANT = "constant"
GRADUAL = "gradual"
SUDDEN = "sudden"
BOTH = "gradual and sudden"
AMPLITUDE = "amplitude dependence"
EITHER = "change or amplitude dependence"
UNCERTAIN = "not certain"
CHANGING = (GRADUAL, SUDDEN, BOTH)
# Label of the term of a stiffness.
STIFFNESS = "s"


@dataclass(frozen=True, eq=False)
class TimeVariation:
    """Courses of coefficients in time, with what is known of their changes.

    Attributes
    ----------
    table : DataFrame
        ``site``, ``term``, ``unit``, ``t`` (s), ``value``, ``lower``, ``upper`` (95 %
        band), a row for each piece of the record. The band is NaN where it is not
        known how far noise biases the value: of terms that are not linear in the
        motion, if no free run follows the record.
    changes : DataFrame
        A row for each coefficient that was followed.

        - ``site``, ``term``.
        - ``kind``: ``"constant"``, ``"gradual"``, ``"sudden"``, ``"gradual and
          sudden"``, ``"amplitude dependence"``, ``"change or amplitude dependence"`` or
          ``"not certain"``. The last one means that noise may look like the change: a
          constant lies within the band, or a free run does not show it. Or the
          coefficient is negative.
        - ``first``, ``last``, ``lowest``: values, SI units.
        - ``change``: from the first to the last, with ``lower`` and ``upper``, percent
          of the first.
        - ``p``: a bound of the probability of the evidence if nothing changes.
    instants : DataFrame
        Sudden changes: ``site``, ``term``, ``t`` with ``t_lower`` and ``t_upper`` (s),
        ``change`` (percent of the value before).
    masses : ndarray of shape (n_dof,)
        Found together with the courses, kg.
    errors : Series
        What the equations of motion leave, percent of the forces: ``constant`` and
        ``varying``.
    false_alarm_rate : float
        Probability that anything of a structure that does not change is called
        changing.
    period : float
        Of the first mode, s; an eighth of it is the resolution in time.

    Examples
    --------
    A tenth of the stiffness is lost after 10 s.

    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(4000) / 200.0  # s
    >>> s = np.convolve(rng.standard_normal(4040), np.hanning(41), "valid")
    >>> v = np.gradient(s, 0.005)
    >>> a = np.gradient(v, 0.005)
    >>> F = 2.0 * a + 5.0 * v + np.where(t < 10, 400.0, 360.0) * s
    >>> F = F + 0.02 * F.std() * rng.standard_normal(4000)
    >>> model = NRFRegressor(degree=1, dt=0.005, varying={1: "s"})
    >>> variation = model.fit(
    ...     np.column_stack([a, v, s]), F[:, None]
    ... ).time_variation_
    >>> variation.changing
    ['storey 1']
    >>> variation.instants[["t", "change"]].round().to_numpy().tolist()
    [[10.0, -10.0]]
    """

    table: pd.DataFrame
    changes: pd.DataFrame
    instants: pd.DataFrame
    masses: np.ndarray
    errors: pd.Series
    false_alarm_rate: float
    period: float

    @property
    def changing(self) -> list[str]:
        """Sites at which something changes in time."""
        changes = self.changes[self.changes["kind"].isin(CHANGING)]
        return list(dict.fromkeys(changes["site"]))

    @property
    def stiffness_changes(self) -> list[StiffnessChange]:
        """Storeys whose stiffness changes, by how much, how sure, and since when.

        In the form in which ``monitoring.compare_tests`` has those between two tests.
        """
        of_stiffness = self.changes["term"] == STIFFNESS
        rows = self.changes[of_stiffness & self.changes["kind"].isin(CHANGING)]
        changes = []
        for row in rows.itertuples():
            of_storey = self.instants["site"] == row.site
            sudden = self.instants[of_storey & (self.instants["term"] == STIFFNESS)]
            since = None
            if len(sudden):
                largest = sudden["change"].abs().idxmax()
                since = float(sudden.loc[largest, "t"])
            changes.append(
                StiffnessChange(row.site, row.change, row.lower, row.upper, since)
            )
        return changes

    def course(self, site: SiteName, term: str) -> pd.DataFrame:
        """Value and band of one coefficient, by time.

        Parameters
        ----------
        site : str or int
        term : str
            Its label, such as ``"s"``.

        Returns
        -------
        DataFrame
            ``value``, ``lower``, ``upper``, SI, indexed by ``t``, s.

        Raises
        ------
        ChainError
            If the coefficient was not followed.
        """
        table = self.table
        here = table[(table["site"] == str(Site(site))) & (table["term"] == term)]
        if here.empty:
            followed = [f"{row.site}: {row.term}" for row in self.changes.itertuples()]
            raise ChainError(
                f"The term {term!r} of {Site(site)} was not followed in time",
                f"Ask for one of {', '.join(followed)}, or name it in varying=.",
            )
        return here.set_index("t")[["value", "lower", "upper"]]

    def __str__(self) -> str:
        lines = [_sentence(row) for row in self.changes.to_dict("records")]
        return "\n".join(lines)

    def to_json(self) -> str:
        """All tables, the masses and the errors as JSON."""
        content = {
            "changes": _known(self.changes).to_dict("records"),
            "instants": self.instants.to_dict("records"),
            "courses": _known(self.table).to_dict("list"),
            "masses_kg": self.masses.tolist(),
            "errors_percent": self.errors.to_dict(),
            "false_alarm_rate": self.false_alarm_rate,
            "first_period_s": self.period,
        }
        return json.dumps(content, indent=1)

    def figures(self) -> list[Figure]:
        """One figure for each coefficient that was followed."""
        return course_figures(self.table, self.instants)

    def plot(self) -> Drawing:
        """Draw every course with its band (matplotlib).

        Returns
        -------
        Display
            With ``axes_`` and ``figure_``.
        """
        return Drawing(self.figures()).plot()


def _known(table: pd.DataFrame) -> pd.DataFrame:
    """A table with None for what is not known, as JSON has it."""
    return table.astype(object).where(table.notna(), None)


def _sentence(row: dict[str, object]) -> str:
    """One coefficient in words."""
    name = f"{row['site']}, {row['term']}"
    if row["kind"] == CONSTANT:
        return f"{name}: no change is seen."
    if row["kind"] in CHANGING:
        interval = f" ({row['lower']:+.3g} to {row['upper']:+.3g})"
        if pd.isna(row["lower"]):
            interval = ", of unknown error"
        return f"{name}: {row['kind']} change of {row['change']:+.3g} %{interval}."
    if row["kind"] == UNCERTAIN:
        return (
            f"{name}: follows the record, but noise may look like it, or it is"
            " negative: no certain change."
        )
    if row["kind"] == AMPLITUDE:
        return f"{name}: depends on the amplitude; no change in time is seen."
    return (
        f"{name}: changes in time or depends on the amplitude; the record does not show"
        " which."
    )
