"""Close the loop: find the residual, trace it to an effect, add the effect, judge it, repeat."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from .._random import generator
from ..exceptions import BiasWarning, ChannelError, ExcitationError, NRFError
from ..fair_filter import filters_of
from ..free_run import free_run_error
from ..laws.base import ForceLaw
from ..laws.power_series import whole
from ..laws.sensor import ChannelDelay, GainError, SensorFault
from ..regressor import NRFRegressor
from ..segments import BlockRows, SegmentSet
from ..sites import Site
from .away_from_rest import share_to_leave
from .catalogue import SPECIAL_CASES, Candidate, as_laws, balances_of, candidates
from .contradictions import contradictions
from .floor_source import FloorSource
from .gate import FLOOR, MEMBER_GAIN, MIN_GAIN, MIN_WINS, Verdict, choose, gain_of, judge
from .likeliest import likeliest
from .prepare import Prepared, prepare
from .reestimate import needless, place_of, reestimated
from .report import LoopReport, Scene, Step, audit
from .search import Finding, refine, screen, validate
from .second_opinion import confirmed
from .sensors import SensorFinding, sensor_findings, sharpened_again
from .spectral_lines import lines_of
from .splits import split
from .stage import Stage, Trial
from .standing import SURE, Standing, doubt_what_is_drawn, estimate, wrong_by_noise
from .steps import corrected_again, doubt_names, improper, remainder, step_of, surely_left, worst
from .surrogate import Null
from .together import look_ahead, pair_instead
from .workspace import Workspace

_SHORTLIST = 14
_VALIDATED = 10
# Candidates put to the gate, each with fewer parameters than the one before.
_DECISIONS = 3
# A candidate that does not even do this on the data it is fitted to cannot pass the gate.
_HOPELESS = 0.05
# Share of the effect (noise taken off) that may stay unexplained in the median block before a name is no longer sure;
# what stays at least, whatever chance did, may be SURE.
_USUALLY = 0.25
# Balance error, percent, far above noise, beyond which nothing is explained, however bad it was before.
_OPEN = 50.0
# An effect that makes the free run on the search data worse than this many times is none, unless the balance
# error falls by so much that another missing effect must be to blame.
_WORSE_ALONE = 1.3
_BEYOND_DOUBT = 0.5
_FAULTS: dict[str, SensorFault] = {law.name: law for law in (GainError(), ChannelDelay())}


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
    noise_floor: Any = "channels",
    progress: bool = False,
) -> LoopReport:
    """Find the effects a model lacks, add them, and report the error before and after.

    The records are fused (:class:`KinematicSmoother`), cut into contiguous blocks of equal energy,
    and a quarter of each, between blocks of the search (or the records in ``heldout``), is put aside
    until the last line.
    Every law of the catalogue is tried at every site where it makes sense: its columns are built
    from the raw motion, filtered like the rest, and the whole chain is solved again with it (variable
    projection). The best is accepted if the median error over blocks it was not fitted to falls by
    at least 15 %, in at least 80 % of the blocks, by more than the same law gains on surrogates that
    hold the same noise and no effect, and if the model's free run does not get worse. Where none passes
    alone, the best of several sites are put to the gate together. After each, the shape parameters of
    all are estimated again and what a later effect made needless is taken out. Then the next is looked
    for. A law of the family of an earlier one at its site takes its place, or stands beside it where both are missed;
    a fault of a sensor that is corrected again remains one step.

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
        Frequency band, Hz, in which everything is fitted and judged; the baseline's if None. Where displacements were
        not measured, motions and forces begin where the accelerations tell the motion; the report says where. It does
        not change during the search.
    random_state : int, Generator or None
        For the surrogates.
    max_steps : int
        Effects at most.
    n_surrogates : int
        Surrogates for the null reference; 0 leaves it out.
    noise_floor : {"channels", "repeats"}, float, mapping of int to float or NoiseFloor
        What noise alone leaves of the forces, against which residuals, remainders and the certainty of
        names are measured. ``"channels"``: of the surrogates, whose noise is that by which the channels of a DOF
        contradict each other. ``"repeats"``: the records are repetitions of one test, sample by sample, and
        differ by noise. Or the rms of the noise in each balance, N: one number, or by DOF. A floor that is
        measured or given, and so does not rest on the model, also stops the loop where it is reached.
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

    Where the balances are known to be no better than 10 N, that friction of 30 N is still heard, and nothing else:

    >>> report = close_loop(simulate(truth, F, 1e-3), noise_floor={1: 10.0, 2: 10.0})
    >>> [step.law for step in report.steps], "noise" in report.stopped_because
    (['coulomb_friction'], True)
    """
    baseline = baseline if baseline is not None else NRFRegressor(degree=1)
    if not isinstance(baseline, NRFRegressor):
        raise NRFError(f"baseline={baseline!r} is not a model to begin with", "Give e.g. NRFRegressor(degree=1).")
    max_steps, n_surrogates = whole("max_steps", max_steps), whole("n_surrogates", n_surrogates)
    rng = generator(random_state)
    band = band if band is not None else baseline.band
    ready = prepare(records, heldout)
    floors = FloorSource(noise_floor, ready.data.n_dof)
    search, held = split(ready.data.segments, ready.heldout)
    given = baseline._given_laws()
    chain = baseline._chain(ready.data.n_dof, given)
    known = baseline._known_masses(chain)
    filters = filters_of(band, ready.data)
    work = Workspace(ready.data, filters, search, held, known, baseline.strategy)
    if not work.forced and not known:
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            "Give the baseline known_masses={dof: kg}.",
        )
    first = _baseline_laws(baseline, chain, given, work)
    _require_covariates(first, ready)
    _say_what_is_not_used(baseline)
    names = tuple(c for c in ready.data.segments[0].covariates if all(c in s.covariates for s in ready.data.segments))
    tried = as_laws(catalogue, names)
    every = list(candidates(tried, chain, known, names, work.forced, len(work.searched)))
    sensors = [law for law in tried if law.family == "sensor"]
    loop = _Loop(ready, work, every, sensors, floors, rng, n_surrogates, progress)
    with threadpool_limits(1):  # the matrices are small: threads only get in each other's way
        report = loop.run(Stage(work, chain, first), max_steps, band if band is not None else ready.band)
    words = floors.words if n_surrogates or floors.measured else "not known: no surrogates were run"
    report.settings = audit(baseline, tried, band, random_state, max_steps, n_surrogates, ready, words)
    return report


def _baseline_laws(baseline: NRFRegressor, chain: Any, given: Any, work: Workspace) -> dict[Site, tuple[ForceLaw, ...]]:
    laws = baseline._laws(chain, given)
    if any(law.free_shape for held in laws.values() for law in held):
        from sklearn.base import clone

        fresh = clone(baseline)
        part = SegmentSet([piece for _, piece in work.pieces()], work.data.n_samples)
        fresh._fit(part, given, part)
        return {s: tuple(law for law in held) for s, held in fresh.model_.laws.items()}
    return laws


def _require_covariates(laws: Mapping[Site, Sequence[ForceLaw]], ready: Prepared) -> None:
    """Every record, held-out ones too, has what the declared laws need."""
    for site, held in laws.items():
        needed = {name: law.name for law in held for name in law.covariates}
        for seg in ready.data.segments:
            for name in needed.keys() - seg.covariates.keys():
                raise ChannelError(
                    f"Record {seg.name!r} has no covariate {name!r}, which {needed[name]} at {site} needs",
                    "Give it in covariates=, or leave the record out.",
                )


def _say_what_is_not_used(baseline: NRFRegressor) -> None:
    """The search is least squares: what else the baseline asks for has no part in it."""
    asked = [f"estimation={baseline.estimation!r}"] if baseline.estimation != "ls" else []
    asked += [f"{name}=" for name in ("constraints", "optimizer") if getattr(baseline, name) is not None]
    if asked:
        warnings.warn(
            f"close_loop fits by plain least squares and does not use {', '.join(asked)} of the baseline. Fit "
            "NRFRegressor(laws=report.model.laws, ...) with it to the records afterwards.",
            BiasWarning,
            stacklevel=3,
        )


class _Loop:
    """One run of the loop: what stays the same from step to step."""

    def __init__(
        self,
        ready: Prepared,
        work: Workspace,
        every: Sequence[Candidate],
        sensors: Sequence[ForceLaw],
        floors: FloorSource,
        rng: np.random.Generator,
        n_surrogates: int,
        progress: bool,
    ) -> None:
        self.ready, self.work, self.every = ready, work, every
        self.rng, self.n_surrogates, self.progress = rng, n_surrogates, progress
        self.sensors, self.floors = sensors, floors
        self.accepted: list[Finding] = []
        self.told: list[tuple[Finding, Step]] = []

    def run(self, stage: Stage, max_steps: int, band: Any) -> LoopReport:
        """Walk through the four rooms until there is a reason to stop."""
        trial = stage.trial()
        steps: list[Step] = []
        stopped = f"{max_steps} effects were added, which is the limit set by max_steps"
        null = Null(self.ready, stage, self.rng, self.n_surrogates)
        scenes = [Scene("baseline", trial, trial.fold_errors(), null, self.floors.of(trial))]
        ranking: list[Finding] = []
        measured = self.ready  # channels that turn out faulty are corrected further on
        for _ in range(2 * max_steps):
            before = scenes[-1].folds
            if len(steps) >= max_steps:
                break
            if np.median(before) < FLOOR:
                stopped = f"The balance closes within {np.median(before):.2g} % on the search data, nothing is left"
                break
            if self.floors.closes(trial, float(np.median(before)), null):
                rest = f"{np.median(before):.3g} % are left on the search data"
                stopped = f"{rest}, no more than noise ({self.floors.words})"
                break
            ranking = self._findings(stage, trial, steps)
            if not ranking:
                stopped = "No law of the catalogue lowers the error at any site"
                break
            members, verdict = self._decide(stage, ranking, before, null, max_steps - len(steps))
            if not verdict.accepted:
                chosen = members[0][0]
                best = f"{chosen.law.name} at {chosen.site}"
                stopped = f"No further effect is supported: the best candidate is {best}, but {verdict.sentence}"
                break
            untested = not null.stages
            for chosen, tied in members:
                stage, gone = self._with(stage, chosen, chosen is members[-1][0])
                for law in gone:
                    k = next(k for k, s in enumerate(steps) if s is self._told(law))
                    del steps[k], scenes[k + 1]
                before = scenes[-1].folds
                trial = stage.trial()
                after = trial.fold_errors()
                null = Null(self.ready, stage, self.rng, self.n_surrogates)
                if isinstance(chosen, SensorFinding) and corrected_again(steps, chosen, verdict, scenes[-2:], after):
                    scenes[-1] = Scene(scenes[-1].name, trial, after, null, self.floors.of(trial))
                    continue
                floor = self.floors.percent(trial, null)
                step = step_of(chosen, tied, verdict, before, after, floor, ranking, self._drift(chosen))
                beside = [f"{f.law.name} at {f.site}" for f, _ in members if f is not chosen]
                step.evidence += f" (together with {' and '.join(beside)})" if beside else ""
                step.evidence += "".join(f"; it makes {f.law.name} at {f.site} needless" for f in gone)
                step.null_gain = np.nan if untested else step.null_gain
                steps.append(step)
                self.told.append((chosen, step))
                scenes.append(Scene(f"{step.law} at {step.site}", trial, after, null, self.floors.of(trial)))
        plain = stage
        for step in self._found_too_early(steps):
            stage = self._sharper(stage, step)
        if stage is not plain:
            trial = stage.trial()
            null = Null(self.ready, stage, self.rng, self.n_surrogates)
            scenes[-1] = Scene(scenes[-1].name, trial, trial.fold_errors(), null, self.floors.of(trial))
            steps[-1].validation_after = float(np.median(scenes[-1].folds))
        floor, left = self.floors.percent(trial, null), float(np.median(scenes[-1].folds))
        noise = [] if self.floors.measured else [s.trial().fold_errors() for s in null.stages]
        least = surely_left(scenes[-1].folds, noise)
        for step in steps:
            step.remainder = remainder(step.validation_before, left, floor)
            open_still = least > _OPEN and not least <= 2.0 * floor
            surely = remainder(step.validation_before, least, floor)
            step.sure = surely <= SURE and step.remainder <= _USUALLY and not open_still
        standing = self._standing(stage)
        away = share_to_leave(stage) if standing else None
        fitted = null if away is None else Null(self.ready, stage, self.rng, self.n_surrogates, away=away)
        scenes[-1].found = estimate(standing, stage, fitted)
        doubt_what_is_drawn(standing, stage, null, self.ready.clean)
        for k in reversed(range(len(steps))):  # what later had to be added at its site was not said by its name
            later = [s for s in steps[k + 1 :] if balances_of(Site(s.site)) == balances_of(Site(steps[k].site))]
            doubtful = improper(steps[k].law, steps[k].intervals) or not all(s.sure for s in later)
            steps[k].sure = steps[k].sure and not doubtful
        doubt_names(steps)
        if np.isfinite(floor) and left > max(2.0 * floor, FLOOR):
            alone = f"(noise alone leaves about {floor:.2g} %)"
            stopped += f". {left:.3g} % stay unexplained by any law of the catalogue {alone}, "
            stopped += f"most in the {worst(trial)}"
        if null.stages and (much := wrong_by_noise(standing, stage, fitted, self.ready)):
            stopped += f". By noise alone least squares is wrong by up to {', '.join(much)}: fit "
            stopped += "NRFRegressor(laws=report.model.laws, estimation='iv', ...) to the records, which noise does "
            stopped += "not bias"
        if said := contradictions(self.ready, self.work) if self.sensors else []:
            stopped += f". Channels contradict each other, and the fusion made the best of it: {'; '.join(said)}"
        return LoopReport.assemble(self.work, scenes, steps, stopped, ranking, band, measured)

    def _found_too_early(self, steps: Sequence[Step]) -> list[Step]:
        """Gains and delays that were estimated before all effects were known; a wrong zero has its own place."""
        last = max((k for k, step in enumerate(steps) if step.family != "sensor"), default=-1)
        return [step for step in steps[: last + 1] if step.law in _FAULTS]

    def _sharper(self, stage: Stage, step: Step) -> Stage:
        """The stage on records whose fault was estimated again beside all laws."""
        fault = _FAULTS[step.law].with_values([float(v or 0.0) for v in step.parameters.values()])
        found = sharpened_again(self.ready, self.work, stage, fault, Site(step.site))
        if found is None:
            return stage
        more, half = found
        assert isinstance(more.law, SensorFault) and more.ready is not None
        if more.screen < stage.trial().search_error():
            whole = fault.followed_by(more.law)
            step.parameters = whole.parameters
            step.evidence += f"; beside all laws of the model {whole.terms()[0].symbol} = {whole.values[0]:.4g}"
            stage = more.on(stage)
            self.ready, self.work = more.ready, stage.work
            stage = reestimated(stage, self.accepted)
        symbol, value = next((k, float(v or 0.0)) for k, v in step.parameters.items())
        step.intervals = {symbol: (value - half, value + half)}
        return stage

    def _findings(self, stage: Stage, trial: Trial, steps: Sequence[Step]) -> list[Finding]:
        """Validated candidates, best first."""
        now = trial.search_error()
        accepted = [(f.site, f.law.name) for f in self.accepted]
        lines = lines_of(trial)
        bar, tick = None, None
        if self.progress:
            from tqdm.auto import tqdm

            bar = tqdm(
                total=len(self.every), desc=f"search {len(steps) + 1}", unit="candidate", leave=False, disable=None
            )
            tick = bar.update
        found = screen(stage, self.every, accepted, lines, tick, both=True)
        if bar is not None:
            bar.close()
        hopeful = [f for f in found if f.screen < now * (1 - _HOPELESS)][:_SHORTLIST]
        # a law that takes the place of a simpler one starts from where that stands
        hopeful += [f for f in found if f.drop and len(f.candidate.law.free_shape) > 1 and not _holds(hopeful, f)]
        refined = sorted((refine(stage, f) for f in hopeful), key=lambda f: f.screen)[:_VALIDATED]
        special = {(balances_of(f.site), name) for f in refined[:3] for name in SPECIAL_CASES.get(f.law.name, ())}
        simple = [f for f in found if (balances_of(f.site), f.law.name) in special and not _holds(refined, f)]
        refined += [refine(stage, f) for f in simple]
        judged = _missed([validate(stage, f) for f in refined])
        corrected = {(s.law, s.site) for s in steps if s.family == "sensor"}
        judged += sensor_findings(self.ready, self.work, stage, self.sensors, corrected)
        return sorted((f for f in judged if np.isfinite(f.error)), key=lambda f: f.error)

    def _decide(
        self, stage: Stage, ranking: list[Finding], before: np.ndarray, null: Null, most: int
    ) -> tuple[list[tuple[Finding, list[Finding]]], Verdict]:
        """The best candidate that passes the gate, or several together; the best of all where none does."""
        first = None
        left = list(ranking)
        for _ in range(_DECISIONS):
            chosen, tied = choose(left, float(np.median(before)))
            chosen = self._polished(stage, chosen)
            least = chosen.least if isinstance(chosen, SensorFinding) else MIN_GAIN
            verdict = judge(before, chosen.folds, chosen.n_added, least=least)
            if verdict.accepted:  # what the floor asks of a sensor's fault, its gain on surrogates has in it
                at_floor = null.reached and not isinstance(chosen, SensorFinding)
                verdict = judge(before, chosen.folds, chosen.n_added, null.gain(chosen), least, at_floor)
            passed = verdict.accepted
            if passed:
                verdict = self._alone(stage, chosen.on(stage), verdict)
            named = chosen, tied
            if verdict.accepted:
                if not isinstance(chosen, SensorFinding) and not self.ready.clean:
                    other = likeliest(stage, chosen, tied, ranking, before, self._null)
                    own = verdict if other[0] is chosen else self._judged(stage, other[0], before, null)
                    named, verdict = (other, own) if own.accepted else (named, verdict)
                corrected = named[0].ready if isinstance(named[0], SensorFinding) else None
                verdict = confirmed(verdict, stage, named[0].on(stage), null, corrected)
                if verdict.accepted:
                    pair = pair_instead(stage, named[0], self.every, before, null) if most > 1 else None
                    return self._run_together(stage, pair) or ([named], verdict)
                noisy = balances_of(named[0].site)  # what noise does there, other laws imitate too
                left = [f for f in left if balances_of(f.site) != noisy]
            first = first or ([named], verdict)
            if passed:  # but its free run is worse: the next best, however many parameters it has
                left = [f for f in left if (f.site, f.law.name, f.drop) != (chosen.site, chosen.law.name, chosen.drop)]
            else:
                left = [f for f in left if f.n_parameters < chosen.n_parameters]
            if not left:
                break
        assert first is not None
        return self._run_together(stage, look_ahead(stage, ranking, before, null, most)) or first

    def _run_together(
        self, stage: Stage, found: tuple[list[tuple[Finding, list[Finding]]], Verdict] | None
    ) -> tuple[list[tuple[Finding, list[Finding]]], Verdict] | None:
        """Several effects that passed the gate as one, unless the free run of all of them is worse."""
        if found is None:
            return None
        members, verdict = found
        whole = stage
        for finding, _ in members:
            whole = finding.on(whole)
        verdict = self._alone(stage, whole, verdict)
        return (members, verdict) if verdict.accepted else None

    def _judged(self, stage: Stage, finding: Finding, before: np.ndarray, null: Null) -> Verdict:
        """The verdict on a law by the gate, on surrogates and in its free run."""
        verdict = judge(before, finding.folds, finding.n_added, null.gain(finding), at_floor=null.reached)
        return self._alone(stage, finding.on(stage), verdict) if verdict.accepted else verdict

    def _null(self, stage: Stage) -> Null:
        """A single surrogate of a model."""
        return Null(self.ready, stage, self.rng, min(1, self.n_surrogates))

    def _alone(self, stage: Stage, with_it: Stage, verdict: Verdict) -> Verdict:
        """The verdict after a look at the free run on the search data, where one is possible."""
        before, after = self._free_run(stage), self._free_run(with_it)
        if not before < 100.0 or after <= _WORSE_ALONE * before:
            return verdict
        much = f"rises from {before:.3g} to {after:.3g} %" if np.isfinite(after) else f"({before:.3g} %) diverges"
        if verdict.gain >= _BEYOND_DOUBT:
            return replace(verdict, sentence=f"{verdict.sentence}; the free run {much}, so more is missing")
        return replace(verdict, accepted=False, sentence=f"{verdict.sentence}, but its free run {much}")

    def _free_run(self, stage: Stage) -> float:
        """Free-run error on the search blocks that each record begins with, percent; NaN where none is possible."""
        work, blocks = stage.work, []
        for i in work.searched:
            run = work.runs(i)[0]
            blocks.append(BlockRows(i, run))
        try:
            return free_run_error(stage.trial().model(), work, blocks)
        except NRFError:
            return float("nan")

    def _polished(self, stage: Stage, chosen: Finding) -> Finding:
        """The chosen candidate with its shape parameters refined to the end."""
        if not chosen.candidate.law.free_shape:
            return chosen
        finer = validate(stage, refine(stage, chosen, 120 * len(chosen.candidate.law.free_shape)))
        return finer if finer.error <= chosen.error * 1.02 else chosen

    def _with(self, stage: Stage, chosen: Finding, last: bool) -> tuple[Stage, list[Finding]]:
        """The stage with an accepted candidate, all shapes estimated again, and the laws it made needless.

        Of effects that are accepted together, only the last shows which earlier ones are.
        """
        replaced = [f for f in self.accepted if place_of(stage, f, self.accepted) in chosen.drop]
        stage = chosen.on(stage)
        self.accepted = [f for f in self.accepted if not any(f is r for r in replaced)]
        if isinstance(chosen, SensorFinding):
            assert chosen.ready is not None
            self.ready, self.work = chosen.ready, stage.work
        else:
            self.accepted.append(chosen)
        stage = reestimated(stage, self.accepted)
        gone: list[Finding] = []
        while last and (weakest := needless(stage, self.accepted)) is not None:
            place = place_of(stage, weakest, self.accepted)
            assert place is not None
            self.accepted = [f for f in self.accepted if f is not weakest]
            stage = reestimated(Stage(stage.work, stage.chain, stage.without([place])), self.accepted)
            gone.append(weakest)
        return stage, gone

    def _standing(self, stage: Stage) -> list[Standing]:
        """Accepted effects that the final model holds and a step tells of."""
        every = [(f, self._told(f), place_of(stage, f, self.accepted)) for f in self.accepted]
        return [Standing(f, step, place) for f, step, place in every if step is not None and place is not None]

    def _told(self, finding: Finding) -> Step | None:
        """The step that tells of an accepted effect."""
        return next((step for f, step in self.told if f is finding), None)

    def _drift(self, chosen: Finding) -> float:
        """Rms drift of a site, m; zero for a sensor."""
        return 0.0 if isinstance(chosen, SensorFinding) else self.work.scales(chosen.site)[0]


def _holds(findings: Sequence[Finding], one: Finding) -> bool:
    return any((f.site, f.drop) == (one.site, one.drop) and f.candidate.law == one.candidate.law for f in findings)


def _missed(judged: Sequence[Finding]) -> list[Finding]:
    """Without those beside an earlier law that is hardly missed where they take its place."""
    out = []
    for f in judged:
        instead = [
            g for g in judged
            if g.candidate == f.candidate and len(g.drop) > len(f.drop) and np.isfinite(g.error) and g is not f
        ]  # fmt: skip
        if all(gain_of(g.folds, f.folds) >= MEMBER_GAIN and np.mean(f.folds < g.folds) >= MIN_WINS for g in instead):
            out.append(f)
    return out


__all__ = ["close_loop"]
