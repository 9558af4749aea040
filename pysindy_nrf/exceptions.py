"""Errors and warnings, all of one shape: what is wrong, where, and what to do about it.

Every error is also the built-in exception a caller would expect (``ValueError``,
``ImportError``), so that existing ``except`` clauses keep working.
"""

from __future__ import annotations

__all__ = [
    "NRFError",
    "ChannelError",
    "ChannelTypeError",
    "ChainError",
    "UnknownSiteError",
    "ExcitationError",
    "IdentifiabilityError",
    "LawError",
    "FileFormatError",
    "FileVersionError",
    "SimulationError",
    "MissingExtraError",
    "NRFWarning",
    "RankWarning",
    "BiasWarning",
    "DataQualityWarning",
    "ExtrapolationWarning",
]


def sentence(what: str, cure: str = "") -> str:
    """Join what is wrong and what to do into one message."""
    what = what.strip().rstrip(".")
    what += "" if what.endswith(("?", "!")) else "."
    return f"{what} {cure.strip()}" if cure else what


class NRFError(ValueError):
    """Base of every error this package raises on purpose.

    Parameters
    ----------
    what : str
        What is wrong, naming the channel, degree of freedom or parameter.
    cure : str
        What the user can do about it.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.exceptions import NRFError
    >>> try:
    ...     Chain(3, links=["link 3-7"])
    ... except NRFError as error:  # and every ValueError handler sees it
    ...     print(error.what, "|", error.cure)
    'link 7-3' is not a link of a chain with 3 DOFs | Links are 'link p-q' with 0 <= q < p <= 3.
    """

    def __init__(self, what: str, cure: str = "") -> None:
        self.what = what
        self.cure = cure
        super().__init__(sentence(what, cure))

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.what, self.cure)


class ChannelError(NRFError):
    """A measured channel cannot be used as it is (NaN, infinite, constant, missing, mis-shaped).

    Examples
    --------
    >>> from pysindy_nrf import Record
    >>> Record(displacement=[[0.001], [float("inf")]], fs=100.0)
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.ChannelError: Channel x1 of record 'record' is infinite in row 1. Repair or cut
    these rows.
    """


class ChannelTypeError(ChannelError, TypeError):
    """A channel holds things that are no numbers (also a ``TypeError``, as of ``float``).

    Examples
    --------
    >>> from pysindy_nrf import Record
    >>> Record(displacement=[[{}], [{}]], fs=100.0)
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.ChannelTypeError: Channel x1 of the displacement does not hold numbers (float()
    argument must be a string or a real number, not 'dict'). Convert it to float (decimal point, no text).
    """


class ChainError(NRFError):
    """A chain, a site or a parameter given per storey or DOF does not exist or contradicts another.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> Chain(0)
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.ChainError: n_dof=0 is not a number of masses. Give a whole number of at least 1.
    """


class UnknownSiteError(ChainError, KeyError):
    """A model is asked for the force of a site that it does not have (also a ``KeyError``, as of any mapping).

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.exceptions import UnknownSiteError
    >>> try:
    ...     datasets.demo_truth().restoring_forces["storey 9"]
    ... except KeyError as error:
    ...     print(type(error).__name__)
    UnknownSiteError
    """

    __str__ = Exception.__str__


class ExcitationError(ChannelError):
    """The forces given cannot scale the chain (all zero, unknown everywhere).

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> X = np.random.default_rng(0).standard_normal((500, 3))
    >>> NRFRegressor(degree=1).fit(X, np.zeros((500, 1)))
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.ExcitationError: No force is measured and no mass is known, so nothing scales the
    chain. Measure a force on one DOF, or give a mass: known_masses={dof: kg}; ratios to it then come out.
    """


class IdentifiabilityError(NRFError):
    """The data cannot determine what was asked, whatever their quality.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> t = np.arange(2000) / 200
    >>> s, v, a = np.sin(9 * t), 9 * np.cos(9 * t), -81 * np.sin(9 * t)  # one frequency: a and s are alike
    >>> NRFRegressor(degree=1).fit(np.column_stack([a, v, s]), (10 * a + 30 * v + 4e3 * s)[:, None])
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.IdentifiabilityError: balance of DOF 1: rank 2 of 3; m1, storey 1: s are linearly
    dependent on this excitation, so m1 cannot be told from the storey's stiffness. A steady harmonic
    excitation or too few samples do this; excite several frequencies, lower the degree, or give the mass in
    known_masses.
    """


class LawError(NRFError):
    """A force law was given wrong parameters or used where it cannot act.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.Dahl(sigma=-5e4, Fd=35.0)
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.LawError: Dahl: sigma=-50000 is not positive. Its unit is 1/m.
    """


class FileFormatError(NRFError):
    """A file could not be read as what it claims to be.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel
    >>> ChainModel.from_json('{"masses": [10.0]}')
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.FileFormatError: The JSON text does not hold a chain model. It needs "schema":
    "pysindy_nrf.ChainModel".
    """


class FileVersionError(FileFormatError):
    """A file was written by a later version of this package.

    Examples
    --------
    >>> import json
    >>> from pysindy_nrf import ChainModel, datasets
    >>> later = json.loads(datasets.demo_truth().to_json()) | {"version": 99}
    >>> ChainModel.from_json(json.dumps(later))
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.FileVersionError: The JSON text has version 99, this package reads up to 1. Update
    pysindy_nrf.
    """


class SimulationError(NRFError):
    """A free run diverged or was asked for something impossible.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws, simulate
    >>> unstable = ChainModel([1.0], {1: laws.PowerSeries(1, [-50.0, -1e4])})  # feeds energy in
    >>> simulate(unstable, np.ones((5000, 1)), 0.01)
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.SimulationError: The free run diverges at 1.83 s, at DOF 1. The model is unstable
    there (a softening or negative term beyond the range it was fitted in), or dt is too long for its
    stiffness: lower the force, the degree or dt.
    """


class MissingExtraError(ImportError):
    """An optional dependency is needed; the message names the extra that installs it.

    Parameters
    ----------
    package : str
        The package that is missing.
    extra : str
        The extra of ``pysindy_nrf`` that brings it.
    purpose : str
        What it is needed for.

    Examples
    --------
    >>> from pysindy_nrf.exceptions import MissingExtraError
    >>> print(MissingExtraError("h5py", "files", "Reading HDF5"))
    Reading HDF5 needs the package 'h5py'. Install it with: pip install 'pysindy_nrf[files]'
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra, self.purpose = package, extra, purpose
        super().__init__(
            f"{purpose} needs the package '{package}'. "
            f"Install it with: pip install 'pysindy_nrf[{extra}]'"
        )

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.package, self.extra, self.purpose)


class NRFWarning(UserWarning):
    """Base of every warning of this package.

    Parameters
    ----------
    what : str
        What looks wrong, naming the channel, degree of freedom or parameter; or the whole message.
    cure : str
        What the user can do about it.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf.exceptions import DataQualityWarning, NRFWarning
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("error")
    ...     warnings.simplefilter("always", NRFWarning)  # those of this package are kept, others are errors
    ...     warnings.warn(DataQualityWarning("a2 is clipped", "Leave it out."))
    >>> print(caught[0].message)
    a2 is clipped. Leave it out.
    """

    def __init__(self, what: str, cure: str = "") -> None:
        self.what = what
        self.cure = cure
        super().__init__(sentence(what, cure))

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.what, self.cure)


class RankWarning(NRFWarning):
    """Columns of a balance are linearly dependent on this excitation; some coefficients are arbitrary.

    Examples
    --------
    >>> import warnings
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor
    >>> t = np.arange(2000) / 200
    >>> s, v, a = np.sin(9 * t), 9 * np.cos(9 * t), -81 * np.sin(9 * t)  # one circle in the (v, s) plane
    >>> F = 10 * a + 30 * v + 4e3 * s
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = NRFRegressor(degree=3, known_masses={1: 10.0}).fit(np.column_stack([a, v, s]), F[:, None])
    >>> "RankWarning" in {w.category.__name__ for w in caught}
    True
    """


class BiasWarning(NRFWarning):
    """The model cannot hold what the data show; the estimates are likely biased.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = NRFRegressor(degree=1).fit(datasets.load_demo())  # storey 1 is cubic
    >>> caught[0].category.__name__, str(caught[0].message)[:28]
    ('BiasWarning', 'm1 = 9.33 kg is likely biase')
    """


class DataQualityWarning(NRFWarning):
    """A channel looks wrong (clipped, dead, delayed, noisy) but can still be used.

    Examples
    --------
    >>> import warnings
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor, Record, datasets
    >>> record = datasets.load_demo()
    >>> clipped = record.replace(displacement=np.clip(record.displacement, -2e-4, 2e-4))
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = clipped.to_features()
    >>> "DataQualityWarning" in {w.category.__name__ for w in caught}
    True
    """


class ExtrapolationWarning(NRFWarning):
    """A restoring force is asked for outside the visited (v, s) region.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> model = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     _ = model.force_intervals("storey 2", v=0.0, s=1.0)  # a drift of 1 m was never seen
    >>> caught[0].category.__name__
    'ExtrapolationWarning'
    """
