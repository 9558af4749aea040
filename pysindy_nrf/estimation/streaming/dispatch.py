"""``fit`` on what does not fit in memory, and ``partial_fit``."""

from __future__ import annotations

import os
import time as clock
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...data.channels import is_dask
from ...data.record import Record
from ...exceptions import ChannelError, DataQualityWarning, NRFError
from ..problem import law_list

SAVE_EVERY = 10.0  # s between two states on disk


def is_streamed(X: Any) -> bool:
    """Whether ``fit`` has to read X piece by piece: a path, an iterator, something of Dask, or a list of those.

    Parameters
    ----------
    X : object

    Returns
    -------
    bool

    Examples
    --------
    >>> is_streamed("test.parquet"), is_streamed(iter([])), is_streamed([[1.0, 2.0, 3.0]])
    (True, True, False)
    """
    if isinstance(X, (list, tuple)):
        return len(X) > 0 and not isinstance(X[0], (list, tuple, Record)) and is_streamed(X[0])
    return isinstance(X, (str, os.PathLike)) or isinstance(X, Iterator) or is_dask(X)


def fit_streamed(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    record: Any = None,
    time: Any = None,
    base_acceleration: Any = None,
    covariates: Any = None,
    state: Any = None,
    save_every: float = SAVE_EVERY,
    progress: bool | None = None,
) -> Any:
    """Fit an estimator in one pass over chunks; memory does not grow with the number of samples.

    Files and other sources that can be read again are resumed where an earlier call with the same data and
    settings was interrupted. Masses, coefficients, errors and intervals are those of ``fit`` on arrays;
    ``missing_terms_`` and the visited region are judged on some thousand samples spread over the data, and
    ``unknown_forces_`` is left empty.

    Parameters
    ----------
    estimator : NRFRegressor
        With ``estimation="ls"``, no ``band`` and values for all shape parameters.
    X, F, record, time, base_acceleration, covariates
        See :func:`pysindy_nrf.estimation.streaming.open_source`; Dask arrays, tables and delayed records:
        :mod:`pysindy_nrf.estimation.distributed`.
    state : path-like, optional
        Where an interrupted pass leaves its state. For files by path a hidden file beside the first one if None;
        it is deleted when the fit is done.
    save_every : float
        Seconds between two states.
    progress : bool, optional
        Show samples a second and the time left; None: where the error stream is a terminal.

    Returns
    -------
    NRFRegressor
        The estimator, fitted.

    Raises
    ------
    ChannelError, ChainError, FileFormatError

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> from pysindy_nrf.estimation.streaming import fit_streamed
    >>> t = np.arange(4000) / 200
    >>> s, v = np.sin(9 * t) + np.sin(23 * t), 9 * np.cos(9 * t) + 23 * np.cos(23 * t)
    >>> a = -81 * np.sin(9 * t) - 529 * np.sin(23 * t)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     X, F = pathlib.Path(folder, "X.npy"), pathlib.Path(folder, "F.npy")
    ...     np.save(X, np.column_stack([a, v, s]))
    ...     np.save(F, (10 * a + 30 * v + 4e3 * s)[:, None])
    ...     fit_streamed(NRFRegressor(degree=1), X, F).masses_.round(6)
    array([10.])
    """
    from threadpoolctl import threadpool_limits

    beside = dict(record=record, time=time, base_acceleration=base_acceleration, covariates=covariates)
    if is_dask(X) or (isinstance(X, (list, tuple)) and is_dask(X[0])):
        from .partitions import fit_distributed

        return fit_distributed(estimator, X, F, **beside)
    from .result import publish, solution_of
    from .sources import open_source

    read = sorted({c for law in law_list(estimator.laws) for c in law.covariates})
    source = open_source(X, F, **beside, coordinates=estimator.coordinates, laws_read=read)
    with threadpool_limits(1, "blas"):  # the matrices are small, and other fits may run beside this one
        kind = "gram" if source.again else "careful"
        passes = _Passes(estimator, source, state, save_every, progress)
        accumulator = passes.run(kind)
        solution, grams, walk = solution_of(accumulator)
        if solution is None:  # once more, with columns made orthogonal by what was found
            from ...regression.gram_pass import guess_of

            passes.keep(accumulator)
            guess = guess_of(grams)
            accumulator = passes.run("root", guess)
            solution, grams, walk = solution_of(accumulator)
        assert solution is not None  # only Gram matrices lose digits
        publish(accumulator, solution, grams, walk)
    passes.done()
    return estimator


def partial_fit(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    record: Any = None,
    time: Any = None,
    base_acceleration: Any = None,
    covariates: Any = None,
) -> Any:
    """Add samples to an estimator and solve again.

    Each call holds one record or more of its own. A call that fails adds nothing.

    Parameters
    ----------
    estimator : NRFRegressor
    X, F, record, time, base_acceleration, covariates
        As for ``NRFRegressor.fit``.

    Returns
    -------
    NRFRegressor

    Raises
    ------
    NRFError
        If a setting of the estimator changed since the call before, and as ``NRFRegressor.fit``.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> from pysindy_nrf.estimation.streaming import partial_fit
    >>> model = NRFRegressor(degree=1)
    >>> for blow in range(3):
    ...     t = np.arange(1000) / 200
    ...     s = np.sin(9 * t + blow) + np.sin(23 * t)
    ...     v = 9 * np.cos(9 * t + blow) + 23 * np.cos(23 * t)
    ...     a = -81 * np.sin(9 * t + blow) - 529 * np.sin(23 * t)
    ...     model = partial_fit(model, np.column_stack([a, v, s]), (10 * a + 30 * v + 4e3 * s)[:, None])
    >>> model.masses_.round(6)
    array([10.])
    """
    from threadpoolctl import threadpool_limits

    from ...regression.input_arrays import holds_records
    from .accumulator import Accumulator
    from .result import publish, solution_of
    from .sources import Chunk, chunk_of

    held = getattr(estimator, "_stream", None)
    # work on a copy: a call that fails leaves the samples of those before as they were
    accumulator, number = (Accumulator(estimator, "careful"), 0) if held is None else (held[0].copy(), held[1])
    if held is not None and accumulator.settings != _settings(estimator):
        raise NRFError(
            "The settings of the estimator changed between two calls of partial_fit",
            "Set them back, or begin anew with fit or with a clone.",
        )
    if holds_records(X):
        chunks: Iterable[Chunk] = (chunk_of(r) for r in ([X] if isinstance(X, Record) else X))
    else:
        extra = {} if covariates is None else {k: np.asarray(c) for k, c in dict(covariates).items()}
        chunks = [Chunk(X, F, f"call {number}", True, record, time, base_acceleration, extra)]
    with threadpool_limits(1, "blas"):
        for chunk in chunks:
            accumulator.add(chunk, number)
            number += 1
        accumulator.settings = _settings(estimator)
        solution, grams, walk = solution_of(accumulator)
        assert solution is not None  # only Gram matrices lose digits
        publish(accumulator, solution, grams, walk)
    estimator._stream = accumulator, number
    return estimator


def _settings(estimator: Any) -> dict[str, str]:
    return {k: repr(v) for k, v in estimator.get_params(deep=False).items()}


class _Passes:
    """Passes over a source with progress and a state on disk."""

    def __init__(self, estimator: Any, source: Any, state: Any, save_every: float, progress: bool | None) -> None:
        from .state import identity

        self.estimator, self.source, self.save_every = estimator, source, save_every
        self.progress = progress
        self.mark = identity(estimator, source) if source.again else ""
        if state is not None and not source.again:
            raise ChannelError(
                "An iterator cannot be read again from the middle, so state= is of no use", "Give files by path."
            )
        folder = source.folder() if source.again else None
        if state is not None:
            self.path: Path | None = Path(state)
        elif folder is not None and os.access(folder, os.W_OK):
            self.path = folder / f".fit-{self.mark[:12]}.nrf-state"
        else:
            self.path = None

    def run(self, kind: str, guess: Any = None) -> Any:
        """One pass."""
        from tqdm.auto import tqdm

        from . import state
        from .accumulator import Accumulator

        accumulator, number = Accumulator(self.estimator, kind, guess, self.source.n_samples), 0
        self.kind = kind
        if self.path is not None:
            found = state.load(self._file(self.path), self.estimator, self.mark)
            if found is not None:
                accumulator, number = found
        saved = clock.monotonic()
        hidden = None if self.progress is None else not self.progress
        with tqdm(
            total=self.source.n_samples, initial=accumulator.n_samples, unit="sample", unit_scale=True,
            desc="fit" if kind != "root" else "fit, second pass", disable=hidden, delay=1.0,
        ) as bar:  # fmt: skip
            try:
                for chunk in self.source.chunks(number):
                    accumulator.add(chunk, number)
                    number += 1
                    bar.update(chunk.n_samples)
                    if clock.monotonic() - saved >= self.save_every:
                        self._save(accumulator, number)
                        saved = clock.monotonic()
            except KeyboardInterrupt as stop:
                if number:
                    self._save(accumulator, number)
                if number and self.path is not None:  # an in-memory source or a folder that is not ours has no state
                    stop.add_note(f"What was done is in {self._file(self.path)}; the same call goes on from there.")
                raise
        self.number = number
        return accumulator.close()

    def keep(self, accumulator: Any) -> None:
        """Write the state of a pass that is done and that another one follows."""
        self._save(accumulator, self.number)

    def _file(self, path: Path) -> Path:
        """The file of this pass."""
        return path.with_name(path.name + "-2") if self.kind == "root" else path

    def _save(self, accumulator: Any, number: int) -> None:
        import warnings

        from .state import save

        if self.path is None:
            return
        try:
            save(self._file(self.path), accumulator, number, self.mark)
        except OSError as error:  # the fit is worth more than its state
            warnings.warn(
                f"The state of the fit cannot be written to {self.path} ({error}); the fit goes on, but cannot be "
                "resumed.",
                DataQualityWarning,
                stacklevel=4,
            )
            self.path = None

    def done(self) -> None:
        """Delete the state."""
        for kind in ("gram", "root"):
            self.kind = kind
            if self.path is not None:
                self._file(self.path).unlink(missing_ok=True)


