"""Figures of the commands, drawn where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...common.atomic import atomic_write
from ..displays import FreeRunDisplay, HysteresisLoopDisplay
from ..displays._axes import BLUE, ORANGE
from .text import band_text
from .work import Outcome


def available() -> bool:
    """Whether matplotlib is installed."""
    from importlib.util import find_spec

    return find_spec("matplotlib") is not None


def draw_all(outcome: Outcome, folder: Path, band: Any) -> list[Path]:
    """Draw the restoring forces, and the free run or the frequency response."""
    if not available():
        return []
    if outcome.frf is not None:
        return [_save(folder / "frequency_response.png", lambda: _responses(outcome, band))]
    written = []
    if outcome.data is not None:
        written.append(_save(folder / "restoring_forces.png", lambda: _forces(outcome, band)))
    if outcome.runs:
        written.append(_save(folder / "free_run.png", lambda: _free_run(outcome, band)))
    return written


def draw(path: Path, plot: Callable[[Any], Any], size: tuple[float, float] = (6.0, 4.0)) -> list[Path]:
    """Draw one figure."""
    if not available():
        return []

    def drawn() -> Any:
        figure, axes = _figure(1, 1, size)
        plot(axes[0, 0])
        return figure

    return [_save(path, drawn)]


def _save(path: Path, draw: Callable[[], Any]) -> Path:
    figure = draw()
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format="png", dpi=150)
    return path


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    # no pyplot: no global state, no display
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _forces(outcome: Outcome, band: Any) -> Any:
    """Each site's force around the largest motion, against its drift: identified over what the balances ask for."""
    from ...discrepancy.site_loops import loops_of
    from ...signals.zero_phase_filter import filters_of

    data = outcome.data
    assert data is not None
    loops = loops_of(outcome.estimator.model_, data, filters_of(band, data))
    columns = max(1, min(3, len(loops)))
    rows = max(1, -(-len(loops) // columns))
    figure, axes = _figure(rows, columns, (3.9 * columns, 3.3 * rows))
    for ax, loop in zip(axes.flat, loops):
        HysteresisLoopDisplay(loop.s, loop.identified, loop.measured, site=loop.site).plot(ax)
    for ax in list(axes.flat)[len(loops) :]:
        ax.set_axis_off()
    return figure


def _free_run(outcome: Outcome, band: Any) -> Any:
    """Measured and free-run displacements at the end of the first record, where a model has had time to go wrong."""
    from ...signals.zero_phase_filter import FairFilter

    seg, run = outcome.runs[0]
    measured, own = np.cumsum(seg.s[seg.valid], axis=1), run.displacement
    begin = run.time[_start_of_last_cycles(measured)]
    if band is not None:
        filter = FairFilter(band, run.fs)
        measured, own = filter.apply(measured), filter.apply(own)
    n = measured.shape[1]
    figure, axes = _figure(n, 1, (8.0, 1.2 + 1.7 * n))
    FreeRunDisplay(run.time, measured, own).plot(axes)  # its errors are those of the whole record
    for ax in axes.flat:
        ax.set_xlim(begin, run.time[-1])
    last = f", last {run.time[-1] - begin:.3g} s" if begin > run.time[0] else ""
    figure.suptitle(f"The model alone under the measured force{last}, {band_text(band)}")
    return figure


def _start_of_last_cycles(measured: np.ndarray, cycles: int = 25) -> int:
    """Row where the last cycles of the top displacement begin."""
    top = measured[:, -1] - measured[:, -1].mean()
    crossings = np.flatnonzero(np.diff(np.signbit(top)))
    return int(crossings[-2 * cycles]) if len(crossings) >= 2 * cycles else 0


def _responses(outcome: Outcome, band: Any) -> Any:
    """Measured and modelled accelerance."""
    assert outcome.frf is not None
    frf, found = outcome.frf
    low, high = band if band is not None else (None, None)
    used = (frf.f >= (low or 0.0)) & (frf.f <= (np.inf if high is None else high))
    figure, axes = _figure(frf.n_dof, 1, (8.0, 1.2 + 1.9 * frf.n_dof))
    for j in range(frf.n_dof):
        ax = axes[frf.n_dof - 1 - j, 0]
        ax.semilogy(frf.f[used], np.abs(frf.H[used, j]), color=ORANGE, lw=1.8, label="measured")
        ax.semilogy(frf.f[used], np.abs(found[used, j]), color=BLUE, lw=0.9, ls="--", label="model")
        ax.set(ylabel=f"|H{j + 1}| (m/s²/N)")
        ax.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("frequency (Hz)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(f"Accelerance, force on DOF {frf.driven}, {band_text(band)}")
    return figure
