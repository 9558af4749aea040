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
    """Join what is wrong and what to do into one message.

    Parameters
    ----------
    what : str
        What is wrong, naming the channel, degree of freedom or parameter.
    cure : str
        What the user can do about it.

    Returns
    -------
    str
    """
    what = what.strip().rstrip(".")
    return f"{what}. {cure.strip()}" if cure else f"{what}."


class NRFError(ValueError):
    """Base of every error this package raises on purpose.

    Parameters
    ----------
    what : str
        What is wrong, naming the channel, degree of freedom or parameter.
    cure : str
        What the user can do about it.
    """

    def __init__(self, what: str, cure: str = "") -> None:
        self.what = what
        self.cure = cure
        super().__init__(sentence(what, cure))

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.what, self.cure)


class ChannelError(NRFError):
    """A measured channel cannot be used as it is (NaN, infinite, constant, missing, mis-shaped)."""


class ChannelTypeError(ChannelError, TypeError):
    """A channel holds things that are no numbers (also a ``TypeError``, as of ``float``)."""


class ChainError(NRFError):
    """A chain, a site or a parameter given per storey or DOF does not exist or contradicts another."""


class UnknownSiteError(ChainError, KeyError):
    """A model is asked for the force of a site that it does not have (also a ``KeyError``, as of any mapping)."""

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
    """A file was written by a later version of this package."""


class SimulationError(NRFError):
    """A free run diverged or was asked for something impossible."""


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
    """

    def __init__(self, what: str, cure: str = "") -> None:
        self.what = what
        self.cure = cure
        super().__init__(sentence(what, cure))

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.what, self.cure)


class RankWarning(NRFWarning):
    """Columns of a balance are linearly dependent on this excitation; some coefficients are arbitrary."""


class BiasWarning(NRFWarning):
    """The model cannot hold what the data show; the estimates are likely biased."""


class DataQualityWarning(NRFWarning):
    """A channel looks wrong (clipped, dead, delayed, noisy) but can still be used."""


class ExtrapolationWarning(NRFWarning):
    """A restoring force is asked for outside the visited (v, s) region."""
