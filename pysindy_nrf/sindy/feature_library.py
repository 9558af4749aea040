"""Force laws as PySINDy feature libraries, and a chain model as a ``ps.SINDy`` of
first-order equations.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from pysindy import AxesArray
from pysindy.feature_library.base import BaseFeatureLibrary
from pysindy.utils import comprehend_axes
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ..chain.layout import (
    LawLayout,
    declared_laws,
    power_series_laws,
    with_coefficients,
)
from ..chain.model import ChainModel
from ..chain.sites import dofs_of
from ..chain.structure import Chain, chain_of
from ..common import MOST_DOFS
from ..equations.balances import blocks_of_segment
from ..exceptions import ChainError, ChannelError, DataQualityWarning, LawError
from ..laws.base import ForceLaw, subscript
from ..records.channels import checked, same_columns
from ..records.dataset import Segment
from .optimizers import StateSpaceChainOptimizer, balance_rows

_INPUTS = ("balance", "state")
_UNNAMED = re.compile(r"[xu]\d+")


class ForceLawLibrary(BaseFeatureLibrary):
    """Force laws at the sites of a chain as one PySINDy feature library.

    Parameters
    ----------
    laws : mapping of str to ForceLaw or sequence of ForceLaw, or one sequence for every
    storey
        By site.
    chain : Chain, optional
        Found from the number of columns if None.
    inputs : {"balance", "state"}
        ``"balance"``: columns a_1..a_n, v_1..v_n, s_1..s_n (paper eq. 8); the features
        are a_1..a_n and the terms of every site, to be fitted to the forces by
        :class:`ChainOptimizer`. ``"state"``: columns x_1..x_n, xdot_1..xdot_n (relative
        to the base) and u = F_1..F_n; the features are xdot, the terms and F, for
        :class:`StateSpaceChainOptimizer`.
    dt : float, optional
        Sampling step, s, for laws that need the time or remember the path (not with
        ``inputs="state"``).
    excited : int or sequence of int, optional
        With ``inputs="state"``: the DOFs on which the columns of u act, in their order;
        ``()`` is free vibration without any. The features F_j of the others are zero:
        known to be unforced. If None, u is one column a DOF, or, where the number of
        columns can only mean that and a warning says so, there is none.

    Attributes
    ----------
    n_features_in_, n_output_features_ : int
    layout_ : LawLayout
    excited_ : tuple of int
        DOFs that have a column of u; all of them with ``inputs="balance"``, which has
        none.

    Notes
    -----
    ``+`` of two such libraries holds the laws of both at every site and is again one
    for a chain. ``+`` with any other PySINDy library, and ``*``, are PySINDy's own:
    plain columns. They belong to no storey, so fit them with a plain optimizer
    (``ps.STLSQ``).

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ForceLawLibrary, laws
    >>> library = ForceLawLibrary([laws.LinearViscous(), laws.Duffing()])
    >>> (library + ForceLawLibrary({"storey 2": laws.CoulombFriction()})).fit(
    ...     np.zeros((5, 6))
    ... ).get_feature_names()
    ['a1', 'a2', 'v1', 's1', 's1^3', 'v2', 's2', 's2^3', 'sgn(v2)']
    >>> # one shaker, on the roof of two storeys; x, xdot and u are what ps.SINDy passes on
    >>> shaken = ForceLawLibrary(
    ...     [laws.Duffing()], inputs="state", excited=[2]
    ... ).fit(np.zeros((5, 5)))
    >>> shaken.get_feature_names()
    ['xdot1', 'xdot2', 's1', 's1^3', 's2', 's2^3', 'F1', 'F2']
    """

    dt: float | None = None

    def __init__(
        self,
        laws: Any = None,
        chain: Chain | None = None,
        inputs: str = "balance",
        dt: float | None = None,
        excited: int | Sequence[int] | None = None,
    ) -> None:
        self.laws, self.chain, self.inputs, self.dt, self.excited = (
            laws,
            chain,
            inputs,
            dt,
            excited,
        )

    def _laws(self, chain: Chain) -> Mapping[Any, Sequence[ForceLaw]]:
        if self.laws is None:
            cure = "Pass laws={'storey 1': [...], ...}, or one list for every storey."
            raise LawError("The library has no laws", cure)
        return declared_laws(
            self.laws
            if isinstance(self.laws, Mapping)
            else dict.fromkeys(chain.sites, self.laws)
        )

    def fit(self, x: Any, y: Any = None) -> Any:
        """Count the features.

        Parameters
        ----------
        x : array-like of shape (n_samples, n_columns), or list of them
        y : ignored

        Returns
        -------
        self

        Raises
        ------
        ChannelError, LawError
            If ``inputs`` is unknown, the columns are not those of a chain, or with
            ``inputs="state"`` a law remembers the path or reads the acceleration.
        """
        if self.inputs not in _INPUTS:
            raise ChannelError(
                f"inputs={self.inputs!r} is unknown", "Choose 'balance' or 'state'."
            )
        first = x[0] if _is_list_of_records(x) else x
        n, self.excited_ = self._meaning(self._checked(first, reset=True).shape[-1])
        self.layout_ = self._layout_of(n)
        for law in (
            law
            for group in self.layout_.laws.values()
            for law in group
            if self.inputs == "state"
        ):
            if law.has_memory or law.uses_acceleration:
                what = (
                    "that remembers the path"
                    if law.has_memory
                    else "of the acceleration"
                )
                cure = "Use NRFRegressor, or inputs='balance'."
                raise LawError(
                    f"A law {what} cannot stand in a state-space SINDy model", cure
                )
        self.n_output_features_ = self.layout_.n_terms + (
            n if self.inputs == "balance" else 2 * n
        )
        return self

    def _layout_of(self, n_dof: int) -> LawLayout:
        """Which of the terms belong to which site."""
        chain = chain_of(self.chain, n_dof)
        return LawLayout(chain, self._laws(chain))

    def _meaning(self, width: int) -> tuple[int, tuple[int, ...]]:
        """Number of DOFs, and those with a column of u, of a table of so many
        columns.
        """
        n = None if self.chain is None else chain_of(self.chain, 0).n_dof
        state, excited = self.inputs == "state", self.excited
        if excited is not None and not state:
            raise ChannelError(
                "excited= is for inputs='state'",
                "A balance has no column of u: pass F to fit.",
            )
        if (
            state
            and excited is None
            and width % 3
            and width == 2 * (n or width // 2) > 0
        ):
            excited = ()
            if n is None:
                warnings.warn(
                    f"{width} columns are taken as x and xdot of {width // 2} DOFs in"
                    " free vibration. Give excited=() if that is so, or excited=[...],"
                    " the DOFs that the columns of u act on.",
                    DataQualityWarning,
                    stacklevel=4,
                )
        if excited is None:
            n = max(width // 3, 1) if n is None else n
            acting, needed = tuple(range(1, n + 1)), 3 * n
        else:
            named = dofs_of("excited", excited, MOST_DOFS)
            n = max((width - len(named)) // 2, 1) if n is None else n
            acting, needed = dofs_of("excited", named, n), 2 * n + len(named)
        if width != needed:
            what = (
                "x, xdot, u = F of every DOF, or excited=[...], the DOFs that the"
                " columns of u act on"
            )
            cure = f"Give {what if state else 'a, v, s of every DOF'}."
            raise ChannelError(
                f"The library got {width} columns (n_features = {width}), {needed} are"
                " needed",
                cure,
            )
        if len(set(acting)) < len(acting):
            raise ChainError(
                f"excited={list(acting)} names a DOF twice",
                "Give each column of u a DOF of its own.",
            )
        return n, acting

    def transform(self, x: Any) -> Any:
        """Columns of the balances.

        Parameters
        ----------
        x : array-like of shape (n_samples, n_columns), or list of them
            Each array is one contiguous record.

        Returns
        -------
        AxesArray of shape (n_samples, n_output_features), or list of them
        """
        check_is_fitted(self)
        return (
            [self._columns(item) for item in x]
            if _is_list_of_records(x)
            else self._columns(x)
        )

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = (
            True  # terms of a row: those of a NaN row, masked or unmeasured, are NaN
        )
        return tags

    def _checked(self, x: Any, reset: bool) -> np.ndarray:
        if (
            isinstance(x, AxesArray) and x.ndim == 1
        ):  # one sample, by which the weak form asks for the columns
            x = np.asarray(x)[None]
        if getattr(x, "ndim", 2) > 2:  # PySINDy's leading axes
            same_columns(self, x.shape[-1], None, reset)
            return np.asarray(x)
        return checked(self, x, reset=reset)

    def _columns(self, x: Any) -> Any:
        x = self._checked(x, reset=False)
        lead = x.shape[:-1]
        x = x.reshape(-1, x.shape[-1])
        n = self.layout_.n_dof
        first, second, third = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
        if self.inputs == "balance":
            a, v, s, head = first, second, third, first
        else:
            a, head = np.zeros_like(first), second
            v, s = (np.diff(y, axis=1, prepend=0.0) for y in (second, first))
        rows = slice(0, len(x))
        t = None if self.dt is None else np.arange(len(x)) * self.dt
        segment = Segment("record", rows, a, v, s, np.zeros_like(s), t, valid=rows)
        out = np.empty(
            (len(x), self.n_output_features_), dtype=np.result_type(x.dtype, np.float32)
        )
        out[:, :n], at = head, 0
        for block in blocks_of_segment(
            segment, self.layout_
        ):  # the columns that every fit sums up
            out[at : at + block.n_samples, n : n + self.layout_.n_terms] = block.terms.T
            at += block.n_samples
        if self.inputs == "state":
            out[:, n + self.layout_.n_terms :] = 0.0
            out[:, [n + self.layout_.n_terms + j - 1 for j in self.excited_]] = third
        out = out.reshape(*lead, -1)
        out = AxesArray(out, comprehend_axes(out))
        out.made_by = self  # for ChainOptimizer; any copy or part loses it
        return out

    def __add__(self, other: Any) -> Any:
        """Laws of both libraries at every site; PySINDy's concatenated columns with a
        library of another kind.
        """
        if isinstance(other, ForceLawLibrary):
            return ForceLawLibrarySum([self, other])
        return super().__add__(other)

    def get_feature_names(
        self, input_features: Sequence[str] | None = None
    ) -> list[str]:
        """Names of the features, e.g. ``"v2^2 s2"``.

        Parameters
        ----------
        input_features : sequence of str, optional
            The user's names of the input columns, for the columns that are passed
            through: accelerations, or velocities and forces. PySINDy's own x0, x1, ...,
            u0 say nothing and count as no names.

        Raises
        ------
        ChannelError
            If there are more or fewer names than columns.
        """
        check_is_fitted(self)
        n = self.layout_.n_dof
        heads = ("a", "v", "s") if self.inputs == "balance" else ("x", "xdot", "F")
        names = [f"{head}{j}" for head in heads for j in range(1, n + 1)]
        inputs = [
            *range(2 * n),
            *(2 * n + j - 1 for j in self.excited_),
        ]  # which of them are columns of the input
        if input_features is not None:
            given = [str(name) for name in input_features]
            if len(given) != len(inputs):
                cure = f"Give the names of {', '.join(heads)} of every DOF."
                raise ChannelError(
                    f"{len(given)} names for {len(inputs)} columns", cure
                )
            if not all(_UNNAMED.fullmatch(name) for name in given):
                for i, name in zip(inputs, given):
                    names[i] = name
        through = (
            (names[:n], [])
            if self.inputs == "balance"
            else (names[n : 2 * n], names[2 * n :])
        )
        return [*through[0], *term_names(self.layout_), *through[1]]

    def get_feature_names_out(self, input_features: Any = None) -> np.ndarray:
        """The same, as scikit-learn asks for them; see :meth:`get_feature_names`.

        Returns
        -------
        ndarray of str
        """
        return np.array(self.get_feature_names(), dtype=object)


def _is_list_of_records(x: Any) -> bool:
    return isinstance(x, (list, tuple)) and len(x) > 0 and np.ndim(np.asarray(x[0])) > 1


def term_names(layout: LawLayout) -> list[str]:
    """Names of the terms of all sites, e.g. ``"v2^2 s2"``."""
    names = []
    for site in layout.acting:
        index = (
            str(site.p)
            if site.is_storey
            else f"_{str(site).replace(' ', '').replace('-', '')}"
        )
        names += [
            subscript(label, index) if label != "1" else f"1_{index}"
            for label in layout.labels(site)
        ]
    return names


class ForceLawLibrarySum(ForceLawLibrary):
    """Several libraries of one chain as one: ``InterstoryPolynomialLibrary() +
    ForceLawLibrary(...)``.
    """

    def __init__(self, libraries: list[ForceLawLibrary]) -> None:
        self.libraries = libraries

    def _shared(self, name: str) -> Any:
        values = [
            value for lib in self.libraries if (value := getattr(lib, name)) is not None
        ]
        if any(value != values[0] for value in values):
            cure = f"Give all of them one {name}."
            raise LawError(
                f"The libraries added have {name}={values[0]!r} and another", cure
            )
        return values[0] if values else None

    # read-only: those of the libraries added
    inputs, chain, dt, excited = (
        property(lambda self, name=name: self._shared(name))  # type: ignore[misc]
        for name in ("inputs", "chain", "dt", "excited")
    )

    def _laws(self, chain: Chain) -> Mapping[Any, Sequence[ForceLaw]]:
        merged: dict[Any, list[ForceLaw]] = {}
        for library in self.libraries:
            for text, held in library._laws(chain).items():
                merged.setdefault(chain.site(text), []).extend(held)
        return merged


class InterstoryPolynomialLibrary(ForceLawLibrary):
    """Inter-storey terms v^h s^j of the paper's eq. (2) as a PySINDy feature library.

    Parameters
    ----------
    degree : int or (int, int)
        Total degree h + j (eq. 9), or the box (k, q): h <= k, j <= q.
    orders : mapping of str to int or (int, int), optional
        Other orders at some sites.
    chain, inputs, excited
        See :class:`ForceLawLibrary`.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import InterstoryPolynomialLibrary
    >>> InterstoryPolynomialLibrary(degree=2).fit(
    ...     np.zeros((5, 3))
    ... ).get_feature_names()
    ['a1', 'v1', 's1', 'v1^2', 'v1 s1', 's1^2']
    """

    def __init__(
        self,
        degree: Any = 3,
        chain: Chain | None = None,
        orders: Mapping[Any, Any] | None = None,
        inputs: str = "balance",
        excited: int | Sequence[int] | None = None,
    ) -> None:
        self.degree, self.chain, self.orders, self.inputs, self.excited = (
            degree,
            chain,
            orders,
            inputs,
            excited,
        )

    def _laws(self, chain: Chain) -> Mapping[Any, Sequence[ForceLaw]]:
        return power_series_laws(chain, self.degree, self.orders)


class IdentifiedChain(StateSpaceChainOptimizer):
    """An optimizer whose fit is done: it holds the coefficients of a chain model."""

    def __init__(self, model: ChainModel) -> None:
        super().__init__()
        self.model = model

    def fit(self, x_: Any, y: Any, sample_weight: Any = None) -> Self:
        """Take the model's coefficients; the data are not used."""
        layout = LawLayout(self.model.chain, self.model.laws)
        self.masses_, self._one_target = self.model.masses, False
        self._finish(self._state_rows(balance_rows(layout, self.model.coefficients)))
        self.n_features_in_ = self.coef_.shape[1]
        return self


def to_sindy(model: ChainModel, dt: float = 1.0) -> Any:
    """A ``ps.SINDy`` of the state [x_1..x_n, xdot_1..xdot_n] (relative to the base)
    under u = F_1..F_n.
    """
    import pysindy as ps

    n = model.n_dof
    library = ForceLawLibrary(
        {s: list(held) for s, held in model.laws.items()}, model.chain, inputs="state"
    )
    sindy = ps.SINDy(feature_library=library, optimizer=IdentifiedChain(model))
    names = [f"{kind}{j}" for kind in ("x", "xdot", "F") for j in range(1, n + 1)]
    nothing = np.zeros((2, 2 * n))
    return sindy.fit(
        nothing, t=dt, x_dot=nothing, u=np.zeros((2, n)), feature_names=names
    )


def from_sindy(sindy: Any) -> ChainModel:
    """The chain model behind a ``ps.SINDy`` that was fitted with a library and an
    optimizer of this package.
    """
    library, optimizer = sindy.feature_library, sindy.optimizer
    if not isinstance(library, ForceLawLibrary):
        cure = "Fit the SINDy with InterstoryPolynomialLibrary or ForceLawLibrary."
        raise ChainError(
            f"{type(library).__name__} does not say which column acts at which storey",
            cure,
        )
    if isinstance(getattr(optimizer, "model", None), ChainModel):
        return optimizer.model
    coef = np.asarray(sindy.coefficients(), dtype=float)
    layout, n = library.layout_, library.layout_.n_dof
    state = library.inputs == "state"
    masses = getattr(optimizer, "masses_", None)
    if masses is None:
        own = np.diag(coef[n:, n + layout.n_terms :]) if state else np.diag(coef[:, :n])
        if gone := [f"m{j + 1}" for j in np.flatnonzero(own == 0)]:
            what = (
                f"{', '.join(gone)} cannot be read off: the coefficient of the force or"
                " of the acceleration is zero"
            )
            cure = (
                "Lower the optimizer's threshold, or use StateSpaceChainOptimizer or"
                " ChainOptimizer."
            )
            raise ChainError(what, cure)
        masses = 1.0 / own if state else own
    rows = -masses[:, None] * coef[n:, n : n + layout.n_terms] if state else coef[:, n:]
    if free := [
        f"{site}: {law!r}"
        for site, held in layout.laws.items()
        for law in held
        if law.free_shape
    ]:
        raise LawError(
            f"{free[0]} has shape parameters without values",
            "Give them to the library.",
        )
    values = {
        s: s.incidence(s.p) * rows[s.p - 1, layout.slices[s]] for s in layout.acting
    }
    return ChainModel(masses, with_coefficients(layout.laws, values), layout.chain)
