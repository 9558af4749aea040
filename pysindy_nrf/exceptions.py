"""Errors and warnings: what is wrong, where, and what to do about it.

Each is also the built-in exception that one expects.
"""

__all__ = [
    "NRFError",
    "FileVersionError",
    "MissingExtraError",
    "NRFWarning",
    "BiasWarning",
    "DataQualityWarning",
    "ExtrapolationWarning",
    "SensitivityWarning",
]


def sentence(what: str, cure: str = "") -> str:
    """Join what is wrong and what to do into one message."""
    text = what.strip().rstrip(".")
    if not text.endswith(("?", "!")):
        text += "."
    return f"{text} {cure.strip()}" if cure else text


class _WhatAndCure(Exception):
    """What is wrong, and what the user can do about it."""

    def __init__(self, what: str, cure: str = "") -> None:
        self.what = what
        self.cure = cure
        super().__init__(sentence(what, cure))

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        return type(self), (self.what, self.cure)


class NRFError(_WhatAndCure, ValueError):
    """Base of every error this package raises on purpose.

    Parameters
    ----------
    what : str
        What is wrong, naming the channel, degree of freedom or parameter.
    cure : str
        What the user can do about it.
    argument : str
        The argument that the cure asks for, such as ``"known_masses"``.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.exceptions import NRFError
    >>> try:
    ...     Chain(3, links=["link 3-7"])
    ... except NRFError as error:  # and every ValueError handler sees it
    ...     print(error.what, "|", error.cure)
    'link 7-3' is not a link of a chain with 3 DOFs | Links are 'link p-q' with 0 <= q <
    p <= 3.
    """

    def __init__(self, what: str, cure: str = "", argument: str = "") -> None:
        super().__init__(what, cure)
        self.argument = argument

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        return type(self), (self.what, self.cure, self.argument)


class ChannelError(NRFError):
    """A measured channel is NaN, infinite, constant, missing or mis-shaped."""


class ChannelTypeError(ChannelError, TypeError):
    """A channel contains what is no number (also a ``TypeError``)."""


class ChainError(NRFError):
    """A chain, a site or a parameter of a DOF does not exist or contradicts another."""


class UnknownSiteError(ChainError, KeyError):
    """A model has no such site (also a ``KeyError``, as for any mapping)."""

    __str__ = Exception.__str__


class ExcitationError(ChannelError):
    """The forces given cannot scale the chain (all zero, unknown everywhere)."""


class IdentifiabilityError(NRFError):
    """The data cannot determine what was asked, whatever their quality."""


class LawError(NRFError):
    """A force law was given wrong parameters or used where it cannot act."""


class FileFormatError(NRFError):
    """A file could not be read as what it claims to be."""


class FileVersionError(FileFormatError):
    """A file was written by a later version of this package.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, datasets
    >>> text = (
    ...     datasets.demo_truth()
    ...     .to_json()
    ...     .replace('"version": 1', '"version": 99')
    ... )
    >>> ChainModel.from_json(text)
    Traceback (most recent call last):
    ...
    pysindy_nrf.exceptions.FileVersionError: The JSON text has version 99, this package
    reads up to 1. Update pysindy_nrf.
    """


class SimulationError(NRFError):
    """A free run came to no end or was asked for something impossible."""


class DivergenceError(SimulationError):
    """A free run grew beyond its limit."""


class MissingExtraError(ImportError):
    """An optional dependency is needed; the message names the extra that installs it.

    Parameters
    ----------
    package, extra, purpose : str
        The package that is missing, the extra of ``pysindy_nrf`` that brings it, and
        what it is needed for.

    Examples
    --------
    >>> from pysindy_nrf.exceptions import MissingExtraError
    >>> print(MissingExtraError("h5py", "files", "Reading HDF5"))
    Reading HDF5 needs the package 'h5py'. Install it with: pip install
    'pysindy_nrf[files]'
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package = package
        self.extra = extra
        self.purpose = purpose
        super().__init__(
            f"{purpose} needs the package '{package}'. Install it with: pip install"
            f" 'pysindy_nrf[{extra}]'"
        )

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.package, self.extra, self.purpose)


class NRFWarning(_WhatAndCure, UserWarning):
    """Base of every warning of this package.

    Parameters
    ----------
    what, cure : str
        As for :class:`NRFError`; ``what`` may be the entire message.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf.exceptions import DataQualityWarning, NRFWarning
    >>> with warnings.catch_warnings(
    ...     record=True, category=NRFWarning, action="always"
    ... ) as caught:
    ...     warnings.warn(DataQualityWarning("a2 is clipped", "Leave it out."))
    >>> print(caught[0].message)
    a2 is clipped. Leave it out.
    """


class RankWarning(NRFWarning):
    """Columns of a balance are linearly dependent; some coefficients are arbitrary."""


class BiasWarning(NRFWarning):
    """The model lacks what the data show; the estimates are likely biased.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> with warnings.catch_warnings(record=True, action="always") as caught:
    ...     _ = NRFRegressor(degree=1).fit(
    ...         datasets.load_demo()
    ...     )  # storey 1 is cubic
    >>> caught[0].category.__name__
    'BiasWarning'
    """


class DataQualityWarning(NRFWarning):
    """A channel looks wrong (clipped, dead, delayed, noisy) but can still be used.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import datasets
    >>> record = datasets.load_demo()
    >>> clipped = record.replace(
    ...     displacement=record.displacement.clip(-2e-4, 2e-4)
    ... )
    >>> with warnings.catch_warnings(record=True, action="always") as caught:
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
    >>> with warnings.catch_warnings(record=True, action="always") as caught:
    ...     _ = model.force_intervals(
    ...         "storey 2", v=0.0, s=1.0
    ...     )  # a drift of 1 m was never seen
    >>> caught[0].category.__name__
    'ExtrapolationWarning'
    """


class SensitivityWarning(NRFWarning):
    """Errors of the parameters move a free run so far that it predicts little.

    Examples
    --------
    >>> from pysindy_nrf.exceptions import SensitivityWarning
    >>> print(
    ...     SensitivityWarning("The free run is sensitive", "Compare spectra.")
    ... )
    The free run is sensitive. Compare spectra.
    """
