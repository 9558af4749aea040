"""Every setting of a run of the loop, for the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..common.audit import constants_of, settings_of
from ..diagnosis.evidence.settings import RESIDUAL
from ..report.words import BAND_FOUND, band_text
from .acceptance import ACCEPTANCE
from .amplitude import AMPLITUDE
from .bands import BANDS
from .candidate_search import SEARCH
from .channel_errors import CHANNEL_ERRORS
from .channel_spectra import CHANNELS
from .claims import CLAIMS
from .class_search import CLASSES
from .contradictions import CONTRADICTIONS
from .decision import CONFIRMATION
from .dictionary import DICTIONARY
from .effect_judge import EFFECT_JUDGE
from .error_fit import ERROR_FIT
from .error_reduction import REDUCTION
from .estimate_judge import ESTIMATE_JUDGE
from .excerpts import EXCERPTS
from .fitted_model import FIT
from .folds import FOLDS
from .free_run import FREE_RUN
from .growth import GROWTH
from .heldout import HELDOUT
from .judge import JUDGE
from .naming import NAMING
from .prepare import FUSION
from .request import LoopRequest
from .sensor_faults import FAULTS
from .shape_axes import AXES
from .signs import SIGNS
from .windows import WINDOWS

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

# Every number by which the loop decides, in groups.
ALL_SETTINGS: dict[str, DataclassInstance] = {
    "fusion": FUSION,
    "folds": FOLDS,
    "excerpts": EXCERPTS,
    "windows": WINDOWS,
    "bands": BANDS,
    "fit": FIT,
    "error reduction": REDUCTION,
    "scan": AXES,
    "search": SEARCH,
    "classes": CLASSES,
    "acceptance": ACCEPTANCE,
    "names": NAMING,
    "dictionary": DICTIONARY,
    "growth": GROWTH,
    "amplitudes": AMPLITUDE,
    "judge of effects": EFFECT_JUDGE,
    "judge of estimates": ESTIMATE_JUDGE,
    "signs": SIGNS,
    "judge": JUDGE,
    "channel errors": CHANNEL_ERRORS,
    "fit of channel errors": ERROR_FIT,
    "contradictions": CONTRADICTIONS,
    "sensor faults": FAULTS,
    "held-out data": HELDOUT,
    "confirmation": CONFIRMATION,
    "free run": FREE_RUN,
    "claims": CLAIMS,
    "residual": RESIDUAL,
    "fewer sensors": CHANNELS,
}


def audit(request: LoopRequest, calibration: object) -> dict[str, dict[str, str]]:
    """Every setting of a run: arguments, declared model, numbers of the decisions."""
    names = [record.name for record in request.heldout]
    laws = dict.fromkeys(law.name for law in request.catalogue)
    band = BAND_FOUND if request.band is None else band_text(request.band)

    arguments = {
        "band": band,
        "random_state": request.random_state,
        "max_steps": request.max_steps,
        "calibration": calibration,
        "held out": "; ".join(names) if names else "a quarter of every record",
        "catalogue": ", ".join(laws),
    }
    return settings_of(
        loop=arguments,
        baseline=request.baseline.get_params(deep=False),
        constants=constants_of(ALL_SETTINGS),
    )
