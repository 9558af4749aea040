"""What the data say of the residual before any law is tried: is it noise, where does it act, what is it like.

The loop gathers this for the baseline and after every accepted effect, on the search data alone. It informs the page
and decides nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from . import words
from .characterisation import Characterisation, Coupling, characterise, couplings
from .detection import Detection, detect
from .localisation import NEAR, Localiser
from .prepare import Workspace
from .residual import NoiseFloor, Residual, residual_of, searched
from .words import Agreement, Location, Obstacle, Why


@dataclass
class Evidence:
    """What is left of the measured forces after one model of the loop.

    Attributes
    ----------
    model : str
        ``"baseline"``, or the effect that was added last.
    sizes : DataFrame
        Residual of each balance and storey, see :class:`~pysindy_nrf.discrepancy.residual.Residual`.
    detection : Detection or None
        Whether it is noise.
    floor : NoiseFloor or None
        What noise alone would leave; None if it is not known.
    localisation : DataFrame or None
        Sites, best first, see :func:`~pysindy_nrf.discrepancy.localisation.localise`.
    site : str
        The site whose force is characterised: the best of ``localisation``; empty if there is nothing to locate.
    characterisation : Characterisation or None
        What the force there depends on.
    chosen : str
        The site at which the loop then added an effect; empty if none was added.
    later : tuple of str
        Sites at which the loop added effects in later steps.
    couplings : list of Coupling
        Storeys of the last model whose residual is loud and no function of their own motion.
    not_possible : dict of str to Obstacle
        Why a question to the residual has no answer, by its name.
    """

    model: str
    sizes: pd.DataFrame = field(default_factory=pd.DataFrame)
    detection: Detection | None = None
    floor: NoiseFloor | None = None
    localisation: pd.DataFrame | None = None
    site: str = ""
    characterisation: Characterisation | None = None
    chosen: str = ""
    later: tuple[str, ...] = ()
    couplings: list[Coupling] = field(default_factory=list)
    not_possible: dict[str, Obstacle] = field(default_factory=dict)

    @property
    def detection_sentence(self) -> str:
        """Whether the residual is noise, in words."""
        return words.detection(self)

    @property
    def strongest(self) -> pd.Series | None:
        """The test that stands out most: of a signal if one does, else of the residual's own past."""
        if self.detection is None or not len(self.detection.tests):
            return None
        tests = self.detection.tests
        named = tests[tests["outside"] & (tests["test"] != "phi_ee")]
        chosen = named if len(named) else tests
        return chosen.loc[(chosen["peak"].abs() / chosen["band"]).idxmax()]

    @property
    def localisation_sentence(self) -> str:
        """Where the missing force acts, in words, and whether the chosen site agrees."""
        return words.localisation(self)

    @property
    def characterisation_sentence(self) -> str:
        """What the missing force depends on, in words."""
        return words.characterisation(self)

    @property
    def agreement(self) -> Agreement:
        """Whether localisation agrees with the site of the effect that was added."""
        table = self.localisation
        if not self.chosen or not self.site or table is None or table["share"].isna().all():
            return Agreement.NONE
        if table["share"].dropna().round(6).nunique() == 1:
            return Agreement.SIGNLESS
        if self.chosen not in table.index or not np.isfinite(table.loc[self.chosen, "share"]):
            return Agreement.UNJUDGED
        mine, best = table.loc[self.chosen], table.iloc[0]
        if mine["balances"] == best["balances"]:
            return Agreement.SAME
        if self.site in self.later:
            return Agreement.LATER
        near = best["share"] - mine["share"] < NEAR or mine["high"] > best["low"]
        return Agreement.NEAR if near else Agreement.DISAGREES

    def __str__(self) -> str:
        return "\n".join([self.detection_sentence, self.localisation_sentence, self.characterisation_sentence])


def look(
    work: Workspace,
    model: ChainModel,
    name: str = "model",
    chosen: str = "",
    floor: NoiseFloor | None = None,
) -> Evidence:
    """Detection, localisation and characterisation of what one model leaves of the search data."""
    out = Evidence(name, chosen=chosen)
    residual = _tried(out, "residual", lambda: searched_residual(work, model))
    if residual is None:
        out.not_possible |= dict.fromkeys(words.QUESTIONS, out.not_possible["residual"])
        return out
    out.sizes = residual.sizes
    out.detection = _tried(out, "detection", lambda: detect(residual, floor))
    where = _tried(out, "localisation", lambda: Localiser(residual, floor, work.known_masses))
    out.localisation = None if where is None else _tried(out, "localisation", where.table)
    if out.localisation is None:
        out.not_possible["characterisation"] = Obstacle(Why.NO_SITE, words.obstacle(out.not_possible["localisation"]))
    else:
        located = out.localisation["verdict"].iloc[0] != Location.NOTHING
        out.site = str(out.localisation.index[0]) if located else ""
        if out.detection is not None and out.detection.is_noise:
            out.not_possible["characterisation"] = Obstacle(Why.ONLY_NOISE)
        elif not located:
            out.not_possible["characterisation"] = Obstacle(Why.NOTHING_LOCATED)
        else:
            out.characterisation = _tried(out, "characterisation", lambda: _characterised(where, Site(out.site), floor))
    if floor is not None:
        if not chosen:
            out.couplings = _tried(out, "coupling", lambda: couplings(residual, floor)) or []
        out.floor = replace(floor, draws=[])
    return out


def searched_residual(work: Workspace, model: ChainModel) -> Residual:
    """Residual on the search data; laws that remember the path follow it from the start of the record."""
    data, filters = searched(work)
    if not model.has_memory:
        return residual_of(model, data, filters)
    whole = {id(seg.s): (seg, R) for seg, R in zip(work.data.segments, model.site_forces(work.data))}
    forces = []
    for piece in data.segments:
        seg, R = whole[id(piece.s)]
        start = piece.valid.start - seg.valid.start
        forces.append(R[start : start + piece.n_valid])
    return residual_of(model, data, filters, forces=forces)


def _characterised(where: Localiser, site: Site, floor: NoiseFloor | None) -> Characterisation:
    residual = where.residual
    force, beside = where.force(site)
    of_motion = site if site.kind != "sensor" else Site(f"dof {site.channel[1:]}")
    segments = residual.data.segments
    noise = np.nan if floor is None else floor.at(str(site) if site.is_storey else f"dof {of_motion.p}")
    return characterise(
        force,
        [seg.motion(of_motion, seg.valid) for seg in segments],
        filters=residual.filters,
        beside=beside if beside[0].shape[1] else None,
        noise=float(noise) if np.isfinite(noise) else None,
    )


def _tried(out: Evidence, room: str, enter: Callable[[], Any]) -> Any:
    try:
        return enter()
    except NRFError as error:
        out.not_possible[room] = Obstacle(Why.ERROR, error.what)
    except (ValueError, ArithmeticError, LookupError) as error:  # numerics on data nobody has seen: say it and go on
        out.not_possible[room] = Obstacle(Why.ERROR, f"{type(error).__name__}: {error}")
    return None
