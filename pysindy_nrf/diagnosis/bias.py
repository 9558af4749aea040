"""What may bias masses and forces, judged from the data alone."""

from collections.abc import Sequence

import pandas as pd

from ..common.warn import warn_user
from ..exceptions import BiasWarning
from .contradictions import contradictions_of
from .jump_bias import JumpBias, sentences_of
from .missing_terms import MissingTerms, missing_laws, wrong_zeros
from .noise_bias import NEGLIGIBLE, NoiseBias, noise_bias, noise_shares

__all__ = [
    "NEGLIGIBLE",
    "JumpBias",
    "MissingTerms",
    "NoiseBias",
    "contradictions_of",
    "noise_bias",
    "noise_shares",
    "sentences_of",
    "warn_of_bias",
    "wrong_zeros",
]


def warn_of_bias(table: pd.DataFrame, masses: Sequence[str] = ()) -> None:
    """Give one BiasWarning if masses or zeros are doubtful, or a law is missing.

    Parameters
    ----------
    table : DataFrame
        ``missing_terms_`` of a regressor.
    masses : sequence of str
        Further sentences, e.g. on masses.
    """
    zeros = wrong_zeros(table)
    # once the fit is ruined by a constant, further terms follow it, too
    laws = [] if zeros else missing_laws(table)
    sentences = [*zeros, *masses, *laws]
    if sentences:
        warn_user(" ".join(sentences), BiasWarning)
