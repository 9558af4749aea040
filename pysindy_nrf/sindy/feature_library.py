"""Force laws as PySINDy feature libraries."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from pysindy import AxesArray
from pysindy.feature_library.base import BaseFeatureLibrary
from pysindy.utils import comprehend_axes
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ..chain.layout import LawLayout, declared_laws, power_series_laws
from ..chain.sites import Site, dofs_of
from ..chain.structure import Chain, chain_of
from ..common import MAX_DOFS
from ..common.warn import warn_user
from ..equations.balances import blocks_of_segment
from ..exceptions import ChainError, ChannelError, DataQualityWarning, LawError
from ..laws.base import ForceLaw, subscript
from ..records.channels import checked, same_columns
from ..records.dataset import Segment
from ..selection.one_se_rule import Degree
from .state_columns import StateColumns

_INPUTS = ("balance", "state")
# Names that PySINDy gives to the columns of a model by themselves.
_UNNAMED = re.compile(r"[xu]\d+")
# A rate, drift or acceleration in the label of a term.
_MOTION = re.compile(r"\b([vsa])\b")

# One law or several.
Laws = ForceLaw | Sequence[ForceLaw]
# By site as the user names it: "storey 2", or 2.
LawsBySite = Mapping[Any, Sequence[ForceLaw]]


class LawColumns(AxesArray):
    """Features that know the library that made them; any copy or part forgets it."""

    made_by: ForceLawLibrary | None = None

    def __new__(cls, columns: np.ndarray, library: ForceLawLibrary) -> LawColumns:
        return super().__new__(cls, columns, comprehend_axes(columns))

    def __init__(self, columns: np.ndarray, library: ForceLawLibrary) -> None:
        self.made_by = library


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
        ``"balance"``: columns a_1..a_n, v_1..v_n, s_1..s_n (paper eq. 8). The features
        are a_1..a_n and the terms of every site, for :class:`ChainOptimizer`.
        ``"state"``: columns x_1..x_n, xdot_1..xdot_n (relative to the base) and u =
        F_1..F_n. The features are the terms and F, for
        :class:`StateSpaceChainOptimizer`. The velocity xdot_j of a DOF joins them where
        its storey has no term v_j.
    dt : float, optional
        Sampling step, s, for laws that need the time or remember the path (not with
        ``inputs="state"``).
    excited : int or sequence of int, optional
        With ``inputs="state"``: the DOFs on which the columns of u act, in their order;
        ``()`` is free vibration without any. There are features F_j of these DOFs
        alone; the others are known to be unforced. If None, u is one column a DOF, or,
        where the number of columns can only mean that and a warning says so, there is
        none.

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

    One shaker, on the roof of two storeys; x, xdot and u are what ps.SINDy passes on:

    >>> shaken = ForceLawLibrary(
    ...     [laws.Duffing()], inputs="state", excited=[2]
    ... ).fit(np.zeros((5, 5)))
    >>> shaken.get_feature_names()
    ['xdot1', 'xdot2', 's1', 's1^3', 's2', 's2^3', 'F2']
    """

    dt: float | None = None

    def __init__(
        self,
        laws: Mapping[Any, Laws] | Laws | None = None,
        chain: Chain | None = None,
        inputs: str = "balance",
        dt: float | None = None,
        excited: int | Sequence[int] | None = None,
    ) -> None:
        self.laws = laws
        self.chain = chain
        self.inputs = inputs
        self.dt = dt
        self.excited = excited

    def _laws(self, chain: Chain) -> LawsBySite:
        if self.laws is None:
            cure = "Pass laws={'storey 1': [...], ...}, or one list for every storey."
            raise LawError("The library has no laws", cure)
        if isinstance(self.laws, Mapping):
            return declared_laws(self.laws)
        return declared_laws(dict.fromkeys(chain.sites, self.laws))

    def fit(self, x: ArrayLike, y: object = None) -> Self:
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
            what = f"inputs={self.inputs!r} is unknown"
            raise ChannelError(what, "Choose 'balance' or 'state'.")

        first = x[0] if _is_list_of_records(x) else x
        width = self._checked(first, reset=True).shape[-1]
        columns = self._columns_of_u(width)
        self.layout_ = self.layout_of(columns.n_dof)
        self.excited_ = columns.excited
        if self.inputs == "state":
            _require_state_space(self.layout_)

        if self.inputs == "state":
            self.n_output_features_ = self.state_columns.n_columns
        else:
            self.n_output_features_ = columns.n_dof + self.layout_.n_terms
        return self

    @property
    def state_columns(self) -> StateColumns:
        """Features of a fitted library of ``inputs="state"``."""
        check_is_fitted(self)
        return StateColumns.of_laws(self.layout_, self.excited_)

    def layout_of(self, n_dof: int) -> LawLayout:
        """Which of the terms belong to which site.

        Parameters
        ----------
        n_dof : int
            Degrees of freedom of the data.
        """
        chain = chain_of(self.chain, n_dof)
        return LawLayout(chain, self._laws(chain))

    def _columns_of_u(self, width: int) -> _ForceColumns:
        """DOFs of the chain, and those with a column of u, in a table of some width."""
        n_dof = None if self.chain is None else chain_of(self.chain, 0).n_dof
        if self.inputs == "balance":
            if self.excited is not None:
                what = "excited= is for inputs='state'"
                raise ChannelError(what, "A balance has no column of u: pass F to fit.")
            columns = _ForceColumns.of_every_dof(width, n_dof)
            columns.require_width(width, "a, v, s of every DOF")
            return columns

        if self.excited is not None:
            columns = _ForceColumns.named(self.excited, width, n_dof)
        elif _is_free_vibration(width, n_dof):
            columns = _ForceColumns(width // 2, ())
        else:
            columns = _ForceColumns.of_every_dof(width, n_dof)
        needed = (
            "x, xdot, u = F of every DOF, or excited=[...], the DOFs that the columns"
            " of u act on"
        )
        columns.require_width(width, needed)
        return columns

    def transform(self, x: ArrayLike) -> LawColumns | list[LawColumns]:
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
        if _is_list_of_records(x):
            return [self._columns(item) for item in x]
        return self._columns(x)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        # a row that is masked or unmeasured has terms of NaN
        tags.input_tags.allow_nan = True
        return tags

    def _checked(self, x: ArrayLike, reset: bool) -> np.ndarray:
        # PySINDy's weak form asks for the columns by a single sample
        if isinstance(x, AxesArray) and x.ndim == 1:
            x = np.asarray(x)[None]
        if isinstance(x, np.ndarray) and x.ndim > 2:
            same_columns(self, x.shape[-1], None, reset)
            return np.asarray(x)
        return checked(self, x, reset=reset)

    def _columns(self, x: ArrayLike) -> LawColumns:
        """The features of one record."""
        matrix = self._checked(x, reset=False)
        leading_axes = matrix.shape[:-1]
        matrix = matrix.reshape(-1, matrix.shape[-1])
        n_dof = self.layout_.n_dof

        kind = np.result_type(matrix.dtype, np.float32)
        out = np.empty((len(matrix), self.n_output_features_), dtype=kind)
        first, second, third = np.split(matrix, [n_dof, 2 * n_dof], axis=1)
        if self.inputs == "balance":
            terms = slice(n_dof, None)
            out[:, :n_dof] = first
            segment = self._segment(first, second, third)
        else:
            columns = self.state_columns
            terms = columns.terms
            out[:, : terms.start] = second[:, [j - 1 for j in columns.velocities]]
            out[:, terms.stop :] = third
            v = np.diff(second, axis=1, prepend=0.0)
            s = np.diff(first, axis=1, prepend=0.0)
            segment = self._segment(np.zeros_like(first), v, s)

        start = 0
        # the columns that every fit sums up
        for block in blocks_of_segment(segment, self.layout_):
            stop = start + block.n_samples
            out[start:stop, terms] = block.terms.T
            start = stop
        return LawColumns(out.reshape(*leading_axes, -1), self)

    def _segment(self, a: np.ndarray, v: np.ndarray, s: np.ndarray) -> Segment:
        """The rows as one contiguous record."""
        rows = slice(0, len(s))
        t = None if self.dt is None else np.arange(len(s)) * self.dt
        return Segment("record", rows, a, v, s, np.zeros_like(s), t, valid=rows)

    def __add__(self, other: BaseFeatureLibrary) -> BaseFeatureLibrary:
        """Laws of both libraries at every site.

        With a library of another kind: PySINDy's concatenated columns.
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
            The user's names of the input columns: of a, v and s in the terms of a
            balance, of F in state space. PySINDy's own x0, x1, ..., u0 say nothing and
            count as no names, but x1, x4, x7 do: there the library is one of several in
            a ``GeneralizedLibrary``.

        Raises
        ------
        ChannelError
            If there are more or fewer names than columns.
        """
        check_is_fitted(self)
        n_dof = self.layout_.n_dof
        dofs = range(1, n_dof + 1)
        in_balance = self.inputs == "balance"
        heads = ("a", "v", "s") if in_balance else ("x", "xdot", "F")
        names = [[f"{head}{j}" for j in dofs] for head in heads]
        if not in_balance:
            names[2] = [f"F{j}" for j in self.excited_]

        if input_features is not None:
            users_names = list(map(str, input_features))
            n_columns = sum(map(len, names))
            if len(users_names) != n_columns:
                what = f"{len(users_names)} names for {n_columns} columns"
                cure = f"Give the names of {', '.join(heads)} of every DOF."
                raise ChannelError(what, cure)
            if not _are_defaults(users_names):
                ends = [n_dof, 2 * n_dof, None]
                starts = [0, n_dof, 2 * n_dof]
                names = [users_names[i:j] for i, j in zip(starts, ends)]

        if in_balance:
            return names[0] + term_names(self.layout_, *names)
        terms = term_names(self.layout_)
        velocities = [names[1][j - 1] for j in self.state_columns.velocities]
        return velocities + terms + names[2]

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
        """The same, as scikit-learn asks for them; see :meth:`get_feature_names`.

        Returns
        -------
        ndarray of str
        """
        return np.array(self.get_feature_names(), dtype=object)


@dataclass(frozen=True)
class _ForceColumns:
    """DOFs of a chain, and those on which the columns of u act, in their order."""

    n_dof: int
    excited: tuple[int, ...]

    @classmethod
    def of_every_dof(cls, width: int, n_dof: int | None) -> _ForceColumns:
        """One column a DOF; a third of all columns if the chain is not known."""
        count = max(width // 3, 1) if n_dof is None else n_dof
        return cls(count, tuple(range(1, count + 1)))

    @classmethod
    def named(
        cls, excited: int | Sequence[int], width: int, n_dof: int | None
    ) -> _ForceColumns:
        """The columns that a user names."""
        named = dofs_of("excited", excited, MAX_DOFS)
        count = max((width - len(named)) // 2, 1) if n_dof is None else n_dof
        dofs = dofs_of("excited", named, count)
        if len(set(dofs)) < len(dofs):
            what = f"excited={list(dofs)} names a DOF twice"
            raise ChainError(what, "Give each column of u a DOF of its own.")
        return cls(count, dofs)

    def require_width(self, width: int, columns: str) -> None:
        """Refuse a table of more or fewer columns."""
        needed = 2 * self.n_dof + len(self.excited)
        if width != needed:
            what = (
                f"The library got {width} columns (n_features = {width}), {needed} are"
                " needed"
            )
            raise ChannelError(what, f"Give {columns}.")


def _is_free_vibration(width: int, n_dof: int | None) -> bool:
    """Whether so many columns can only be x and xdot; says so if it is a guess."""
    pairs = 2 * (width // 2 if n_dof is None else n_dof)
    if width % 3 == 0 or not width == pairs > 0:
        return False
    if n_dof is None:
        warn_user(
            f"{width} columns are taken as x and xdot of {width // 2} DOFs in free"
            " vibration. Give excited=() if that is so, or excited=[...], the DOFs that"
            " the columns of u act on.",
            DataQualityWarning,
        )
    return True


def _require_state_space(layout: LawLayout) -> None:
    """Refuse laws that are no function of displacements and velocities."""
    for group in layout.laws.values():
        for law in group:
            if not (law.has_memory or law.uses_acceleration):
                continue
            kind = "that remembers the path"
            if not law.has_memory:
                kind = "of the acceleration"
            what = f"A law {kind} cannot stand in a state-space SINDy model"
            raise LawError(what, "Use NRFRegressor, or inputs='balance'.")


def _is_list_of_records(x: ArrayLike) -> TypeGuard[Sequence[ArrayLike]]:
    return isinstance(x, (list, tuple)) and len(x) > 0 and np.ndim(np.asarray(x[0])) > 1


def _are_defaults(names: Sequence[str]) -> bool:
    """Whether names are PySINDy's own of all columns: x0, x1, ..., u0, ..."""
    if not all(map(_UNNAMED.fullmatch, names)):
        return False
    states = [name for name in names if name.startswith("x")]
    return states == [f"x{i}" for i in range(len(states))]


def term_names(
    layout: LawLayout,
    accelerations: Sequence[str] = (),
    rates: Sequence[str] = (),
    drifts: Sequence[str] = (),
) -> list[str]:
    """Names of the terms of all sites, e.g. ``"v2^2 s2"``.

    Those of the storeys with the names of their motions, if these are given.
    """
    names = []
    for site in layout.acting:
        index = str(site.p)
        motions: dict[str, str] = {}
        if not site.is_storey:
            index = f"_{str(site).replace(' ', '').replace('-', '')}"
        elif rates:
            motions["a"] = accelerations[site.p - 1]
            motions["v"] = rates[site.p - 1]
            motions["s"] = drifts[site.p - 1]
        for label in layout.labels(site):
            if label == "1":
                names.append(f"1_{index}")
                continue
            names.append(_named(label, index, motions))
    return names


def _named(label: str, index: str, motions: Mapping[str, str]) -> str:
    """The label of a term with the names of its motions, or with the site's number."""
    if not motions:
        return subscript(label, index)
    named = _MOTION.sub(lambda match: motions[match[1]], label)
    return named if named != label else subscript(label, index)


class ForceLawLibrarySum(ForceLawLibrary):
    """Several libraries of one chain as one.

    ``InterstoryPolynomialLibrary() + ForceLawLibrary(...)`` makes it.
    """

    def __init__(self, libraries: list[ForceLawLibrary]) -> None:
        self.libraries = libraries

    @property
    def inputs(self) -> str:  # type: ignore[override]
        """That of the libraries added."""
        return self._shared("inputs")

    @property
    def chain(self) -> Chain | None:  # type: ignore[override]
        """That of the libraries added."""
        return self._shared("chain")

    @property
    def dt(self) -> float | None:  # type: ignore[override]
        """That of the libraries added, s."""
        return self._shared("dt")

    @property
    def excited(self) -> int | Sequence[int] | None:  # type: ignore[override]
        """Those of the libraries added."""
        return self._shared("excited")

    def _shared(self, name: str) -> Any:
        values = []
        for library in self.libraries:
            value = getattr(library, name)
            if value is not None:
                values.append(value)
        for value in values:
            if value != values[0]:
                what = f"The libraries added have {name}={values[0]!r} and another"
                raise LawError(what, f"Give all of them one {name}.")
        return values[0] if values else None

    def _laws(self, chain: Chain) -> LawsBySite:
        merged: dict[Site, list[ForceLaw]] = {}
        for library in self.libraries:
            for text, group in library._laws(chain).items():
                merged.setdefault(chain.site(text), []).extend(group)
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
        degree: Degree = 3,
        chain: Chain | None = None,
        orders: Mapping[Any, Degree] | None = None,
        inputs: str = "balance",
        excited: int | Sequence[int] | None = None,
    ) -> None:
        self.degree = degree
        self.chain = chain
        self.orders = orders
        self.inputs = inputs
        self.excited = excited

    def _laws(self, chain: Chain) -> LawsBySite:
        return power_series_laws(chain, self.degree, self.orders)
