"""The end of the search: confirmation on held-out data, intervals, certainty, safeguards, the report."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from ..common.jackknife import variance
from ..estimation.intervals import parameters_of
from ..exceptions import NRFError
from ..laws.friction import CoulombFriction
from ..laws.general import PrandtlIshlinskii, SmoothSurface
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.segments import VisitedRegion
from . import judge, words
from .catalogue import balances_of
from .constants import BY_NOISE, COMPLETE, FAR, HOPELESS, LEAST_GAIN, PERIODS, TENTH
from .evidence import Evidence, look
from .prepare import Workspace, measured_of
from .report import LoopReport, Step, audit
from .residual import floor_of, loops_of, searched, simulated
from .ruler import Gain, Powers, Ruler, Slot, Trial
from .search import Forward
from .sensors import contradictions
from .state import Axes, Effect, State
from .windows import Windows

LEVEL = 0.95


@dataclass
class Stand:
    """A model on the way to the last one, judged on the search and on held-out data."""

    name: str
    trial: Trial
    held: Powers
    row: dict[str, float]

    @property
    def error(self) -> float:
        """Pooled held-out error, percent."""
        return self.row["held-out"]


def concluded(forward: Forward, first: State, settings: Mapping[str, Any], rng: np.random.Generator) -> LoopReport:
    """The report of a search that has come to its end; the held-out data are read here."""
    stands = [_stand("baseline", first.trial)]
    steps: list[Step] = []
    confirmed = stands[0]
    refused: list[tuple[Step, Stand]] = []
    waiting = list(forward.state.effects)
    while waiting:  # what held-out data do not confirm alone may be confirmed beside the rest
        again, refused = [], []
        for effect in waiting:
            try:
                before, after = _pair(forward, confirmed, effect)
            except NRFError:
                continue
            step = _step(forward, effect, before, after)
            if step.confirmed:
                steps.append(step)
                stands.append(after)
                confirmed = after
            else:
                again.append(effect)
                refused.append((step, after))
        if len(again) == len(waiting):
            break
        waiting = again
    for step, stand in refused:
        if step.gain >= LEAST_GAIN:
            steps.append(step)
            stands.append(stand)
    if not confirmed.trial.ruler.windows.centred:  # one ruler for the table: that of the last model
        stands = [_as_measured(stand) for stand in stands]
    stopped = _why_stopped(forward, settings["max_steps"])
    no_claim = _no_claim(confirmed)
    if no_claim:
        stopped = f"{no_claim}. Nothing is claimed"
        steps, stands, confirmed = [], stands[:1], stands[0]
    general = _general(confirmed, forward)
    there = general[general["there"]]
    if len(there) and not no_claim and len(forward.state.effects) < settings["max_steps"]:
        stopped += f". {words.not_in_catalogue(there)}"
    made = simulated(forward.state.ready, confirmed.trial.on_part(), rng) if forward.state.ready is not None else None
    noise = None if made is None else made[1]
    _say_how_sure(steps, confirmed, noise)
    report = _report(forward, first, settings, steps, stands, confirmed, noise, stopped)
    report.lack_of_fit = general.drop(columns="there")
    report.bounds = _bounds(confirmed.trial)
    return report


def _general(final: Stand, forward: Forward) -> pd.DataFrame:
    """What the general law without memory and the general hysteresis still gain at each storey and tie, dB."""
    trial = final.trial.on_part()
    rows = {}
    for site in trial.chain.sites:
        drift, rate, *_ = trial.ruler.work.scales(site)
        for law in (SmoothSurface(S=drift, V=0.2 * rate), PrandtlIshlinskii(uy=2.0 * drift)):
            try:
                after = trial.with_laws([(site, law)])
            except NRFError:  # its columns depend on those of the model
                continue
            gain = after.gain_over(trial)
            there = judge.is_there(gain) and gain.value > FAR * gain.error
            there = there and judge.is_there(forward.beyond_errors(after, trial, law))
            words_of = "a function of drift and rate" if not law.has_memory else "a hysteresis of sliders"
            rows[str(site), words_of] = gain.value, gain.error, there
    index = pd.MultiIndex.from_tuples(rows, names=["site", "general law"]) if rows else None
    return pd.DataFrame(list(rows.values()), index, columns=["gain (dB)", "standard error", "there"])


def _pair(forward: Forward, confirmed: Stand, effect: Effect) -> tuple[Stand, Stand]:
    """The confirmed model and the same with one effect more, on one ruler; a fault only changes the records."""
    trial, name = confirmed.trial, f"{effect.law.name} at {effect.site}"
    if effect.is_fault:
        ruler = forward.rulers[effect]
        ruler = ruler if trial.ruler.windows.centred else ruler.as_measured()
        return confirmed, _stand(name, Trial(ruler, trial.base, trial.laws))
    if effect.law.variable == "1":  # the means alone show a constant force
        confirmed = _as_measured(confirmed)
    return confirmed, _stand(name, confirmed.trial.with_laws([(effect.site, effect.law)]))


def _stand(name: str, trial: Trial) -> Stand:
    """A trial judged on the search and on the held-out data."""
    ruler, work = trial.ruler, trial.ruler.work
    windows = ruler.windows
    held = ruler.on(Windows(work.data, work.held, windows.length, windows.edges, windows.centred))
    powers = trial.powers_on(held)
    errors = held.errors(powers)
    within = Powers(trial.within[None], trial.powers.reference)
    row = {
        "search": ruler.error(within), "validation": ruler.error(trial.powers),
        "held-out": held.error(powers, ruler.scale(trial.powers)), "free run": free_run_error(trial.model(), work),
        **{f"held-out dof {j}": float(e) for j, e in enumerate(errors, 1)},
    }  # fmt: skip
    return Stand(name, trial, powers, row)


def _as_measured(stand: Stand) -> Stand:
    """The same model with the means left in."""
    trial = stand.trial
    if not trial.ruler.windows.centred:
        return stand
    try:
        return _stand(stand.name, Trial(trial.ruler.as_measured(), trial.base, trial.laws))
    except NRFError:
        return stand


def _step(forward: Forward, effect: Effect, before: Stand, after: Stand) -> Step:
    """One effect, with what it gains on the search and on the held-out data."""
    site = effect.site
    gain = after.trial.gain_over(before.trial)
    held = Gain(before.held, after.held, before.trial.ruler.informative)
    rivals = forward.rivals.get(effect, [])
    families = dict.fromkeys(f.family for f in rivals if f.family != effect.law.family)
    work = after.trial.ruler.work
    if not effect.is_fault and effect.law.is_dry_friction(work.scales(site)[0]):
        families = dict.fromkeys([CoulombFriction.family, *families])
    families.pop(effect.law.family, None)
    if effect.law.variable == "1":
        families = dict.fromkeys(["sensor"])  # the wrong zero of a displacement is the same
    step = Step(
        effect.law.name, effect.law.family, str(site), shape=dict(effect.law.shape), alternatives=list(families)[:2],
        error_before=before.error, error_after=after.error, free_run_before=before.row["free run"],
        free_run_after=after.row["free run"], validation_before=before.row["validation"],
        validation_after=after.row["validation"], gain=gain.value, gain_error=gain.error, gain_least=gain.least,
        gain_heldout=held.value, confirmed=bool(after.error < before.error and gain.value > 0),
        tied=[
            (f.proposal.law.name, ", ".join(map(str, f.proposal.sites)), f.gain.value if f.gain else np.nan)
            for f in rivals
        ],
    )  # fmt: skip
    if effect.is_fault:
        step.sure = effect.witnessed
        step.parameters = dict(effect.law.parameters)
        step.sensors = [
            str(f.proposal.sites[0]) for f in rivals if f.is_fault and f.proposal.law.name == effect.law.name
        ]
    else:
        laws = after.trial.model().laws[site]
        fitted = next(law for law in reversed(laws) if law.name == effect.law.name)
        step.parameters = dict(fitted.parameters)
        step.sure = all((fitted.parameters[c] or 0.0) >= 0 for c in fitted.nonnegative)
        step.intervals = _intervals(after.trial, effect)
        step.share = judge.share_of(after.trial, after.trial.without(site, effect.law), site)
    step.evidence = words.acceptance(step)
    return step


def _intervals(trial: Trial, effect: Effect) -> dict[str, tuple[float, float]]:
    """95 % intervals of the parameters of an effect, from fold to fold (delete-one jackknife; Efron 1982).

    Near the best a law is linear in its shape parameters: the derivatives stand beside its columns.
    """
    law, site = effect.law, effect.site
    base = trial.without(site, law)
    axes = Axes(effect.template, trial.ruler.work, [site])
    width = len(law.terms())
    at = trial.layout.slices[site].stop - width
    values = trial.theta[0, at : at + width]
    columns = [trial.ruler.columns(site, [law])]
    centre = axes.point(law)
    for k in range(len(centre)):
        h = 2e-3 * (axes.high[k] - axes.low[k])
        h = -h if centre[k] + h > axes.high[k] else h
        moved = axes.at(centre + h * np.eye(len(centre))[k])[0]
        columns.append((values @ (trial.ruler.columns(site, [moved]) - columns[0]) / h)[None])
    try:
        parts = Slot(base, [(site, law)], extra=len(centre)).left_out(np.vstack(columns))
    except NRFError:
        return {}
    if not np.isfinite(parts).all():
        return {}
    half = student.ppf(0.5 + LEVEL / 2, len(parts) - 1) * np.sqrt(variance(parts))
    out = {}
    for k, term in enumerate(law.terms()):
        out[term.symbol] = (float(values[k] - half[k]), float(values[k] + half[k]))
    for k, shape in enumerate(axes.shapes):
        ends = axes.scales[0].values(centre[k] + np.array([-1, 1]) * half[width + k], k)
        out[shape.name] = (float(ends[0]), float(ends[1]))
    return out


def _bounds(trial: Trial) -> dict[str, tuple[float, float]]:
    """95 % intervals of masses and coefficients by name, from fold to fold."""
    known = trial.ruler.work.known_masses
    found = pd.DataFrame([parameters_of(trial.model_at(m, c), known) for m, c in zip(trial.masses, trial.theta)])
    half = student.ppf(0.5 + LEVEL / 2, max(len(found) - 2, 1)) * np.sqrt(variance(found.iloc[1:]))
    return {name: (x - h, x + h) for name, x, h in zip(found, found.iloc[0].astype(float), half) if np.isfinite(h)}


def _no_claim(after: Stand) -> str:
    """Why nothing may be claimed; empty if something may."""
    model, known = after.trial.model(), after.trial.ruler.work.known_masses
    left = after.trial.left
    if np.nanmax(left) >= HOPELESS:
        return words.hopeless(left)
    if any(m <= 0 and j not in known for j, m in enumerate(model.masses, 1)):
        return words.negative_masses(model.masses)
    total = model.total_masses
    cancelled = [j for j, m in known.items() if m > 0 and total[j - 1] <= TENTH * m]
    if cancelled:
        return words.cancelled_masses(cancelled)
    return ""


def _why_stopped(forward: Forward, most: int) -> str:
    """Why the search ended."""
    if len(forward.state.effects) >= most:
        return f"{most} effects were added, as many as were asked for" if most else "no effect was asked for"
    return words.best_refused(forward.last[0] if forward.last else None)


def _say_how_sure(steps: list[Step], final: Stand, noise: Ruler | None) -> None:
    """Say of each effect how much of it stays unexplained, and whether its name is sure."""
    trial = final.trial
    left = trial.ruler.errors(trial.powers)
    floor = np.full(len(left), np.nan)
    if steps and noise is not None:
        try:
            floor = noise.errors(Trial(noise, trial.base, trial.laws).powers)
        except NRFError:
            pass
    for step in steps:
        site = Site(step.site)
        balances = [j - 1 for j in range(1, len(left) + 1) if site.kind != "sensor" and site.incidence(j)] or list(
            range(len(left))
        )
        noise_at, left_at = (float(np.sqrt(np.mean(x[balances] ** 2))) for x in (floor, left))
        step.noise_floor = noise_at
        known = np.isfinite(noise_at)
        before = max(step.validation_before, left_at)
        top = max(left_at**2 - (BY_NOISE * noise_at) ** 2 if known else left_at**2, 0.0)
        step.remainder = float(np.sqrt(top / max(before**2, 1e-300)))
        ratio = step.gain / max(step.gain_error, 1e-12)
        step.sure = bool(
            step.sure and step.confirmed and not step.alternatives and step.remainder <= COMPLETE and ratio >= FAR
        )
    for step in steps:
        here = balances_of(Site(step.site))
        step.company = [s.law for s in steps if s is not step and balances_of(Site(s.site)) == here]
        step.sure = step.sure and not step.company


def _report(
    forward: Forward, first: State, settings: Mapping[str, Any], steps: list[Step], stands: list[Stand],
    confirmed: Stand, noise: Ruler | None, stopped: str,
) -> LoopReport:  # fmt: skip
    work, ready, model = confirmed.trial.ruler.work, forward.whole or forward.state.ready, confirmed.trial.model()
    assert ready is not None
    rows: dict[str, dict[str, float]] = {}
    for stand in stands:
        name = stand.name if stand.name not in rows else f"{stand.name} ({len(rows)})"
        rows[name] = stand.row
    table = pd.DataFrame.from_dict(rows, orient="index")
    band = first.trial.ruler.band()
    table["band"] = words.band(band)
    for site in model.laws:
        seen = [(work.motion(site, b.segment), b.rows) for b in work.search]
        v, s = (np.concatenate([getattr(m, k)[rows] for m, rows in seen]) for k in "vs")
        model.visited[Site(site)] = VisitedRegion.of(v, s)
    if ready.contradictions:
        found = contradictions(ready, work)
        stopped += f". {words.contradictions(found)}" if found else ""
    model.info = {
        "band": list(band) if any(band) else None,
        "steps": [f"{s.law} at {s.site}" for s in steps if s.confirmed],
        "stopped_because": stopped,
    }
    listed = pd.DataFrame(
        [
            [f.proposal.law.name, f.family, ", ".join(map(str, f.proposal.sites)), g.value, g.error, g.least]
            for f, g in forward.last
        ],
        columns=["law", "family", "site", "gain (dB)", "standard error", "least"],
    )
    floor = floor_of(model, None if noise is None else noise.work)
    evidence = _evidence(stands, steps, floor)
    data, filters = searched(work)
    return LoopReport(
        steps, table, stopped, model, band, listed, [s.trial.model() for s in stands], evidence, measured_of(ready),
        loops_of(model, data, filters), audit(settings, ready),
    )  # fmt: skip


def _evidence(stands: list[Stand], steps: list[Step], floor: Any) -> list[Evidence]:
    """What was left of the search data after the baseline and after each step."""
    sites = [step.site for step in steps] + [""]
    found = [look(s.trial.ruler.work, s.trial.model(), s.name, site, floor) for s, site in zip(stands, sites)]
    for step, evidence in zip(steps, found):
        step.detection = evidence.detection_sentence
        step.localisation = evidence.localisation_sentence
        step.characterisation = evidence.characterisation_sentence
    return found


def free_run_error(model: ChainModel, work: Workspace) -> float:
    """Free-run error of the displacements over held-out windows, percent NRMSE; NaN where the model cannot run."""
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in work.held:
        seg = work.data.segments[block.segment]
        if seg.dt is None or np.isnan(seg.F[seg.valid.start]).any():
            return float("nan")
        size = _window(seg, block.rows)
        for start in range(block.rows.start, block.rows.stop - size + 1, size):
            rows = slice(seg.valid.start + start, seg.valid.start + start + size)
            run = _run(model, seg, rows)
            if run is None:
                return float("nan")
            x = np.cumsum(seg.s[rows], axis=1)
            x = x - x.mean(axis=0)
            error = run.displacement - np.cumsum(seg.s[rows], axis=1)
            top += (error**2).sum(axis=0)
            bottom += (x**2).sum(axis=0)
    return float(100.0 * np.sqrt(np.mean(top / bottom))) if (bottom > 0).all() else float("nan")


def _window(seg: Any, rows: slice) -> int:
    """Samples of about ten periods of the first drift, at most the block."""
    s = np.asarray(seg.s[seg.valid][rows], dtype=float)[:, 0]
    crossings = np.count_nonzero(np.diff(np.signbit(s - s.mean())))
    length = rows.stop - rows.start
    return max(8, min(length, int(PERIODS * 2 * length / max(crossings, 1))))


def _run(model: ChainModel, seg: Any, rows: slice) -> Any:
    """A free run, tried again by the other integrator; None where both fail."""
    choices: tuple[dict[str, Any], ...] = ({}, {"method": "newmark"})
    for options in choices:
        try:
            run: Any = free_run_of(model, seg, rows, seg.dt, **options)
        except NRFError:
            continue
        if np.isfinite(run.displacement).all():
            return run
    return None
