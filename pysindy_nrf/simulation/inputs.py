"""What drives a free run: its checks, and its course between the samples."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from ..chain.sites import Site
from ..exceptions import ChannelError
from ..records.channels import as_matrix, rows_text
from ..records.hold import require_hold

# Internal states of laws, by the site and the number of the law there.
LawStates = Mapping[tuple[Site, int], npt.ArrayLike]


def force_matrix(
    F: npt.ArrayLike | None, base_acceleration: npt.ArrayLike | None, n_dof: int
) -> np.ndarray:
    """Forces of at least two samples; zero if only the base moves."""
    if F is not None:
        names = [f"F{j}" for j in range(1, n_dof + 1)]
        force = finite(F, names, "force")
    elif base_acceleration is not None:
        force = np.zeros((np.shape(base_acceleration)[0], n_dof))
    else:
        raise ChannelError(
            "Nothing drives the free run", "Give forces F, or base_acceleration=."
        )
    if len(force) < 2:
        raise ChannelError(
            f"The force has {len(force)} samples", "At least two are needed."
        )
    return force


def initial_motion(
    value: npt.ArrayLike | None, letter: str, n_dof: int, what: str
) -> np.ndarray:
    """An initial displacement or velocity of every DOF."""
    if value is None:
        return np.zeros(n_dof)
    array = np.asarray(value)
    if array.shape != (n_dof,):
        raise ChannelError(
            f"{letter}0 has shape {array.shape}, ({n_dof},) is needed",
            f"Give one initial {what} for each DOF.",
        )
    names = [f"{letter}{j}" for j in range(1, n_dof + 1)]
    return finite(array[None, :], names, f"initial {what}")[0]


def initial_states(
    states: LawStates | None, places: Mapping[tuple[Site, int], slice], n_states: int
) -> np.ndarray:
    """Initial internal states of all laws, one behind the other."""
    out = np.zeros(n_states)
    for law, values in (states or {}).items():
        site, number = law
        if law not in places:
            raise ChannelError(
                f"Law {number} at {site} has no internal state",
                "Give states of laws with memory.",
            )
        place = places[law]
        size = place.stop - place.start
        names = [f"z{k}" for k in range(1, size + 1)]
        row = np.reshape(np.asarray(values, dtype=float), (1, -1))
        out[place] = finite(row, names, f"initial state at {site}")[0]
    return out


def input_matrix(
    force: np.ndarray,
    base_acceleration: npt.ArrayLike | None,
    covariates: Mapping[str, npt.ArrayLike] | None,
    names: Sequence[str],
) -> np.ndarray:
    """Forces, base acceleration and the covariates that the laws read, side by side."""
    columns = [force]
    if base_acceleration is None:
        columns.append(np.zeros((len(force), 1)))
    else:
        columns.append(_column(base_acceleration, "ag", len(force)))
    for name in names:
        if covariates is None or name not in covariates:
            raise ChannelError(
                f"The laws of the model read the covariate {name!r}, which is not"
                " given",
                f"Pass covariates={{{name!r}: ...}}.",
            )
        columns.append(_column(covariates[name], name, len(force)))
    # one layout in memory: compiled once
    return np.ascontiguousarray(np.hstack(columns))


def _column(values: npt.ArrayLike, name: str, n_samples: int) -> np.ndarray:
    column = finite(values, [name], "input")
    if len(column) != n_samples:
        raise ChannelError(
            f"{name} has {len(column)} samples, the force {n_samples}",
            "Cut or resample them to one clock.",
        )
    return column


def finite(values: npt.ArrayLike, names: Sequence[str], what: str) -> np.ndarray:
    """A matrix of finite numbers, or an error that names channel and rows."""
    array = as_matrix(values, names, len(names), what).astype(float)
    for name, column in zip(names, array.T):
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise ChannelError(
                f"Channel {name} of the {what} is not finite in {rows_text(bad)}",
                "Give a number for every sample.",
            )
    return array


def courses_between(samples: np.ndarray, hold: str) -> np.ndarray:
    """Coefficients of the inputs between samples, in powers of the interval's share.

    Returns
    -------
    ndarray of shape (order + 1, n_samples - 1, n_inputs)
    """
    require_hold(hold)
    if hold == "linear":
        return np.stack([samples[:-1], np.diff(samples, axis=0)])
    if hold == "zero":
        return samples[None, :-1].copy()
    # not-a-knot: the ends are extrapolated by the nearest cubic, not made straight
    spline = CubicSpline(np.arange(len(samples)), samples)
    return np.ascontiguousarray(spline.c[::-1])
