"""Figures of the commands, drawn where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .._atomic import atomic_write
from .text import band_text
from .work import Outcome

# Blue and orange of Okabe and Ito's palette, told apart by colour-blind readers and in grey.
MEASURED, MODEL = "#999999", "#0072B2"


def available() -> bool:
    """Whether matplotlib is installed."""
    from importlib.util import find_spec

    return find_spec("matplotlib") is not None


def draw_all(outcome: Outcome, folder: Path, band: Any) -> list[Path]:
    """Draw the restoring forces, and the free run or the frequency response.

    Parameters
    ----------
    outcome : Outcome
    folder : Path
    band : (float, float) or None

    Returns
    -------
    list of Path
        Empty without matplotlib.
    """
    if not available():
        return []
    if outcome.frf is not None:
        return [_save(folder / "frequency_response.png", lambda: _responses(outcome, band))]
    written = []
    if outcome.runs:
        written.append(_save(folder / "restoring_forces.png", lambda: _forces(outcome)))
        written.append(_save(folder / "free_run.png", lambda: _free_run(outcome)))
    return written


def _save(path: Path, draw: Callable[[], Any]) -> Path:
    figure = draw()
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format="png", dpi=150)
    return path


def _figure(rows: int, columns: int, size: tuple[float, float]):
    # no pyplot: no global state, no display
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _forces(outcome: Outcome):
    """Each storey's force along the first record, against its drift."""
    model = outcome.estimator.model_
    seg, _ = outcome.runs[0]
    sites = [site for site, laws in model.laws.items() if laws]
    columns = min(3, len(sites))
    rows = -(-len(sites) // columns)
    figure, axes = _figure(rows, columns, (3.6 * columns, 3.2 * rows))
    for ax, site in zip(axes.flat, sites):
        motion = seg.motion(site, seg.valid)
        force = model.restoring_forces[site].along(motion)
        ax.plot(1e3 * motion.s, force, ".", ms=1.5, color=MODEL, rasterized=True)
        ax.set(xlabel="drift s (mm)", ylabel="restoring force (N)", title=str(site))
        ax.grid(alpha=0.3)
    for ax in list(axes.flat)[len(sites) :]:
        ax.set_axis_off()
    figure.suptitle(
        f"Identified restoring forces along {seg.name!r}" if seg.name != "0" else "Identified restoring forces"
    )
    return figure


def _free_run(outcome: Outcome):
    """Measured and free-run displacements at the end of the first record, where a model has had time to go wrong."""
    seg, run = outcome.runs[0]
    measured = 1e3 * np.cumsum(seg.s[seg.valid], axis=1)
    own, time = 1e3 * run.displacement, run.time
    rows = slice(_start_of_last_cycles(measured), None)
    measured, own, time = measured[rows], own[rows], time[rows]
    n = measured.shape[1]
    figure, axes = _figure(n, 1, (8.0, 1.2 + 1.7 * n))
    for j in range(n):
        ax = axes[n - 1 - j, 0]  # the roof on top
        ax.plot(time, measured[:, j], color=MEASURED, lw=2.2, label="measured")
        ax.plot(time, own[:, j], color=MODEL, lw=0.9, label="model alone")
        low, high = measured[:, j].min(), measured[:, j].max()
        room = 0.3 * (high - low)
        ax.set(ylabel=f"x{j + 1} (mm)", ylim=(low - room, high + room))
        ax.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(f"Free run under the measured force, last {time[-1] - time[0]:.3g} s")
    return figure


def _start_of_last_cycles(measured: np.ndarray, cycles: int = 25) -> int:
    """Row where the last cycles of the top displacement begin."""
    top = measured[:, -1] - measured[:, -1].mean()
    crossings = np.flatnonzero(np.diff(np.signbit(top)))
    return int(crossings[-2 * cycles]) if len(crossings) >= 2 * cycles else 0


def _responses(outcome: Outcome, band: Any):
    """Measured and modelled accelerance."""
    frf, found = outcome.frf
    low, high = band if band is not None else (None, None)
    used = (frf.f >= (low or 0.0)) & (frf.f <= (np.inf if high is None else high))
    figure, axes = _figure(frf.n_dof, 1, (8.0, 1.2 + 1.9 * frf.n_dof))
    for j in range(frf.n_dof):
        ax = axes[frf.n_dof - 1 - j, 0]
        ax.semilogy(frf.f[used], np.abs(frf.H[used, j]), color=MEASURED, lw=2.2, label="measured")
        ax.semilogy(frf.f[used], np.abs(found[used, j]), color=MODEL, lw=0.9, label="model")
        ax.set(ylabel=f"|H{j + 1}| (m/s²/N)")
        ax.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("frequency (Hz)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(f"Accelerance, force on DOF {frf.driven}, {band_text(band)}")
    return figure
