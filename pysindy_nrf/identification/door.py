"""The door: what form the data have, which method fits them, what it does not use.

:func:`choose_method` is the only place where a method is chosen, and
:func:`refuse_unused` the only one where arguments without effect are refused.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from ..exceptions import ChainError, ChannelError
from ..records.channels import is_dask
from ..records.dataset import Dataset
from ..records.files.frequency_response import FrequencyResponse
from ..records.input_arrays import lacks_motion, records_in
from .channel_fit import ChannelFit
from .frequency_response import FrequencyResponseFit
from .methods import (
    EVERY_FLOOR,
    RECORDS,
    RESPONSES,
    WHOLE_RECORDS,
    IdentificationMethod,
    InstrumentalVariables,
    LeastSquares,
    LeastSquaresOrInstruments,
    OutputError,
)


@dataclass(frozen=True)
class InputForm:
    """A form in which data come.

    Attributes
    ----------
    name : str
    reason : str
        Why another argument has no effect.
    provides : frozenset of str
        What methods may require.
    uses : frozenset of str
        Arguments that say what the form itself does not.
    """

    name: str
    reason: str
    provides: frozenset[str]
    uses: frozenset[str] = frozenset()


_BESIDE_ARRAYS = frozenset(
    ("F", "record", "time", "base_acceleration", "covariates", "dt", "coordinates")
)
# Arguments whose use depends on the form of the data.
_OF_THE_FORM = _BESIDE_ARRAYS | {"sample_weight", "state", "varying"}

ARRAYS = InputForm(
    "arrays in memory",
    "which are fitted at once",
    frozenset((EVERY_FLOOR, WHOLE_RECORDS)),
    _BESIDE_ARRAYS | {"sample_weight", "varying"},
)
DATASET = InputForm(
    "a Dataset",
    "which holds its own",
    frozenset((EVERY_FLOOR, WHOLE_RECORDS)),
    frozenset({"sample_weight", "varying"}),
)
COMPLETE_RECORDS = InputForm(
    "records",
    "which hold their own",
    frozenset((EVERY_FLOOR, WHOLE_RECORDS, RECORDS)),
    frozenset({"sample_weight", "varying"}),
)
RECORDS_WITH_GAPS = InputForm(
    "records in which a floor has no sensor",
    "which hold their own",
    frozenset((WHOLE_RECORDS, RECORDS)),
    frozenset({"sample_weight"}),
)
RESPONSES_OF_ONE_FORCE = InputForm(
    "frequency responses", "which have no samples", frozenset({RESPONSES})
)
PIECES = InputForm(
    "data in pieces",
    "each sample of which counts once",
    frozenset({EVERY_FLOOR}),
    _BESIDE_ARRAYS | {"state"},
)
COLLECTION = InputForm(
    "a Dask collection",
    "whose scheduler repeats what was lost",
    frozenset({EVERY_FLOOR}),
    _BESIDE_ARRAYS,
)


def form_of(X: object) -> InputForm:
    """The form in which a user passed the data."""
    if isinstance(X, Dataset):
        return DATASET
    if isinstance(X, FrequencyResponse):
        return RESPONSES_OF_ONE_FORCE
    records = records_in(X)
    if records is not None:
        return RECORDS_WITH_GAPS if lacks_motion(records) else COMPLETE_RECORDS

    first = X
    if isinstance(X, (list, tuple)) and X and not isinstance(X[0], (list, tuple)):
        first = X[0]
    if is_dask(first):
        return COLLECTION
    if isinstance(first, (str, os.PathLike, Iterator)):
        return PIECES
    return ARRAYS


# By setting of ``estimation``: the first method that suits the data is taken.
_METHODS: dict[str, tuple[type[IdentificationMethod], ...]] = {
    "auto": (
        FrequencyResponseFit,
        LeastSquaresOrInstruments,
        LeastSquares,
        ChannelFit,
    ),
    "ls": (LeastSquares,),
    "iv": (InstrumentalVariables, FrequencyResponseFit),
    "simulation": (OutputError, ChannelFit),
}
# Arguments whose use depends on the method.
_OF_THE_METHOD = LeastSquares.uses


def choose_method(
    setting: str, form: InputForm, arguments: Collection[str] = ()
) -> IdentificationMethod:
    """The method for a setting of ``estimation`` and a form of data.

    Where several suit, one is taken that uses all the arguments.

    Raises
    ------
    ChainError
        If the setting is unknown, or no method of it suits the data.
    """
    if setting not in _METHODS:
        raise ChainError(
            f"estimation={setting!r} is unknown",
            f"Choose one of {', '.join(_METHODS)}.",
        )
    suitable = _suitable(setting, form)
    if not suitable:
        missing = sorted(_METHODS[setting][0].requires - form.provides)
        others = [other for other in _METHODS if _suitable(other, form)]
        raise ChainError(
            f"estimation={setting!r} needs {' and '.join(missing)}, and was given"
            f" {form.name}",
            f"Choose one of {', '.join(others)}.",
        )

    of_the_method = _OF_THE_METHOD.intersection(arguments)
    for method in suitable:
        if of_the_method <= method.uses:
            return method(setting)
    return suitable[0](setting)


def _suitable(setting: str, form: InputForm) -> list[type[IdentificationMethod]]:
    """Methods of a setting whose requirements the data meet."""
    return [method for method in _METHODS[setting] if method.requires <= form.provides]


def refuse_unused(
    arguments: Collection[str], form: InputForm, method: IdentificationMethod
) -> None:
    """Refuse arguments that have no part in the fit.

    Raises
    ------
    ChannelError
        For what the data hold themselves.
    ChainError
        For a setting that the method does not use.
    """
    for name in arguments:
        if name in _OF_THE_FORM and name not in form.uses:
            reason = "which is fitted at once" if name == "state" else form.reason
            raise ChannelError(
                f"{name} was given in addition to {form.name}, {reason}",
                f"Leave {name} out.",
            )
        if name in _OF_THE_METHOD and name not in method.uses:
            refuse_arguments({name: True}, method.label)


def refuse_arguments(unused: Mapping[str, object], by: str) -> None:
    """Refuse arguments that have no part in what is done.

    Parameters
    ----------
    unused : mapping of str to object
        Values by name; None for what was not given.
    by : str
        What is done, in words.

    Raises
    ------
    ChainError
        Naming the first argument that was given.
    """
    for name, value in unused.items():
        if value is not None:
            raise ChainError(f"{name} has no part in {by}", f"Leave {name} out.")
