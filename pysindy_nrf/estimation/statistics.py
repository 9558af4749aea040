"""What an interval can be asked of: numbers that follow from a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChainError, ChannelError
from ..regression.chain_model import ChainModel
from ..regression.layout import LawLayout
from ..regression.segments import SegmentSet

Statistic = Callable[[ChainModel], pd.Series]


def parameters_of(model: ChainModel, known_masses: Mapping[int, float] | None = None) -> pd.Series:
    """Masses and coefficients by name: ``m1``, ``storey 1: v``, ..."""
    values = {f"m{j + 1}": m for j, m in enumerate(model.masses) if j + 1 not in (known_masses or {})}
    for site, force in model.restoring_forces.items():
        if force.laws:
            values |= {f"{site}: {term}": c for term, c in force.coefficients.items()}
    return pd.Series(values, dtype=float)


def modes_of(model: ChainModel) -> pd.Series:
    """Frequencies (Hz) and damping ratios by name: ``frequency 1``, ``damping 1``, ..."""
    modes = model.modes()
    return pd.Series(
        {f"{key} {i}": modes.loc[i, key] for key in ("frequency", "damping") for i in modes.index}, dtype=float
    )


def energies_of(layout: LawLayout, data: SegmentSet) -> Statistic:
    """A function of a model: the energy (J) that every site dissipates along the data, ``energy of storey 1``, ..."""
    sites = [s for s in layout.acting if s.kind == "link"]
    work = {s: np.zeros(layout.counts[s]) for s in sites}
    stored = dict.fromkeys(sites, 0.0)
    for seg in data.segments:
        if seg.dt is None:
            raise ChannelError(
                "Energies need the sampling step",
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index.",
            )
        for site in sites:
            motion = seg.motion(site, seg.valid)
            work[site] += np.trapezoid(layout.columns(site, motion) * motion.v[:, None], dx=seg.dt, axis=0)
            stored[site] += 0.5 * float(motion.s[-1] ** 2 - motion.s[0] ** 2)

    def energies(model: ChainModel) -> pd.Series:
        out, coefficients = {}, model.coefficients
        for s in sites:
            stiffness = model.restoring_forces[s].linear_part()["k"]
            out[f"energy of {s}"] = float(coefficients[s] @ work[s] - stiffness * stored[s])
        return pd.Series(out, dtype=float)

    return energies


def statistic_of(
    of: Any, known_masses: Mapping[int, float], layout: LawLayout, data: SegmentSet | None = None
) -> Statistic:
    """The function of a model that a user asks for."""

    def parameters(m: ChainModel) -> pd.Series:
        return parameters_of(m, known_masses)

    if callable(of):
        return lambda m: pd.Series(of(m), dtype=float)
    if of == "parameters":
        return parameters
    if of == "masses":
        return lambda m: parameters(m)[lambda p: ~p.index.str.contains(":")]
    if of == "coefficients":
        return lambda m: parameters(m)[lambda p: p.index.str.contains(":")]
    if of == "modes":
        return modes_of
    if of == "energies":
        if data is None:
            raise ChannelError("Energies need the data", "Ask for their intervals before saving the model.")
        return energies_of(layout, data)
    raise ChainError(
        f"of={of!r} is unknown",
        "Give 'parameters', 'masses', 'coefficients', 'modes', 'energies', {site: (v, s)} or a function of a "
        "ChainModel.",
    )
