"""A chain model as a ``ps.SINDy`` of first-order equations, and back."""

from __future__ import annotations

from typing import Self

import numpy as np
import pysindy as ps

from ..chain.layout import LawLayout, with_coefficients
from ..chain.model import ChainModel, as_model
from ..exceptions import ChainError, LawError
from ..identification.regressor import NRFRegressor
from .feature_library import ForceLawLibrary
from .optimizers import StateSpaceChainOptimizer, equation_rows
from .state_columns import StateColumns

__all__ = ["from_sindy", "to_sindy"]


class IdentifiedChain(StateSpaceChainOptimizer):
    """An optimizer whose fit is done: it has the coefficients of a chain model."""

    def __init__(self, model: ChainModel) -> None:
        super().__init__()
        self.model = model

    def fit(self, x_: object, y: object, sample_weight: object = None) -> Self:
        """Take the model's coefficients; the data are not used."""
        layout = LawLayout(self.model.chain, self.model.laws)
        self.masses_ = self.model.masses
        self._one_target = False
        equations = equation_rows(layout, self.model.coefficients)
        columns = StateColumns.of_laws(layout, range(1, layout.n_dof + 1))
        self._finish(columns.rows(equations, self.masses_))
        self.n_features_in_ = self.coef_.shape[1]
        return self


def to_sindy(model: ChainModel | NRFRegressor, dt: float | None = None) -> ps.SINDy:
    """A chain model as a fitted ``ps.SINDy``.

    Its state is [x_1..x_n, xdot_1..xdot_n] relative to the base, its inputs u are the
    forces F_1..F_n.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor
    dt : float, optional
        Sampling step, s, that SINDy notes; the regressor's own or 1 s if None.

    Returns
    -------
    pysindy.SINDy

    Raises
    ------
    LawError
        If a law remembers the path or reads the acceleration.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.sindy import from_sindy, to_sindy
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> to_sindy(model).print()
    (x1)' = 1.000 v1
    (xdot1)' = -10.000 v1 + -10000.000 s1 + 0.100 F1
    >>> from_sindy(to_sindy(model)) == model
    True
    """
    chain_model = as_model(model)
    n_dof = chain_model.n_dof
    step = getattr(model, "dt", None) if dt is None else dt

    laws = {site: list(group) for site, group in chain_model.laws.items()}
    library = ForceLawLibrary(laws, chain_model.chain, inputs="state")
    sindy = ps.SINDy(feature_library=library, optimizer=IdentifiedChain(chain_model))

    names: list[str] = []
    for kind in ("x", "xdot", "F"):
        names.extend(f"{kind}{j}" for j in range(1, n_dof + 1))
    nothing = np.zeros((2, 2 * n_dof))
    return sindy.fit(
        nothing,
        t=1.0 if step is None else step,
        x_dot=nothing,
        u=np.zeros((2, n_dof)),
        feature_names=names,
    )


def from_sindy(sindy: ps.SINDy) -> ChainModel:
    """The chain behind a ``ps.SINDy`` with a library and an optimizer of this package.

    Parameters
    ----------
    sindy : pysindy.SINDy
        Fitted.

    Returns
    -------
    ChainModel

    Raises
    ------
    ChainError
        If its library is not of this package, or a mass cannot be read off.
    LawError
        If a law has shape parameters without values.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.sindy import from_sindy, to_sindy
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> from_sindy(to_sindy(model)).masses
    array([10.])
    """
    library, optimizer = sindy.feature_library, sindy.optimizer
    if not isinstance(library, ForceLawLibrary):
        what = (
            f"{type(library).__name__} does not say which column acts at which storey"
        )
        cure = "Fit the SINDy with InterstoryPolynomialLibrary or ForceLawLibrary."
        raise ChainError(what, cure)
    if isinstance(optimizer, IdentifiedChain):
        return optimizer.model

    layout = library.layout_
    for site, group in layout.laws.items():
        for law in group:
            if law.free_shape:
                what = f"{site}: {law!r} has shape parameters without values"
                raise LawError(what, "Give them to the library.")

    coefficients = np.asarray(sindy.coefficients(), dtype=float)
    masses = getattr(optimizer, "masses_", None)
    if masses is None:
        masses = _masses_of(library, coefficients)
    if library.inputs == "state":
        accelerations = coefficients[layout.n_dof :, library.state_columns.terms]
        rows = -masses[:, None] * accelerations
    else:
        rows = coefficients[:, layout.n_dof :]

    values = {}
    for site in layout.acting:
        entering = rows[site.p - 1, layout.slices[site]]
        values[site] = site.incidence(site.p) * entering
    return ChainModel(masses, with_coefficients(layout.laws, values), layout.chain)


def _masses_of(library: ForceLawLibrary, coefficients: np.ndarray) -> np.ndarray:
    """Masses from the coefficients of the forces (1/m) or of the accelerations (m)."""
    n_dof = library.layout_.n_dof
    in_state_space = library.inputs == "state"
    diagonal = np.diag(coefficients[:, :n_dof])
    if in_state_space:
        columns = library.state_columns
        diagonal = np.zeros(n_dof)
        for i, dof in enumerate(columns.forces):
            diagonal[dof - 1] = coefficients[n_dof + dof - 1, columns.terms.stop + i]

    lost = [f"m{j + 1}" for j in np.flatnonzero(diagonal == 0)]
    if lost:
        what = (
            f"{', '.join(lost)} cannot be read off: the coefficient of the force or of"
            " the acceleration is zero"
        )
        cure = (
            "Lower the optimizer's threshold, or use StateSpaceChainOptimizer or"
            " ChainOptimizer."
        )
        raise ChainError(what, cure)
    return 1.0 / diagonal if in_state_space else diagonal
