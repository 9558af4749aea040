r"""A control chart of quantities that follow covariates such as the temperature.

The tests of a reference, in which the structure is taken to be sound, give the
regression on the covariates and the scatter. What later tests leave of it is averaged
with weights that fade (EWMA: Roberts, Technometrics 1, 1959),

.. math:: E_i = (1 - \lambda) E_{i-1} + \lambda r_i .

With normal scatter :math:`E_i` over its standard error, that of the regression
included, is Student's t exactly: the rate of false alarms of a test is the one stated,
however short the reference is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from ..exceptions import ChannelError

# Weight of the newest test: 0.2 finds lasting changes of a standard deviation soonest
# (Lucas and Saccucci, Technometrics 32, 1990).
WEIGHT_OF_NEWEST = 0.2


@dataclass(frozen=True, eq=False)
class Average:
    """The weighted average of what tests leave, as far as it has come.

    Attributes
    ----------
    residual : ndarray of shape (n_quantities,)
    covariates : ndarray of shape (n_columns,)
        The same average of the columns of the regression.
    squares : float
        Sum of the squares of the weights.
    """

    residual: np.ndarray
    covariates: np.ndarray
    squares: float


@dataclass(frozen=True, eq=False)
class ChartPoint:
    """One test on the chart.

    Attributes
    ----------
    expected : ndarray of shape (n_quantities,)
        What the covariates let expect.
    statistic : ndarray of shape (n_quantities,)
        Weighted average over its standard error.
    shift : ndarray of shape (n_quantities,)
        The average itself: how far the quantity has moved.
    limit : float
        Of the statistic.
    average : Average
        From which the next test goes on.
    """

    expected: np.ndarray
    statistic: np.ndarray
    shift: np.ndarray
    limit: float
    average: Average

    @property
    def alarms(self) -> np.ndarray:
        """Whether each quantity has left its limits, (n_quantities,)."""
        return np.abs(self.statistic) > self.limit


@dataclass(frozen=True, eq=False)
class ControlChart:
    """A chart with what its reference says.

    Attributes
    ----------
    coefficients : ndarray of shape (n_columns, n_quantities)
        Of a constant and of the covariates less their means.
    means : ndarray of shape (n_covariates,)
    inverse : ndarray of shape (n_columns, n_columns)
        Of the products of the columns.
    scatter : ndarray of shape (n_quantities,)
        Standard deviation about the regression.
    freedom : int
        Degrees of freedom of the scatter.
    false_alarm_rate : float
        Of one test, all quantities together.
    """

    coefficients: np.ndarray
    means: np.ndarray
    inverse: np.ndarray
    scatter: np.ndarray
    freedom: int
    false_alarm_rate: float

    @classmethod
    def of(
        cls,
        values: npt.ArrayLike,
        covariates: npt.ArrayLike | None = None,
        false_alarm_rate: float = 0.01,
    ) -> ControlChart:
        """The chart of a reference.

        Parameters
        ----------
        values : array-like of shape (n_tests, n_quantities)
        covariates : array-like of shape (n_tests, n_covariates), optional
        false_alarm_rate : float
            Probability that a test of a sound structure raises an alarm.

        Raises
        ------
        ChannelError
            If the tests are too few for a scatter, or the rate is no probability.

        Examples
        --------
        >>> import numpy as np
        >>> from pysindy_nrf.monitoring import ControlChart
        >>> rng = np.random.default_rng(0)
        >>> warm = rng.uniform(0, 20, (30, 1))  # degrees
        >>> k = 4e4 - 100 * warm + 50 * rng.standard_normal((30, 1))
        >>> chart = ControlChart.of(k, warm)
        >>> point = chart.next(chart.start(), [3.8e4], [20.0])
        >>> bool(point.alarms[0])
        False
        """
        observed = np.asarray(values, dtype=float)
        n_tests = len(observed)
        beside = np.zeros((n_tests, 0))
        if covariates is not None:
            beside = np.asarray(covariates, dtype=float).reshape(n_tests, -1)
        if not 0 < false_alarm_rate < 1:
            raise ChannelError(
                f"false_alarm_rate={false_alarm_rate!r} is no probability",
                "Give e.g. 0.01.",
            )
        means = beside.mean(axis=0)
        columns = np.column_stack([np.ones(n_tests), beside - means])
        freedom = n_tests - columns.shape[1]
        if freedom < 1:
            raise ChannelError(
                f"{n_tests} tests are too few for a reference with"
                f" {beside.shape[1]} covariates",
                "Give more tests of the sound structure.",
            )
        inverse = np.linalg.pinv(columns.T @ columns)
        coefficients = inverse @ columns.T @ observed
        residuals = observed - columns @ coefficients
        scatter = np.sqrt(np.sum(residuals**2, axis=0) / freedom)
        return cls(coefficients, means, inverse, scatter, freedom, false_alarm_rate)

    @property
    def limit(self) -> float:
        """Of the statistic of each quantity."""
        n_quantities = len(self.scatter)
        tail = self.false_alarm_rate / (2 * n_quantities)
        return float(stats.t.isf(tail, self.freedom))

    def start(self) -> Average:
        """The average before the first test."""
        n_columns, n_quantities = self.coefficients.shape
        return Average(np.zeros(n_quantities), np.zeros(n_columns), 0.0)

    def next(
        self,
        average: Average,
        values: npt.ArrayLike,
        covariates: npt.ArrayLike | None = None,
    ) -> ChartPoint:
        """One further test.

        Parameters
        ----------
        average : Average
            As far as it has come.
        values : array-like of shape (n_quantities,)
        covariates : array-like of shape (n_covariates,), optional
        """
        beside = np.zeros(0) if covariates is None else np.asarray(covariates, float)
        column = np.append(1.0, beside - self.means)
        expected = column @ self.coefficients
        fade = 1 - WEIGHT_OF_NEWEST
        residual = np.asarray(values, dtype=float) - expected
        now = Average(
            fade * average.residual + WEIGHT_OF_NEWEST * residual,
            fade * average.covariates + WEIGHT_OF_NEWEST * column,
            fade**2 * average.squares + WEIGHT_OF_NEWEST**2,
        )
        of_regression = now.covariates @ self.inverse @ now.covariates
        error = self.scatter * np.sqrt(now.squares + of_regression)
        # the average of the constant is the sum of the weights
        shift = now.residual / now.covariates[0]
        return ChartPoint(expected, now.residual / error, shift, self.limit, now)
