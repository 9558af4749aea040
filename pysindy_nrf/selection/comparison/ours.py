"""This package in the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...estimation.regressor import NRFRegressor
from ...regression.chain_model import ChainModel
from ..sparsity import select_sparsity
from .data import Part, shares


class Ours:
    """NRFRegressor with some optimizer, or with the one of several that the held-out rule chooses."""

    finds_masses = True
    note = ""

    def __init__(self, degree: int, optimizer: Any) -> None:
        self.degree, self.optimizer = degree, optimizer
        self._chosen: dict[str, Any] = {"optimizer": optimizer}

    def work(self, data: Part) -> float:
        return 0.0

    def fit(self, data: Part) -> None:
        if isinstance(self.optimizer, Sequence):
            self._choose(data)
        self.model = NRFRegressor(degree=self.degree, dt=data.dt).set_params(**self._chosen).fit(data.X, data.F)

    def _choose(self, data: Part) -> None:
        """By the held-out rule, once: the second fit, which measures the memory, takes what the first has chosen."""
        found = select_sparsity(data.X, data.F, paths={"path": self.optimizer}, degree=self.degree, dt=data.dt)
        self.note = f"chosen: {found.table.index[found.table['chosen']][0][1]}"
        one = found.regressor("path").get_params(deep=False)
        self._chosen = {"optimizer": one["optimizer"], "laws": one["laws"]}
        self.optimizer = None

    @property
    def terms(self) -> int:
        laws = sum(int(np.count_nonzero(R.coefficients)) for R in self.model.restoring_forces_.values())
        return len(self.model.masses_) + laws

    def masses(self, data: Part) -> np.ndarray:
        return self.model.masses_

    def accelerations(self, data: Part) -> np.ndarray:
        return data.a + (data.F - self.model.predict(data.X)) / self.model.masses_

    def hits(self, data: Part, truth: ChainModel) -> tuple[float, float]:
        def kept(forces: Any) -> set[tuple[str, str]]:
            return {(str(site), label) for site, R in forces.items() for label, c in R.coefficients.items() if c}

        return shares(kept(self.model.restoring_forces_), kept(truth.restoring_forces))

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        gap = self.model.third_law_gap_
        return (float(gap.max()), "twice") if len(gap) else (0.0, "once")

    def run(self, data: Part, deadline: float) -> np.ndarray:
        return self.model.simulate(data.F, x0=data.x[0], v0=data.xdot[0]).displacement
