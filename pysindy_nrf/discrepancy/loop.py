"""Close the loop: find the residual, trace it to an effect, add the effect, judge it, repeat."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..chain_solve import Solution
from ..errors import balance_errors
from ..exceptions import ExcitationError, NRFError
from ..laws.base import ForceLaw
from ..model import ChainModel
from ..regressor import NRFRegressor, _filters, _valued
from ..segments import SegmentSet
from ..sites import Site
from .catalogue import SPECIAL_CASES, Candidate, as_laws, candidates
from .gate import FLOOR, MOST_FAMILIES, Verdict, choose, gain_of, judge
from .prepare import Prepared, prepare
from .report import LoopReport, Scene, Step
from .search import Finding, refine, screen, spectral_lines, validate
from .splits import BlockRows, split
from .surrogate import surrogate
from .workspace import Stage, Trial, Workspace

_SHORTLIST = 14
_VALIDATED = 10
# Candidates put to the gate, each with fewer parameters than the one before.
_DECISIONS = 3
# A candidate that does not even do this on the data it is fitted to cannot pass the gate.
_HOPELESS = 0.05
# Share of the effect (noise taken off) that may stay unexplained before a name is no longer sure.
_SURE = 0.4
# A hysteresis that turns over within this share of the rms drift is friction by another name.
_ONE_CLASS = 0.3


def close_loop(
    records: Any,
    baseline: NRFRegressor | None = None,
    catalogue: Iterable[Any] | None = None,
    heldout: Any = None,
    band: tuple[float | None, float | None] | None = None,
    random_state: Any = 0,
    *,
    max_steps: int = 4,
    n_surrogates: int = 2,
    progress: bool = False,
) -> LoopReport:
    """Find the effects a model lacks, add them, and report the error before and after.

    The records are fused (:class:`KinematicSmoother`), cut into contiguous blocks of equal energy,
    and the last quarter of each (or the records in ``heldout``) is put aside until the last line.
    Every law of the catalogue is tried at every site where it makes sense: its columns are built
    from the raw motion, filtered like the rest, and the whole chain is solved again with it (variable
    projection). The best is accepted if the median error over blocks it was not fitted to falls by
    at least 15 %, in at least 80 % of the blocks, and by more than the same law gains on surrogates
    that hold the same noise and no effect. Then the next is looked for.

    Parameters
    ----------
    records : Record or sequence of Record
    baseline : NRFRegressor, optional
        The declared model; linear storeys if None. Its data are not used.
    catalogue : iterable of ForceLaw, optional
        Laws to try; all of :mod:`pysindy_nrf.laws` that can be an effect if None.
    heldout : Record or sequence of Record, optional
        Records that only the last line sees.
    band : (float, float), optional
        Frequency band, Hz, in which everything is fitted and judged; the baseline's if None. It does
        not change during the search.
    random_state : int, Generator or None
        For the surrogates.
    max_steps : int
        Effects at most.
    n_surrogates : int
        Surrogates for the null reference; 0 leaves it out.
    progress : bool
        Show a progress bar (tqdm) where the error stream is a terminal.

    Returns
    -------
    LoopReport
        ``.steps``, ``.table``, ``.stopped_because``, ``.model``, ``.to_html``, ``.to_markdown``.

    Raises
    ------
    NRFError
        If the records or the baseline cannot be used, naming the channel and the cure.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
    >>> linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    >>> truth = ChainModel([10.0, 10.0], {"storey 1": [*linear, laws.CoulombFriction(30.0)], "storey 2": linear})
    >>> F = excitation.band_limited_random(2, 8.0, 1000.0, dofs=2, rms=100.0, band=(1, 60), random_state=0)
    >>> report = close_loop(simulate(truth, F, 1e-3))
    >>> report.steps[0].family, report.steps[0].site
    ('friction', 'storey 1')
    """
    baseline = baseline if baseline is not None else NRFRegressor(degree=1)
    band = band if band is not None else baseline.band
    ready = prepare(records, heldout)
    search, held = split(ready.data.segments, ready.heldout)
    given = baseline._given_laws()
    chain = baseline._chain(ready.data.n_dof, given)
    known = baseline._known_masses(chain)
    filters = _filters(band, ready.data)
    work = Workspace(ready.data, filters, search, held, known, baseline.strategy)
    if not work.forced and not known:
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            "Give the baseline known_masses={dof: kg}.",
        )
    first = _baseline_laws(baseline, chain, given, work)
    names = tuple(ready.data.segments[0].covariates)
    every = list(candidates(as_laws(catalogue, names), chain, known, names, work.forced))
    loop = _Loop(ready, work, every, np.random.default_rng(random_state), n_surrogates, progress)
    with threadpool_limits(1):  # the matrices are small: threads only get in each other's way
        return loop.run(Stage(work, chain, first), max_steps, band, baseline)


def _baseline_laws(baseline: NRFRegressor, chain: Any, given: Any, work: Workspace) -> dict[Site, tuple[ForceLaw, ...]]:
    laws = baseline._laws(chain, given)
    if any(law.free_shape for held in laws.values() for law in held):
        from sklearn.base import clone

        fresh = clone(baseline)
        part = _searched(work)
        fresh._fit(part, given, part, None)
        return {s: tuple(law for law in held) for s, held in fresh.model_.laws.items()}
    return laws


def _searched(work: Workspace) -> SegmentSet:
    """The part of the data that the search may see."""
    pieces = []
    for i, seg in enumerate(work.data.segments):
        start = seg.valid.start
        for rows in _runs([b.rows for b in work.search if b.segment == i]):
            pieces.append(type(seg)(**{**seg.__dict__, "valid": slice(start + rows.start, start + rows.stop)}))
    return SegmentSet(pieces, work.data.n_samples)


def _runs(blocks: Sequence[slice]) -> list[slice]:
    """Blocks that follow each other, joined."""
    runs: list[slice] = []
    for rows in blocks:
        if runs and runs[-1].stop == rows.start:
            runs[-1] = slice(runs[-1].start, rows.stop)
        else:
            runs.append(rows)
    return runs


def model_of(trial: Trial, solution: Solution) -> ChainModel:
    """The chain model of a solved trial.

    Parameters
    ----------
    trial : Trial
    solution : Solution

    Returns
    -------
    ChainModel
    """
    layout = trial.layout
    laws = {s: _valued(layout.laws.get(s, ()), solution.coefficients.get(s)) for s in layout.sites}
    return ChainModel([solution.masses[j] for j in range(1, layout.n_dof + 1)], laws, layout.chain)


class _Loop:
    """One run of the loop: what stays the same from step to step."""

    def __init__(
        self,
        ready: Prepared,
        work: Workspace,
        every: Sequence[Candidate],
        rng: np.random.Generator,
        n_surrogates: int,
        progress: bool,
    ) -> None:
        self.ready, self.work, self.every = ready, work, every
        self.rng, self.n_surrogates, self.progress = rng, n_surrogates, progress

    def run(self, stage: Stage, max_steps: int, band: Any, baseline: NRFRegressor) -> LoopReport:
        """Walk through the four rooms until there is a reason to stop."""
        trial = stage.trial()
        scenes = [Scene("baseline", trial, trial.fold_errors())]
        steps: list[Step] = []
        stopped = f"{max_steps} effects were added, which is the limit set by max_steps"
        null = _Null(self, stage, trial)
        ranking: list[Finding] = []
        while len(steps) < max_steps:
            before = scenes[-1].folds
            if np.median(before) < FLOOR:
                stopped = f"The balance closes within {np.median(before):.2g} % on the search data, nothing is left"
                break
            ranking = self._findings(stage, trial, steps)
            if not ranking:
                stopped = "No law of the catalogue lowers the error at any site"
                break
            chosen, tied, verdict = self._decide(stage, ranking, before, null)
            if not verdict.accepted:
                best = f"{chosen.law.name} at {chosen.site}"
                stopped = f"No further effect is supported: the best candidate is {best}, but {verdict.sentence}"
                break
            stage = self._with(stage, chosen)
            trial = stage.trial()
            after = trial.fold_errors()
            null = _Null(self, stage, trial)
            step = _step(chosen, tied, verdict, before, after, null.floor, ranking, self.work.scales(chosen.site)[0])
            steps.append(step)
            scenes.append(Scene(f"{step.law} at {step.site}", trial, after))
        floor, left = null.floor, float(np.median(scenes[-1].folds))
        for step in steps:
            step.remainder = _remainder(step.validation_before, left, floor)
            step.sure = step.remainder <= _SURE
        if np.isfinite(floor) and left > max(2.0 * floor, FLOOR):
            noise = f"(noise alone leaves about {floor:.2g} %)"
            stopped += f". {left:.3g} % stay unexplained by any law {noise}, most in the {_worst(trial)}"
        return LoopReport.assemble(self.work, scenes, steps, stopped, ranking, band, self.ready, baseline)

    def _findings(self, stage: Stage, trial: Trial, steps: Sequence[Step]) -> list[Finding]:
        """Validated candidates, best first."""
        now = trial.search_error()
        accepted = [(Site(s.site), s.law) for s in steps]
        lines = self._lines(trial)
        bar, tick = None, None
        if self.progress:
            from tqdm.auto import tqdm

            bar = tqdm(
                total=len(self.every), desc=f"search {len(steps) + 1}", unit="candidate", leave=False, disable=None
            )
            tick = bar.update
        found = screen(stage, self.every, accepted, lines, tick)
        if bar is not None:
            bar.close()
        hopeful = [f for f in found if f.screen < now * (1 - _HOPELESS)][:_SHORTLIST]
        refined = sorted((refine(stage, f) for f in hopeful), key=lambda f: f.screen)[:_VALIDATED]
        special = {(f.site, name) for f in refined[:3] for name in SPECIAL_CASES.get(f.law.name, ())}
        refined += [refine(stage, f) for f in found if (f.site, f.law.name) in special and not _holds(refined, f)]
        judged = [validate(stage, f) for f in refined]
        return sorted((f for f in judged if np.isfinite(f.error)), key=lambda f: f.error)

    def _decide(
        self, stage: Stage, ranking: list[Finding], before: np.ndarray, null: _Null
    ) -> tuple[Finding, list[Finding], Verdict]:
        """The best candidate that passes the gate; the best of all with its verdict where none does."""
        first = None
        left = list(ranking)
        for _ in range(_DECISIONS):
            chosen, tied = choose(left, float(np.median(before)))
            chosen = self._polished(stage, chosen)
            verdict = judge(before, chosen.folds, chosen.n_parameters)
            if verdict.accepted:
                verdict = judge(before, chosen.folds, chosen.n_parameters, null.gain(chosen))
            if verdict.accepted:
                return chosen, tied, verdict
            first = first or (chosen, tied, verdict)
            left = [f for f in left if f.n_parameters < chosen.n_parameters]
            if not left:
                break
        assert first is not None
        return first

    def _polished(self, stage: Stage, chosen: Finding) -> Finding:
        """The chosen candidate with its shape parameters refined to the end."""
        if not chosen.candidate.law.free_shape:
            return chosen
        finer = validate(stage, refine(stage, chosen, 120 * len(chosen.candidate.law.free_shape)))
        return finer if finer.error <= chosen.error * 1.02 else chosen

    def _lines(self, trial: Trial) -> dict[Site, list[float]]:
        """Spectral lines of the residual of each balance."""
        solution = trial.solve(range(len(self.work.search)))
        model = model_of(trial, solution)
        longest = int(np.argmax([seg.valid.stop - seg.valid.start for seg in self.work.data.segments]))
        seg = self.work.data.segments[longest]
        if seg.dt is None:
            return {}
        runs = _runs([b.rows for b in self.work.search if b.segment == longest])
        if not runs:
            return {}
        widest = max(runs, key=lambda r: r.stop - r.start)
        one = SegmentSet([seg], self.work.data.n_samples)
        left = model.balance_forces(one)[0] - np.nan_to_num(seg.F[seg.valid])
        left = self.work.filtered(longest, left.T)[:, widest]
        return {Site(f"dof {j + 1}"): spectral_lines(left[j], seg.dt) for j in range(self.work.n_dof)}

    def _with(self, stage: Stage, chosen: Finding) -> Stage:
        """The stage with an accepted candidate, and no law that it made needless."""
        trial = chosen.trial(stage)
        return Stage(self.work, trial.layout.chain, trial.layout.laws)


def _holds(findings: Sequence[Finding], one: Finding) -> bool:
    return any(f.site == one.site and f.candidate.law == one.candidate.law for f in findings)


class _Null:
    """What the search would see if the current model were the whole truth: its own free run with fresh noise."""

    def __init__(self, loop: _Loop, stage: Stage, trial: Trial) -> None:
        self.loop, self.stage, self.trial = loop, stage, trial
        self._stages: list[Stage] | None = None

    @property
    def stages(self) -> list[Stage]:
        """The same laws on surrogate records; empty where no free run is possible."""
        if self._stages is None:
            self._stages = []
            try:
                model = model_of(self.trial, self.trial.solve(range(len(self.loop.work.search))))
                if (model.masses > 0).all():
                    self._stages = [self._one(model) for _ in range(self.loop.n_surrogates)]
            except NRFError:
                self._stages = []
        return self._stages

    def _one(self, model: ChainModel) -> Stage:
        ready, work = self.loop.ready, self.loop.work
        chosen = sorted({b.segment for b in work.search})
        fakes = [
            surrogate(ready.records[i], work.data.segments[i], model, ready.noise[i], self.loop.rng) for i in chosen
        ]
        data = prepare(fakes).data
        blocks = []
        for number, i in enumerate(chosen):
            seg = data.segments[number]
            for b in (b for b in work.search if b.segment == i):
                stop = min(b.rows.stop, seg.valid.stop - seg.valid.start)
                blocks.append(BlockRows(number, slice(min(b.rows.start, stop), stop)))
        fake = Workspace(data, [work.filters[i] for i in chosen], blocks, [], work.known_masses, work.strategy)
        return Stage(fake, self.stage.chain, self.stage.laws)

    @property
    def floor(self) -> float:
        """Median validation error that noise alone leaves, percent; NaN if unknown."""
        try:
            values = [float(np.median(stage.trial().fold_errors())) for stage in self.stages]
        except NRFError:
            return float("nan")
        return float(np.median(values)) if values else float("nan")

    def gain(self, finding: Finding) -> float:
        """Largest gain of a candidate where it does not act; NaN if unknown."""
        gains = [0.0]
        for stage in self.stages:
            try:
                before = stage.trial().fold_errors()
                best = screen(stage, [finding.candidate])
                tried = validate(stage, refine(stage, best[0], 20)) if best else None
                gains.append(gain_of(before, tried.folds) if tried is not None and np.median(before) > FLOOR else 0.0)
            except NRFError:
                continue
        return max(gains)


def _remainder(before: float, left: float, floor: float) -> float:
    """Share of what noise does not explain that stays unexplained at the end."""
    noise = floor if np.isfinite(floor) else 0.0
    return float(np.sqrt(max(left**2 - noise**2, 0.0) / max(before**2 - noise**2, 1e-300)))


def _worst(trial: Trial) -> str:
    """The balance with the largest share of the pooled error, in words."""
    blocks = range(len(trial.work.search))
    errors = balance_errors(model_of(trial, trial.solve(blocks)), trial.moments(blocks))["error"].drop("pooled")
    return f"balance of {str(errors.idxmax()).replace('dof', 'DOF')}"


def _alternatives(chosen: Finding, tied: Sequence[Finding], drift: float) -> list[str]:
    """Other families: those tied, and friction where a hysteresis turns over within a small part of the drift."""
    families = [f.law.family for f in tied]
    shape = chosen.law.shape
    turn = shape.get("uy") if "uy" in shape else 1.0 / (shape.get("sigma") or np.inf) if "sigma" in shape else np.inf
    if chosen.law.family == "hysteresis" and turn is not None and turn < _ONE_CLASS * drift:
        families.insert(0, "friction")
    return list(dict.fromkeys(families))[: MOST_FAMILIES - 1]


def _step(
    chosen: Finding,
    tied: Sequence[Finding],
    verdict: Verdict,
    before: np.ndarray,
    after: np.ndarray,
    floor: float,
    ranking: Sequence[Finding],
    drift: float,
) -> Step:
    return Step(
        law=chosen.law.name,
        family=chosen.law.family,
        site=str(chosen.site),
        shape=dict(chosen.law.shape),
        alternatives=_alternatives(chosen, tied, drift),
        tied=[(f.law.name, str(f.site), f.error) for f in tied],
        gain=verdict.gain,
        wins=verdict.wins,
        null_gain=verdict.null_gain,
        validation_before=float(np.median(before)),
        validation_after=float(np.median(after)),
        noise_floor=floor,
        evidence=verdict.sentence,
        runners_up=[(f.law.name, str(f.site), f.error) for f in ranking if f is not chosen][:5],
    )


__all__ = ["close_loop", "model_of"]
