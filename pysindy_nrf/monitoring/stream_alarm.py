"""A stream of samples watched in constant memory, with an alarm of a stated rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..exceptions import ChannelError, NRFError
from ..identification.problem import Problem
from ..identification.regressor import NRFRegressor
from ..records.input_arrays import from_arrays
from .control_chart import Average, ControlChart


@dataclass(frozen=True, eq=False)
class _Block:
    """Samples that wait until a block is complete."""

    X: np.ndarray
    F: np.ndarray


class ChangeAlarm:
    """Watches the stiffness of every storey as samples arrive.

    Every block of samples is solved by itself. The first ``reference`` blocks are of
    the sound structure; then every block is a point of a :class:`ControlChart`. What is
    remembered are the samples of one block, the stiffnesses of the reference and a
    weighted average: the memory does not grow with the stream.

    Parameters
    ----------
    estimator : NRFRegressor
        Laws, known masses and ``dt``, e.g. ``NRFRegressor(degree=1, dt=0.005)``.
    block : float
        Length of a block, s: several periods of the first mode.
    reference : int
        Blocks of the sound structure.
    false_alarm_rate : float
        Probability that a block of a sound structure raises an alarm.

    Raises
    ------
    ChannelError
        If the estimator has no sampling step.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> from pysindy_nrf.monitoring import ChangeAlarm
    >>> rng = np.random.default_rng(0)
    >>> alarm = ChangeAlarm(
    ...     NRFRegressor(degree=1, dt=0.01), block=2.0, reference=10
    ... )
    >>> def samples(k):
    ...     a, v, s = X = rng.standard_normal((3, 1000))
    ...     F = 2 * a + 5 * v + k * s + 5 * rng.standard_normal(1000)
    ...     return X.T, F[:, None]
    >>> tables = [
    ...     alarm.update(*samples(k)) for k in (400.0, 400.0, 400.0, 300.0)
    ... ]
    >>> [bool(table["alarm"].any()) for table in tables]
    [False, False, False, True]
    """

    def __init__(
        self,
        estimator: NRFRegressor,
        *,
        block: float,
        reference: int,
        false_alarm_rate: float = 0.01,
    ) -> None:
        if estimator.dt is None:
            raise ChannelError(
                "A stream needs the sampling step", "Give NRFRegressor(dt=...), s."
            )
        self.estimator = estimator
        self.block = block
        self.reference = reference
        self.false_alarm_rate = false_alarm_rate
        self._size = int(round(block / estimator.dt))
        self._waiting: _Block | None = None
        self._values: list[np.ndarray] = []
        self._chart: ControlChart | None = None
        self._average: Average | None = None
        self._n_blocks = 0

    def update(self, X: npt.ArrayLike, F: npt.ArrayLike) -> pd.DataFrame:
        """Add samples in the order of time.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 n_dof)
            Columns as for :meth:`NRFRegressor.fit`.
        F : array-like of shape (n_samples, n_dof)
            N.

        Returns
        -------
        DataFrame
            A row for each block that is complete and each storey: ``t`` (its end, s,
            from the first sample), ``storey``, ``stiffness`` (N/m), ``statistic``,
            ``limit``, ``alarm``; NaN in the reference.
        """
        X, F = np.asarray(X, dtype=float), np.asarray(F, dtype=float)
        if self._waiting is not None:
            X = np.concatenate([self._waiting.X, X])
            F = np.concatenate([self._waiting.F, F])
        n_complete = len(X) // self._size
        tables = [self._empty()]
        for i in range(n_complete):
            rows = slice(i * self._size, (i + 1) * self._size)
            tables.append(self._point(self._stiffnesses(X[rows], F[rows])))
        rest = n_complete * self._size
        self._waiting = _Block(X[rest:].copy(), F[rest:].copy())
        filled = [table for table in tables if len(table)]
        return pd.concat(filled, ignore_index=True) if filled else tables[0]

    def _empty(self) -> pd.DataFrame:
        names = ["t", "storey", "stiffness", "statistic", "limit", "alarm"]
        return pd.DataFrame(columns=names)

    def _stiffnesses(self, X: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Stiffness of every storey from a block, N/m; NaN where it tells none."""
        problem = self._problem(X.shape[1] // 3)
        try:
            model = problem.solve(from_arrays(X, F, dt=self.estimator.dt)).model
        except NRFError:
            return np.full(problem.chain.n_dof, np.nan)
        forces = model.restoring_forces
        storeys = range(1, model.n_dof + 1)
        return np.array([forces[storey].linear_part()["k"] for storey in storeys])

    def _problem(self, n_dof: int) -> Problem:
        return self.estimator.problem(n_dof)

    def _point(self, values: np.ndarray) -> pd.DataFrame:
        """A block on the chart."""
        self._n_blocks += 1
        n_storeys = len(values)
        table = pd.DataFrame(
            {
                "t": self._n_blocks * self.block,
                "storey": [f"storey {i + 1}" for i in range(n_storeys)],
                "stiffness": values,
                "statistic": np.nan,
                "limit": np.nan,
                "alarm": False,
            }
        )
        if np.isnan(values).any():
            return table
        if self._chart is None or self._average is None:
            self._learn(values)
            return table
        point = self._chart.next(self._average, values)
        self._average = point.average
        return table.assign(
            statistic=point.statistic, limit=point.limit, alarm=point.alarms
        )

    def _learn(self, values: np.ndarray) -> None:
        """Add a block to the reference; with the last of them, make the chart."""
        self._values.append(values)
        if len(self._values) == self.reference:
            self._chart = ControlChart.of(
                np.array(self._values), None, self.false_alarm_rate
            )
            self._average = self._chart.start()
