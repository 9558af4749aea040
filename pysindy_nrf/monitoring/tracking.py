"""A structure followed test by test, with the covariates regressed out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import clone

from ..chain.model import storey_names
from ..drawing.matplotlib_renderer import Drawing
from ..exceptions import ChannelError
from ..identification.regressor import NRFRegressor
from ..records.record import Record
from ..report.figures.control_charts import chart_figures
from .control_chart import ControlChart

FALSE_ALARM_RATE = 0.01


@dataclass(frozen=True, eq=False)
class Tracked:
    """The stiffnesses of a structure over many tests.

    Attributes
    ----------
    table : DataFrame
        A row for each test and storey.

        - ``test``, ``record``, ``storey``, and a column for each covariate.
        - ``stiffness`` with the ends ``lower`` and ``upper`` of its 95 % interval, N/m;
          NaN where the fit gives none.
        - ``expected``: N/m.
        - ``shift``: percent of the expected stiffness, averaged over the last tests.
        - ``statistic``, ``limit``, ``reference`` and ``alarm``.
    false_alarm_rate : float
        Of a test, all storeys together.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.monitoring import track
    >>> record = datasets.load_demo()
    >>> tests = [record.window(2.0 * i, 2.0 * i + 2.0) for i in range(10)]
    >>> report = track(
    ...     tests, NRFRegressor(degree=1, estimation="ls"), reference=9
    ... )
    >>> report.table["test"].nunique(), sorted(report.table["storey"].unique())
    (10, ['storey 1', 'storey 2', 'storey 3'])
    """

    table: pd.DataFrame
    false_alarm_rate: float

    @property
    def alarms(self) -> pd.DataFrame:
        """First alarm of each storey: ``storey``, ``test``, ``record``, ``shift``."""
        raised = self.table[self.table["alarm"]]
        first = raised.groupby("storey", sort=False).first().reset_index()
        return first[["storey", "test", "record", "shift"]]

    def __str__(self) -> str:
        if self.alarms.empty:
            return f"No alarm in {self.table['test'].nunique()} tests."
        return "\n".join(
            f"{row.storey}: alarm at test {row.test} ({row.record}), stiffness"
            f" {row.shift:+.2g} %."
            for row in self.alarms.itertuples()
        )

    def to_json(self) -> str:
        """The table as JSON, SI units."""
        rows = json.loads(self.table.to_json(orient="records"))
        content = {"tests": rows, "false_alarm_rate": self.false_alarm_rate}
        return json.dumps(content, indent=1)

    def plot(self) -> Drawing:
        """Draw the control chart of every storey (matplotlib).

        Returns
        -------
        Display
            With ``axes_`` and ``figure_``.
        """
        return Drawing(chart_figures(self.table)).plot()


def track(
    records: Sequence[Record],
    estimator: NRFRegressor,
    *,
    reference: int,
    covariates: Mapping[str, ArrayLike] | None = None,
    false_alarm_rate: float = FALSE_ALARM_RATE,
) -> Tracked:
    """Follow the stiffness of every storey test by test.

    Each record is fitted by itself. The first ``reference`` tests are of the sound
    structure: they give the regression on the covariates and the scatter (see
    :class:`ControlChart`). Compare like with like: with laws that are not the
    structure's own, a stiffness follows the amplitude; ``compare_tests`` separates the
    two for a pair of tests.

    Parameters
    ----------
    records : sequence of Record
        In the order of time.
    estimator : NRFRegressor
        How a record is fitted, for example ``NRFRegressor(degree=1)``; it is copied.
    reference : int
        Number of tests of the sound structure, the first ones.
    covariates : mapping of str to array-like of shape (n_tests,), optional
        What is regressed out, a number for each test: ``{"temperature": [...]}``.
    false_alarm_rate : float
        Probability that a test of the sound structure raises an alarm.

    Returns
    -------
    Tracked

    Raises
    ------
    ChannelError
        If a covariate has another number of values, or there are too few tests.

    Examples
    --------
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     simulate,
    ... )
    >>> from pysindy_nrf.monitoring import track
    >>> from pysindy_nrf.simulation import add_noise
    >>> def test_with(k, seed):
    ...     chain = ChainModel([10.0], {1: laws.PowerSeries(1, [40.0, k])})
    ...     F = excitation.band_limited_random(
    ...         1,
    ...         8.0,
    ...         200.0,
    ...         excited=1,
    ...         rms=50.0,
    ...         band=(1, 20),
    ...         random_state=seed,
    ...     )
    ...     return add_noise(simulate(chain, F, 0.005), 0.01, random_state=seed)
    >>> records = [
    ...     test_with(k, i) for i, k in enumerate([4e4] * 9 + [3.8e4] * 2)
    ... ]
    >>> int(
    ...     track(records, NRFRegressor(degree=1), reference=8)
    ...     .alarms["test"]
    ...     .iloc[0]
    ... )
    9
    """
    if len(records) <= reference:
        raise ChannelError(
            f"{len(records)} tests leave none after a reference of {reference}",
            "Give more tests, or a shorter reference.",
        )
    names = list(covariates or {})
    beside = _covariate_columns(covariates or {}, len(records))
    models = [clone(estimator).fit(record) for record in records]
    values = np.array([_stiffnesses(model) for model in models])
    chart = ControlChart.of(values[:reference], beside[:reference], false_alarm_rate)
    average = chart.start()
    tables = []
    for test, record in enumerate(records):
        point = chart.next(average, values[test], beside[test])
        is_reference = test < reference
        if not is_reference:
            average = point.average
        table = _intervals(models[test])
        table.insert(0, "test", test)
        table.insert(1, "record", record.name)
        for name, value in zip(names, beside[test]):
            table[name] = value
        table["expected"] = point.expected
        table["shift"] = 100 * point.shift / np.abs(point.expected)
        table["statistic"] = point.statistic
        table["limit"] = point.limit
        table["reference"] = is_reference
        table["alarm"] = point.alarms & (not is_reference)
        tables.append(table)
    return Tracked(pd.concat(tables, ignore_index=True), false_alarm_rate)


def _stiffnesses(model: NRFRegressor) -> list[float]:
    """Tangent stiffness at rest of every storey, N/m."""
    names = storey_names(model.model_)
    return [model.restoring_forces_[name].linear_part()["k"] for name in names]


def _intervals(model: NRFRegressor) -> pd.DataFrame:
    """Stiffness of every storey with its 95 % interval."""
    bounds, _ = model.bounds()
    rows = []
    for storey, stiffness in zip(storey_names(model.model_), _stiffnesses(model)):
        lower, upper = bounds.get(f"{storey}: s", (np.nan, np.nan))
        rows.append((storey, stiffness, lower, upper))
    return pd.DataFrame(rows, columns=["storey", "stiffness", "lower", "upper"])


def _covariate_columns(covariates: Mapping[str, ArrayLike], n_tests: int) -> np.ndarray:
    """A column for each covariate, (n_tests, n_covariates)."""
    columns = np.zeros((n_tests, len(covariates)))
    for i, (name, values) in enumerate(covariates.items()):
        column = np.asarray(values, dtype=float)
        if column.shape != (n_tests,) or not np.isfinite(column).all():
            raise ChannelError(
                f"The covariate {name!r} is no list of {n_tests} numbers",
                "Give a number for each test.",
            )
        columns[:, i] = column
    return columns
