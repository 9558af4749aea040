"""From a chain model to a true ``ps.SINDy`` of its state space, and back."""

from __future__ import annotations

from typing import Any, Self

import numpy as np

from ..exceptions import ChainError, LawError
from ..mechanics.sites import Site
from .chain_model import ChainModel
from .feature_library import ForceLawLibrary
from .layout import LawLayout
from .optimizers import StateSpaceChainOptimizer


class IdentifiedChain(StateSpaceChainOptimizer):
    """An optimizer whose fit is done: it holds the coefficients of a chain model."""

    def __init__(self, model: ChainModel | None = None) -> None:
        super().__init__()
        self.model = model

    def fit(self, x_: Any, y: Any) -> Self:
        """Take the model's coefficients; the data are not used."""
        model = self.model
        if model is None:
            raise ChainError("There is no model to hold", "Pass model=.")
        layout, n, coefficients = LawLayout(model.chain, model.laws), model.n_dof, model.coefficients
        rows = np.zeros((n, layout.n_terms))
        for site in layout.acting:
            incidence = [site.incidence(j) for j in range(1, n + 1)]
            rows[:, layout.slices[site]] = np.outer(incidence, coefficients[site])
        coef = np.zeros((2 * n, 2 * n + layout.n_terms))
        coef[:n, :n] = np.eye(n)
        coef[n:, n : n + layout.n_terms] = -rows / model.masses[:, None]
        coef[n:, n + layout.n_terms :] = np.diag(1.0 / model.masses)
        self.masses_, self.n_features_in_, self._one_target = model.masses, coef.shape[1], False
        return self._finish(coef)


def to_sindy(model: ChainModel, dt: float = 1.0) -> Any:
    """A ``ps.SINDy`` of the state [x_1..x_n, xdot_1..xdot_n] (relative to the base) under u = F_1..F_n."""
    import pysindy as ps

    n = model.n_dof
    library = ForceLawLibrary({s: list(held) for s, held in model.laws.items()}, model.chain, inputs="state")
    sindy = ps.SINDy(feature_library=library, optimizer=IdentifiedChain(model))
    names = [f"{kind}{j}" for kind in ("x", "xdot", "F") for j in range(1, n + 1)]
    nothing = np.zeros((2, 2 * n))
    return sindy.fit(nothing, t=dt, x_dot=nothing, u=np.zeros((2, n)), feature_names=names)


def from_sindy(sindy: Any) -> ChainModel:
    """The chain model behind a ``ps.SINDy`` that was fitted with a library and an optimizer of this package."""
    library, optimizer = sindy.feature_library, sindy.optimizer
    if not isinstance(library, ForceLawLibrary):
        raise ChainError(
            f"{type(library).__name__} does not say which column acts at which storey",
            "Fit the SINDy with InterstoryPolynomialLibrary or ForceLawLibrary.",
        )
    if isinstance(getattr(optimizer, "model", None), ChainModel):
        return optimizer.model
    coef = np.asarray(sindy.coefficients(), dtype=float)
    layout, n = library.layout_, library.layout_.n_dof
    state = library.inputs == "state"
    masses = getattr(optimizer, "masses_", None)
    if masses is None:
        own = np.diag(coef[n:, n + layout.n_terms :]) if state else np.diag(coef[:, :n])
        gone = [f"m{j + 1}" for j in np.flatnonzero(own == 0)]
        if gone:
            raise ChainError(
                f"{', '.join(gone)} cannot be read off: the coefficient of the force or of the acceleration is zero",
                "Lower the optimizer's threshold, or use StateSpaceChainOptimizer or ChainOptimizer.",
            )
        masses = 1.0 / own if state else own
    rows = -masses[:, None] * coef[n:, n : n + layout.n_terms] if state else coef[:, n:]
    laws: dict[Site, list] = {}
    for site in layout.acting:
        values = site.incidence(site.p) * rows[site.p - 1, layout.slices[site]]
        laws[site] = []
        for law in layout.laws[site]:
            width = len(law.terms())
            if law.free_shape:
                raise LawError(f"{site}: {law!r} has shape parameters without values", "Give them to the library.")
            laws[site].append(law.with_values(coefficients=values[:width]))
            values = values[width:]
    return ChainModel(masses, laws, layout.chain)


__all__ = ["IdentifiedChain", "from_sindy", "to_sindy"]
