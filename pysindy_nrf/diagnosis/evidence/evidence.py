"""What the data show of a residual before any law is tried.

Is it noise, where does it act, what is it like? One residual, one regression: what the
motion explains of it distinguishes noise from what is missing; what a free force with
the signs of a site explains shows where it acts. It informs the page and decides
nothing in the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import pandas as pd

from ...chain.model import ChainModel
from ...chain.sites import Site
from ...exceptions import NRFError
from . import wording
from .characterisation import Characterisation, characterise
from .detection import Detection, detect
from .diagnosed_data import DiagnosedData
from .kinds import Obstacle
from .localisation import Localisation, Localiser
from .noise_floor import NoiseFloor
from .searched_residual import residual_in

Answer = TypeVar("Answer")
QUESTIONS = ("detection", "localisation", "characterisation")


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is left of the measured forces after one model.

    Attributes
    ----------
    model : str
        ``"baseline"``, or the effect that was added last.
    sizes : DataFrame
        The residual of each balance and storey.
    detection, localisation, characterisation
        The answers to the three questions; None where there is none.
    floor : NoiseFloor or None
        What noise alone would leave.
    chosen : str
        The site at which the loop then added an effect; empty if none.
    not_possible : dict of str to Obstacle
        Why a question has no answer.
    """

    model: str
    sizes: pd.DataFrame = field(default_factory=pd.DataFrame)
    detection: Detection | None = None
    floor: NoiseFloor | None = None
    localisation: Localisation | None = None
    characterisation: Characterisation | None = None
    chosen: str = ""
    not_possible: dict[str, Obstacle] = field(default_factory=dict)

    @property
    def site(self) -> str:
        """The site whose force is characterised; empty if there is none."""
        return "" if self.localisation is None else self.localisation.site

    @property
    def sentences(self) -> dict[str, str]:
        """The answer to each question, in words."""
        sentences = {}
        if self.detection is not None:
            sentences["detection"] = wording.detection(
                self.detection, bool(self.chosen)
            )
        if self.localisation is not None:
            sentences["localisation"] = wording.localisation(
                self.localisation, self.chosen
            )
        if self.characterisation is not None:
            sentences["characterisation"] = wording.characterisation(
                self.characterisation, self.site
            )
        return {q: sentences.get(q) or self._why_not(q) for q in QUESTIONS}

    def _why_not(self, question: str) -> str:
        obstacle = self.not_possible.get(question, Obstacle("nothing was tried"))
        return wording.not_possible(question, obstacle)

    def __str__(self) -> str:
        return "\n".join(self.sentences.values())


def evidence_of(
    data: DiagnosedData,
    model: ChainModel,
    name: str = "model",
    chosen: str = "",
    floor: NoiseFloor | None = None,
) -> Evidence:
    """Detection, localisation and characterisation of what one model leaves.

    Parameters
    ----------
    data : DiagnosedData
    model : ChainModel
    name, chosen : str
        See :class:`Evidence`.
    floor : NoiseFloor, optional
        What noise alone would leave, if it is known.
    """
    asked = _Questions()
    residual = asked.ask("residual", lambda: residual_in(data, model))
    if residual is None:
        for question in QUESTIONS:
            asked.obstacles[question] = asked.obstacles["residual"]
        return Evidence(name, chosen=chosen, not_possible=asked.obstacles)

    detection = asked.ask("detection", lambda: detect(residual, floor))
    localiser = asked.ask(
        "localisation", lambda: Localiser(residual, floor, data.known_masses)
    )
    localisation, characterisation = None, None
    if localiser is not None:
        localisation = asked.ask("localisation", localiser.localise)

    obstacle = _why_no_kind(detection, localisation, asked.obstacles)
    if obstacle is not None:
        asked.obstacles["characterisation"] = obstacle
    elif localiser is not None and localisation is not None:
        site = Site(localisation.site)
        characterisation = asked.ask(
            "characterisation", lambda: _characterised(localiser, site, floor)
        )
    return Evidence(
        name,
        residual.sizes,
        detection,
        None if floor is None else floor.without_draws(),
        localisation,
        characterisation,
        chosen,
        asked.obstacles,
    )


class _Questions:
    """Questions to the data, and why some have no answer."""

    def __init__(self) -> None:
        self.obstacles: dict[str, Obstacle] = {}

    def ask(self, question: str, answer: Callable[[], Answer]) -> Answer | None:
        """The answer, or None: numerics fail on data nobody has seen, too."""
        try:
            return answer()
        except NRFError as error:
            reason = error.what
        except (ValueError, ArithmeticError, LookupError) as error:
            reason = f"{type(error).__name__}: {error}"
        self.obstacles[question] = Obstacle(reason.rstrip("."))
        return None


def _why_no_kind(
    detection: Detection | None,
    localisation: Localisation | None,
    obstacles: dict[str, Obstacle],
) -> Obstacle | None:
    """Why the kind of the force cannot be asked for; None if it can."""
    if localisation is None:
        reason = obstacles["localisation"].reason
        return Obstacle(f"the site is not known: {reason}")
    if detection is not None and detection.is_noise:
        return Obstacle("nothing but noise is left", expected=True)
    if not localisation.site:
        return Obstacle("the residual is at the noise floor", expected=True)
    return None


def _characterised(
    localiser: Localiser, site: Site, floor: NoiseFloor | None
) -> Characterisation:
    """The kind of the force that is missing at a site."""
    residual = localiser.residual
    missing = localiser.missing_force(site)
    moving = Site(f"dof {site.p}") if site.kind == "sensor" else site
    noise = np.nan
    if floor is not None:
        noise = floor.rms_at(str(site) if site.is_storey else f"dof {moving.p}")
    return characterise(
        missing.force,
        [seg.motion(moving, seg.valid) for seg in residual.data.segments],
        filters=residual.filters,
        beside=missing.beside if missing.beside[0].shape[1] else None,
        noise=float(noise) if np.isfinite(noise) else None,
    )
