"""What the data say of the residual before any law is tried: is it noise, where does it act, what is it like.

The loop gathers this for the baseline and after every accepted effect, on the search data alone. It does
not decide: the search refits everything and the gate judges. Where both agree a reader may trust the
name; where they do not, the report says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.segments import SegmentSet
from .characterisation import Characterisation, characterise
from .coupling import Coupling, couplings
from .detection import NOISE, TEST_WORDS, Detection, detect
from .localisation import localise, missing_force
from .noise_floor import NoiseFloor
from .residual import Residual, residual_of
from .stage import Stage
from .workspace import Workspace

# Samples looked at: enough to see any effect, and little beside the search.
_ENOUGH = 40_000
# Sites that explain nearly as much as the first, percentage points.
_NEAR = 5.0


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
        The site whose force is characterised: the best of ``localisation``.
    characterisation : Characterisation or None
        What the force there depends on.
    chosen : str
        The site at which the loop then added an effect; empty if none was added.
    later : tuple of str
        Sites at which the loop added effects in later steps.
    couplings : list of Coupling
        Storeys of the last model whose residual is loud and no function of their own motion.
    not_possible : dict of str to str
        Why a room could not be entered, by its name.
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
    not_possible: dict[str, str] = field(default_factory=dict)

    @property
    def detection_sentence(self) -> str:
        """Whether the residual is noise, in words."""
        if self.detection is None:
            return _not_possible("Detection", self.not_possible.get("detection", ""))
        table = self.detection.verdicts
        ratio = table["floor ratio"].max()
        times = f"at most {ratio:.2g} times the noise floor" if np.isfinite(ratio) else "noise taken to be white"
        if self.detection.is_noise:
            return f"Nothing but noise is left in any balance ({times})."
        kinds = table[table["verdict"] != NOISE]["verdict"]
        said = [f"{kind} in {_listed(kinds.index[kinds == kind])}" for kind in dict.fromkeys(kinds)]
        best = self.strongest
        strongest = (
            ""
            if best is None or not best["outside"]
            else f" The strongest correlation is {TEST_WORDS[best['test']].format(x=best['signal'])} in "
            f"{_name(best['where'])}: {best['peak']:.2f}, where noise stays within {best['band']:.2f}."
        )
        return f"The residual is not noise: {'; '.join(said)} ({times}).{strongest}"

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
        if self.localisation is None:
            return _not_possible("Localisation", self.not_possible.get("localisation", ""))
        first = self.localisation.iloc[0]
        text = f"The signs across the balances point to {self.site}: {first['verdict']}."
        if "noise floor" in str(first["verdict"]):
            text = f"{str(first['verdict']).capitalize()}."
        elif len(_patterns(self.localisation)) == 1:
            text = f"{str(first['verdict']).capitalize()}."
        return f"{text} {self.agreement}".strip()

    @property
    def characterisation_sentence(self) -> str:
        """What the missing force depends on, in words."""
        if self.characterisation is None:
            return _not_possible("Characterisation", self.not_possible.get("characterisation", ""))
        said = self.characterisation.sentence
        return f"The force missing at {self.site} {said[0].lower()}{said[1:]}"

    @property
    def coupling_sentence(self) -> str:
        """Where something is left that no law of a chain explains, in words; empty if nowhere."""
        if not self.couplings:
            return ""
        return f"Not explained by a chain law: {'; '.join(map(str, self.couplings))}"

    @property
    def agreement(self) -> str:
        """Whether localisation agrees with the site of the effect that was added; empty without one."""
        table = self.localisation
        if not self.chosen or table is None or table["share"].isna().all():
            return ""
        if len(_patterns(table)) == 1:
            return f"The loop chose {self.chosen} by the error after refitting."
        if self.chosen == self.site:
            return f"The loop chose the same site, {self.chosen}."
        if self.chosen not in table.index or not np.isfinite(table.loc[self.chosen, "share"]):
            return f"The loop chose {self.chosen}, which localisation cannot judge."
        share, best = table.loc[self.chosen, "share"], table["share"].iloc[0]
        if table.loc[self.chosen, "balances"] == table["balances"].iloc[0]:
            return f"The loop chose {self.chosen}, which has the same pattern of signs."
        if self.site in self.later:
            return f"The loop chose {self.chosen} ({share:.0f} %) first, and {self.site} in a later step."
        rank = len(_patterns(table.loc[: self.chosen]))
        near = best - share < _NEAR or table.loc[self.chosen, "high"] > table["low"].iloc[0]
        if near:
            return f"The loop chose {self.chosen} ({share:.0f} %), which localisation hardly tells from {self.site}."
        return (
            f"Localisation disagrees with the loop, which chose {self.chosen}: it explains {share:.0f} % and is number "
            f"{rank}. The choice of the loop rests on refitting the whole chain with a law there, which the signs "
            "alone cannot do; another effect may dominate the residual."
        )

    def __str__(self) -> str:
        return "\n".join([self.detection_sentence, self.localisation_sentence, self.characterisation_sentence])


def look(
    work: Workspace,
    model: ChainModel,
    name: str = "model",
    noise: Sequence[Stage] = (),
    chosen: str = "",
    floor: NoiseFloor | None = None,
) -> Evidence:
    """Enter the rooms detection, localisation and characterisation with one model."""
    out = Evidence(name, chosen=chosen)
    residual = _tried(out, "residual", lambda: searched_residual(work, model))
    if residual is None:
        out.not_possible |= {
            room: out.not_possible["residual"] for room in ("detection", "localisation", "characterisation")
        }
        return out
    out.sizes = residual.sizes
    if floor is None and noise:
        floor = _tried(out, "noise floor", lambda: _floor(noise))
    out.detection = _tried(out, "detection", lambda: detect(residual, floor))
    options: dict[str, Any] = {"floor": floor, "known_masses": work.known_masses}
    out.localisation = _tried(out, "localisation", lambda: localise(residual, **options))
    if out.localisation is None:
        out.not_possible["characterisation"] = f"the site is not known: {out.not_possible['localisation']}"
    else:
        out.site = str(out.localisation.index[0])
        if out.detection is not None and out.detection.is_noise:
            out.not_possible["characterisation"] = "nothing but noise is left"
        elif "noise floor" in str(out.localisation["verdict"].iloc[0]):
            out.not_possible["characterisation"] = "the residual is at the noise floor"
        else:
            out.characterisation = _tried(out, "characterisation", lambda: _characterised(residual, out.site, options))
    if floor is not None:
        if not chosen:
            out.couplings = _tried(out, "coupling", lambda: couplings(residual, floor)) or []
        out.floor = replace(floor, draws=[])
    return out


def gather(scenes: Sequence[Any], models: Sequence[ChainModel], steps: Sequence[Any]) -> list[Evidence]:
    """Evidence for the baseline and after every step; the steps get its sentences."""
    sites = [str(step.site) for step in steps] + [""] * (len(scenes) - len(steps))
    found = [
        look(scene.trial.work, model, scene.name, scene.noise, site, scene.floor)
        for scene, model, site in zip(scenes, models, sites)
    ]
    for k, evidence in enumerate(found):
        evidence.later = tuple(site for site in sites[k + 1 :] if site)
    for step, evidence in zip(steps, found):
        step.detection = evidence.detection_sentence
        step.localisation = evidence.localisation_sentence
        step.characterisation = evidence.characterisation_sentence
    return found


def searched(work: Workspace, most: int = _ENOUGH, data: SegmentSet | None = None) -> tuple[SegmentSet, list[Any]]:
    """The part of the data that the search may see, cut to so many samples, and the filter of each record."""
    total = sum(b.rows.stop - b.rows.start for b in work.search)
    share = min(1.0, most / max(total, 1))
    longest: dict[int, int] = {}
    parts = [(i, piece, piece.n_valid) for i, piece in work.pieces(data)]
    for i, _, length in parts:
        longest[i] = max(length, longest.get(i, 0))
    pieces, filters = [], []
    for i, piece, length in parts:
        if 4 * length >= longest[i]:
            start = piece.valid.start
            pieces.append(replace(piece, valid=slice(start, start + int(np.ceil(share * length)))))
            filters.append(work.filters[i])
    return SegmentSet(pieces, work.data.n_samples), filters


def searched_residual(work: Workspace, model: ChainModel) -> Residual:
    """Residual on the search data; laws that remember the path follow it from the start of the record."""
    data, filters = searched(work)
    residual = residual_of(model, data, filters)
    if not model.has_memory:
        return residual
    names = {id(seg.s): i for i, seg in enumerate(work.data.segments)}
    whole: dict[int, np.ndarray] = {}
    balance = []
    for seg, filter in zip(data.segments, filters):
        k = names[id(seg.s)]
        record = work.data.segments[k]
        if k not in whole:
            whole[k] = residual_of(model, SegmentSet([record], work.data.n_samples), [filter]).balance[0]
        start = seg.valid.start - record.valid.start
        balance.append(whole[k][start : start + seg.n_valid])
    return residual.with_balance(balance)


def _floor(noise: Sequence[Stage]) -> NoiseFloor:
    draws = []
    for stage in noise:
        residual = searched_residual(stage.work, stage.trial().model())
        draws.append((residual, residual.data))
    return NoiseFloor.from_draws(draws, "free runs of the model with the noise of the channels")


def _characterised(residual: Residual, site: str, options: dict[str, Any]) -> Characterisation:
    place = Site(site)
    force, beside = missing_force(residual, place, **options)
    of_motion = place if place.kind != "sensor" else Site(f"dof {place.channel[1:]}")
    segments = residual.data.segments
    dofs = {place.p, place.q} if place.kind == "link" else {of_motion.p}
    late = {f"F{j}": [seg.F[seg.valid, j - 1] for seg in segments] for j in dofs & set(residual.data.forced)}
    floor = options["floor"]
    return characterise(
        force,
        [seg.motion(of_motion, seg.valid) for seg in segments],
        filters=residual.filters,
        beside=beside if beside[0].shape[1] else None,
        channels={k: v for k, v in late.items() if all(np.isfinite(line).all() for line in v)},
        noise=None if floor is None else _noise_at(floor, place, of_motion),
    )


def _noise_at(floor: NoiseFloor, place: Site, of_motion: Site) -> float | None:
    level = floor.at(str(place) if place.is_storey else f"dof {of_motion.p}")
    return level if np.isfinite(level) else None


def _tried(out: Evidence, room: str, enter: Callable[[], Any]) -> Any:
    try:
        return enter()
    except NRFError as error:
        out.not_possible[room] = error.what
    except (ValueError, ArithmeticError, LookupError) as error:  # numerics on data nobody has seen: say it and go on
        out.not_possible[room] = f"{type(error).__name__}: {error}"
    return None


def _patterns(table: pd.DataFrame) -> list[str]:
    known = table[table["share"].notna()]
    return list(dict.fromkeys(f"{share:.6f}" for share in known["share"]))


def _not_possible(room: str, why: str) -> str:
    return f"{room} is not possible because {why.rstrip('.') or 'nothing was tried'}."


def _name(where: str) -> str:
    return where.replace("dof", "the balance of DOF")


def _listed(places: Sequence[str]) -> str:
    dofs = [p.split()[1] for p in places if p.startswith("dof")]
    storeys = [p.split()[1] for p in places if p.startswith("storey")]
    said = [f"the balance of DOF {', '.join(dofs)}"] if dofs else []
    said += [f"storey {', '.join(storeys)}"] if storeys else []
    return " and ".join(said)
