"""Round after round: look for a further effect, decide, add it, until there is a reason to stop."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ..exceptions import NRFError
from ..laws.sensor import SensorFault
from ..mechanics.sites import Site
from ..regression.errors import free_run_error
from ..regression.segments import BlockRows
from .catalogue import Candidate, balances_of
from .floor_source import FloorSource
from .gate import FLOOR, MEMBER_GAIN, MIN_GAIN, MIN_WINS, Verdict, choose, gain_of, judge
from .likeliest import likeliest
from .noise_floor import AT_FLOOR
from .prepare import Prepared
from .ranking import ranked
from .reestimate import needless, place_of, reestimated
from .report import Scene, Step
from .search import Finding, parameters_of, refine, validate
from .second_opinion import confirmed
from .sensors import SensorFinding, sensor_findings, sharpened_again
from .stage import Stage
from .standing import Standing
from .steps import corrected_again, step_of, weigh
from .surrogate import Null
from .together import both_missed, look_ahead, pair_instead
from .workspace import Workspace

# Candidates put to the gate, each with fewer parameters than the one before.
_DECISIONS = 3
# An effect that makes the free run on the search data worse than this many times is none, unless the balance
# error falls by so much that another missing effect must be to blame.
_WORSE_ALONE = 1.3
_BEYOND_DOUBT = 0.5
# Candidates beside which a second effect is looked for where none passes.
_FIRSTS = 2


class Rounds:
    """One way from the baseline to a reason to stop.

    Parameters
    ----------
    ready : Prepared
    work : Workspace
    every : sequence of Candidate
    sensors : sequence of SensorFault
        Faults of sensors that are tried.
    floors : FloorSource
    rng : Generator
    n_surrogates : int
    progress : bool
    not_first : collection of str
        Places, see :func:`place_words`, at which the first effect is not looked for.
    enough : float, optional
        Look hastily, without surrogates and second opinions, for what leaves more than this, percent.

    Attributes
    ----------
    stage, trial, null : Stage, Trial, Null
        The current model.
    scenes, steps : list of Scene, list of Step
        The baseline and the model after each step; the effects that were added.
    ranking : list of Finding
        Candidates of the last round, best first.
    stopped : str
        Why it ended.
    begun : str or None
        Where the first effect was added.
    measured : Prepared
        The records, before any fault of a sensor was corrected.
    opening : list of Finding or None
        Candidates of the first round, wherever they stand.
    fitted : Null
        Of the final model on the samples to which it is fitted.
    """

    def __init__(
        self,
        ready: Prepared,
        work: Workspace,
        every: Sequence[Candidate],
        sensors: Sequence[SensorFault],
        floors: FloorSource,
        rng: np.random.Generator,
        n_surrogates: int,
        progress: bool,
        not_first: Collection[str] = (),
        enough: float | None = None,
    ) -> None:
        self.ready, self.work, self.every = ready, work, every
        self.rng, self.n_surrogates, self.progress = rng, n_surrogates, progress
        self.sensors, self.floors, self.not_first, self.enough = sensors, floors, frozenset(not_first), enough
        self.measured, self.stopped = ready, ""
        self.begun: str | None = None
        self.accepted: list[Finding] = []
        self.told: list[tuple[Finding, Step]] = []
        self.scenes: list[Scene] = []
        self.steps: list[Step] = []
        self.ranking: list[Finding] = []
        self.opening: list[Finding] | None = None

    def go(self, stage: Stage, max_steps: int) -> None:
        """SolveOrder through the four rooms until there is a reason to stop."""
        steps, scenes = self.steps, self.scenes
        if not scenes:
            self._stand_on(stage)
            scenes.append(self._scene("baseline"))
        self.stopped = f"{max_steps} effects were added, which is the limit set by max_steps"
        for _ in range(2 * max_steps):
            before = scenes[-1].folds
            if len(steps) >= max_steps:
                break
            if np.median(before) < FLOOR:
                least = f"{np.median(before):.2g} %"
                self.stopped = f"The balance closes within {least} on the search data, nothing is left"
                break
            if self.floors.closes(self.trial, float(np.median(before)), self.null):
                rest = f"{np.median(before):.3g} % are left on the search data"
                self.stopped = f"{rest}, no more than noise ({self.floors.words})"
                break
            self.ranking = self._findings(self.stage, steps) if self.begun else self._beginnings()
            if not self.ranking:
                self.stopped = "No law of the catalogue lowers the error at any site"
                break
            members, verdict = self._decide(self.stage, self.ranking, before, self.null, max_steps - len(steps))
            if not verdict.accepted:
                chosen = members[0][0]
                best = f"{chosen.law.name} at {chosen.site}"
                self.stopped = f"No further effect is supported: the best candidate is {best}, but {verdict.sentence}"
                break
            untested = not self.null.stages
            self.begun = self.begun or place_words(members[0][0])
            for chosen, tied in members:
                stage, gone = self._with(self.stage, chosen, chosen is members[-1][0])
                for law in gone:
                    k = next(k for k, s in enumerate(steps) if s is self._told(law))
                    del steps[k], scenes[k + 1]
                before = scenes[-1].folds
                self._stand_on(stage)
                after = self.trial.fold_errors()
                if isinstance(chosen, SensorFinding) and corrected_again(steps, chosen, verdict, scenes[-2:], after):
                    scenes[-1] = self._scene(scenes[-1].name)
                    continue
                floor = self.floors.percent(self.trial, self.null)
                step = step_of(chosen, tied, verdict, before, after, floor, self.ranking, self._drift(chosen))
                beside = [f"{f.law.name} at {f.site}" for f, _ in members if f is not chosen]
                step.evidence += f" (together with {' and '.join(beside)})" if beside else ""
                step.evidence += "".join(f"; it makes {f.law.name} at {f.site} needless" for f in gone)
                step.null_gain = np.nan if untested else step.null_gain
                steps.append(step)
                self.told.append((chosen, step))
                scenes.append(self._scene(f"{step.law} at {step.site}"))
            if self.enough is None:
                sharpen(self)
        self.weigh()

    def _stand_on(self, stage: Stage) -> None:
        """Make a stage the current model."""
        self.stage, self.trial = stage, stage.trial()
        hasty = self.enough is not None
        self.null = self.fitted = Null(self.ready, stage, self.rng, self.n_surrogates, hasty=hasty)

    def _scene(self, name: str) -> Scene:
        """The current model as a scene of the report."""
        return Scene(name, self.trial, self.trial.fold_errors(), self.null, self.floors.of(self.trial))

    def sharpened(self, stage: Stage) -> None:
        """Put the same laws on records that were corrected again in the place of the current model."""
        self._stand_on(stage)
        self.scenes[-1] = self._scene(self.scenes[-1].name)
        self.steps[-1].validation_after = self.left
        self.weigh()

    def weigh(self) -> None:
        """Say of every step how much of it stays unexplained, and whether its name is sure."""
        noise = [] if self.floors.measured else [s.trial().fold_errors() for s in self.null.stages]
        weigh(self.steps, self.scenes[-1].folds, self.floor, noise)

    @property
    def left(self) -> float:
        """Median validation error of the current model, percent."""
        return float(np.median(self.scenes[-1].folds))

    @property
    def floor(self) -> float:
        """What noise alone leaves of it, percent; NaN if unknown."""
        return self.floors.percent(self.trial, self.null)

    @property
    def unexplained(self) -> bool:
        """Whether clearly more is left than noise."""
        return bool(np.isfinite(self.floor)) and self.left > max(2.0 * self.floor, FLOOR)

    @property
    def doubtful(self) -> bool:
        """Whether effects were added and do not explain what there is."""
        return bool(self.steps) and (self.unexplained or not all(step.sure for step in self.steps))

    def elsewhere(self) -> Rounds:
        """Hasty rounds over the same records that begin neither where these began nor where they were not to."""
        enough = self.floor if self.enough is None else self.enough
        return self._again(self.not_first | ({self.begun} if self.begun else set()), enough)

    def in_earnest(self) -> Rounds:
        """The same rounds with surrogates and second opinions."""
        return self._again(self.not_first, None)

    def _again(self, not_first: Collection[str], enough: float | None) -> Rounds:
        first = self.scenes[0]
        other = Rounds(
            self.measured, first.trial.work, self.every, self.sensors, self.floors, self.rng, self.n_surrogates,
            self.progress, not_first, enough,
        )  # fmt: skip
        other.stage, other.trial = first.trial.stage, first.trial
        hasty = Null(self.measured, other.stage, self.rng, 0, hasty=True)
        other.null = other.fitted = first.null if enough is None else hasty
        other.scenes, other.opening = [first], self.opening
        return other

    def instead_of(self, other: Rounds) -> Verdict:
        """Whether these explain clearly more of the search data than others and, if not all of it, run as well."""
        more = sum(parameters_of(law) for held in self.stage.laws.values() for law in held)
        more -= sum(parameters_of(law) for held in other.stage.laws.values() for law in held)
        verdict = judge(other.scenes[-1].folds, self.scenes[-1].folds, max(more, 1))
        judged = verdict.accepted and self.doubtful and self.enough is None
        return self.alone(other.stage, self.stage, verdict) if judged else verdict

    def _beginnings(self) -> list[Finding]:
        """Candidates with which these rounds may begin, best first."""
        if self.opening is None:
            self.opening = self._findings(self.stage, ())
        return [f for f in self.opening if place_words(f) not in self.not_first]

    def _findings(self, stage: Stage, steps: Sequence[Step]) -> list[Finding]:
        """Validated candidates, best first."""
        found = ranked(stage, self.every, self.accepted, len(steps) + 1, self.progress)
        corrected = {(s.law, s.site) for s in steps if s.is_fault}
        faulty = sensor_findings(self.ready, self.work, stage, self.sensors, corrected)
        return sorted((f for f in [*found, *faulty] if np.isfinite(f.error)), key=lambda f: f.error)

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
                verdict = self.alone(stage, chosen.on(stage), verdict)
            named = chosen, tied
            if verdict.accepted:
                if not (isinstance(chosen, SensorFinding) or self.ready.clean or null.hasty):
                    other = likeliest(chosen.under(stage), chosen, tied, ranking, before, self._null)
                    own = verdict if other[0] is chosen else self._judged(stage, other[0], before, null)
                    named, verdict = (other, own) if own.accepted else (named, verdict)
                corrected = named[0].ready if isinstance(named[0], SensorFinding) else None
                verdict = confirmed(verdict, stage, named[0].on(stage), null, corrected)
                if verdict.accepted:
                    best = named[0]
                    pair = pair_instead(best.under(stage), best, self.every, before, null) if most > 1 else None
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
        together = self._run_together(stage, look_ahead(stage, ranking, before, null, most))
        return together or self._run_together(stage, self._hidden(stage, ranking, before, null, most)) or first

    def _hidden(
        self, stage: Stage, ranking: Sequence[Finding], before: np.ndarray, null: Null, most: int
    ) -> tuple[list[tuple[Finding, list[Finding]]], Verdict] | None:
        """Two effects that pass the gate together, where the second shows beside the first alone."""
        if most < 2 or null.reached or (self.enough is not None and np.median(before) <= AT_FLOOR * self.enough):
            return None
        firsts: dict[str, Finding] = {}
        for f in ranking:
            missed = gain_of(before, f.folds) >= MEMBER_GAIN and np.mean(f.folds < before) >= MIN_WINS
            if type(f) is Finding and not f.drop and missed:
                firsts.setdefault(place_words(f), f)
        for first in list(firsts.values())[:_FIRSTS]:
            under = first.on(stage)
            found = ranked(under, self.every, [*self.accepted, first], len(self.steps) + 2, self.progress)
            other = [f for f in found if np.isfinite(f.error) and not f.drop and place_words(f) != place_words(first)]
            other.sort(key=lambda f: f.error)
            if other and (pair := both_missed(stage, first, *choose(other, first.error), before, null)):
                return pair
        return None

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
        verdict = self.alone(stage, whole, verdict)
        return (members, verdict) if verdict.accepted else None

    def _judged(self, stage: Stage, finding: Finding, before: np.ndarray, null: Null) -> Verdict:
        """The verdict on a law by the gate, on surrogates and in its free run."""
        verdict = judge(before, finding.folds, finding.n_added, null.gain(finding), at_floor=null.reached)
        return self.alone(stage, finding.on(stage), verdict) if verdict.accepted else verdict

    def _null(self, stage: Stage) -> Null:
        """A single surrogate of a model."""
        return Null(self.ready, stage, self.rng, min(1, self.n_surrogates))

    def alone(self, stage: Stage, with_it: Stage, verdict: Verdict) -> Verdict:
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
        """The stage with an accepted candidate, all shapes estimated again, and the laws it made needless."""
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

    def standing(self) -> list[Standing]:
        """Accepted effects that the current model holds and a step tells of."""
        every = [(f, self._told(f), place_of(self.stage, f, self.accepted)) for f in self.accepted]
        return [Standing(f, step, place) for f, step, place in every if step is not None and place is not None]

    def _told(self, finding: Finding) -> Step | None:
        """The step that tells of an accepted effect."""
        return next((step for f, step in self.told if f is finding), None)

    def _drift(self, chosen: Finding) -> float:
        """Rms drift of a site, m; zero for a sensor."""
        return 0.0 if isinstance(chosen, SensorFinding) else self.work.scales(chosen.site)[0]


def place_words(finding: Finding) -> str:
    """Where a candidate stands, as one that rounds may not begin with: a site, or any sensor."""
    return "sensor" if isinstance(finding, SensorFinding) else str(balances_of(finding.site))


def sharpen(rounds: Rounds) -> None:
    """Correct the records once more where that lowers the error, and put the interval of each fault into its step."""
    if all(step.is_fault for step in rounds.steps):
        return
    faults = {law.name: law for law in rounds.sensors if law.acts_on_derivatives}  # a wrong zero has its own place
    stage = rounds.stage
    for step in rounds.steps:
        if step.law in faults:
            stage = _sharper(rounds, stage, step, faults[step.law])
    if stage is not rounds.stage:
        rounds.sharpened(stage)


def _sharper(rounds: Rounds, stage: Stage, step: Step, fault: SensorFault) -> Stage:
    """The stage on records whose fault was estimated again beside all laws."""
    fault = fault.with_values([float(v or 0.0) for v in step.parameters.values()])
    found = sharpened_again(rounds.ready, rounds.work, stage, fault, Site(step.site))
    if found is None:
        return stage
    more, half = found
    assert isinstance(more.law, SensorFault) and more.ready is not None
    if more.screen < stage.trial().search_error():
        whole = fault.followed_by(more.law)
        step.parameters = whole.parameters
        step.evidence += f"; beside all laws of the model {whole.terms()[0].symbol} = {whole.values[0]:.4g}"
        stage = more.on(stage)
        rounds.ready, rounds.work = more.ready, stage.work
        stage = reestimated(stage, rounds.accepted)
    symbol, value = next((k, float(v or 0.0)) for k, v in step.parameters.items())
    step.intervals = {symbol: (value - half, value + half)}
    return stage


__all__ = ["Rounds", "place_words"]
