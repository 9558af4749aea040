"""Faulty sensors as undeclared effects: channels that are late, wrongly scaled, or have
a wrong zero.

A fault of a sensor is not a force: it changes the channels from which every column is
built, and the fusion that mixes them. So a candidate corrects the channel, and the same
model is solved again on what follows. Where a DOF has several kinds of channels their
contradiction gives the fault and the balances say which of them is wrong; where it has
one, and for forces, the fault is found from the balances alone.

What the data cannot show is not tried: the gain of the only force where no mass is
known (it scales the chain), the gain of the only DOF, the zero of x1 (a constant force
on DOF 1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array
from scipy.stats import chi2

from ..chain.sites import Site
from ..exceptions import NRFError
from ..laws.sensor import ChannelDelay, GainError, SensorFault
from ..records.checks.alignment import channel_alignment
from ..records.dataset import Dataset, Segment
from ..simulation.api import as_true
from .constants import FLOOR, LEAST_GAIN, LEAST_SHARE
from .prepare import Prepared, Workspace, prepare
from .ruler import Gain, Ruler, Trial, fall, share
from .state import Effect, Finding, Proposal, State
from .windows import Windows


def findings_of_faults(state: State, laws: Sequence[SensorFault]) -> list[Finding]:
    """Corrected sensors as findings on top of a state."""
    ready = state.ready
    if not laws or ready is None:
        return []
    work = state.trial.ruler.work
    kinds = tuple(type(law) for law in laws)
    known = [s for s in contradictions(ready, work) if isinstance(s.law, kinds)]
    promising = sorted(
        (_Scan(state.trial, s) for s in _alone(ready, work, laws)),
        key=lambda scan: -scan.promise,
    )
    alone = sorted(
        filter(None, (scan.best() for scan in promising[: 2 * SUSPECTS])),
        key=lambda p: -p[0],
    )
    found = []
    for suspect in [*known[:SUSPECTS], *(s for _, s in alone[:SUSPECTS])]:
        rebuilt = _rebuilt(ready, state.trial, suspect)
        if rebuilt is None:
            continue
        (fresh, trial), fault = rebuilt, suspect.law
        before = next(
            (
                e
                for e in state.effects
                if (e.law.name, e.site) == (fault.name, suspect.site)
            ),
            None,
        )
        if before is not None:
            assert isinstance(before.law, SensorFault)
            fault = before.law.followed_by(fault)
        template = next(law for law in laws if law.name == fault.name)
        seen = bool(suspect.witness)
        effects = (
            *(e for e in state.effects if e is not before),
            Effect(fault, suspect.site, template, seen),
        )
        gain = Gain(state.trial.powers, trial.powers, trial.ruler.informative)
        given = (
            Proposal(template, (suspect.site,)),
            (fault,),
            state,
            gain.value,
            gain,
            State(trial, effects, fresh),
        )
        found.append(Finding(*given, witnessed=seen))
    return found


def _alone(
    ready: Prepared, work: Workspace, laws: Sequence[SensorFault]
) -> Iterator[Suspect]:
    """Channels that no other channel of their DOF can contradict, with faults that the
    balances can show.
    """
    record = ready.records[_runs(work)[0]]
    kinds = {
        j: [k for k in "avx" if f"{k}{j}" in record.measured]
        for j in range(1, record.n_dof + 1)
    }
    single = [f"{held[0]}{j}" for j, held in kinds.items() if len(held) == 1]
    forces = [f"F{j}" for j in work.forced]
    for law in laws:
        if not law.acts_on_derivatives:
            continue  # the mean of every column over a fold is taken out
        scaled = (
            work.n_dof > 1 and bool(work.forced),
            len(work.forced) + len(work.known_masses) > 1,
        )
        motions, loads = scaled if law.changes_scale else (True, True)
        yield from (
            Suspect(law, Site(f"sensor {c}")) for c in single * motions + forces * loads
        )


def on(trial: Trial, data: Dataset) -> Trial:
    """The same laws on the same rows of other motions."""
    ruler = trial.ruler
    work, windows = ruler.work.with_data(data), ruler.windows
    moved = Windows(data, work.search, windows.length, windows.edges, windows.centred)
    if len(moved.blocks) != len(windows.blocks):
        raise NRFError(
            "The corrected channels are too short for a fold", "Give longer records."
        )
    return Trial(
        Ruler(work, moved, ruler.informative, ruler.clear), trial.base, trial.laws
    )


class _Scan:
    """Values of a fault of one channel; its promise is the larger gain of two trials,
    up and down.
    """

    def __init__(self, trial: Trial, suspect: Suspect) -> None:
        self.trial, self.suspect = trial, suspect
        of_time = suspect.law.terms()[0].unit == "s"
        unit = (
            1.0 / pace(trial.ruler.work, int(suspect.site.channel[1:]))
            if of_time
            else 1.0
        )
        self.least, (h, self.reach) = (
            LEAST_SHARE * unit,
            (x * unit for x in suspect.law.scan),
        )
        up, down = self.gain(h), self.gain(-h)
        self.promise, self.sign = max(up, down), 1 if up > down else -1

    def gain(self, value: float) -> float:
        """Gain of the records that are freed of the fault, dB."""
        law = self.suspect.law.with_values([value])
        try:
            return (
                on(self.trial, _shifted(self.trial.ruler.work, self.suspect.site, law))
                .gain_over(self.trial)
                .value
            )
        except NRFError:
            return -np.inf

    def best(self) -> tuple[float, Suspect] | None:
        """The best value and its gain; None if they promise too little."""
        if self.promise < LEAST_GAIN / 4:
            return None
        bounds = sorted((0.0, self.sign * self.reach))
        found = minimize_scalar(
            lambda x: -max(self.gain(x), -1e6), bounds=bounds, options={"maxiter": 16}
        )
        value, gain = float(found.x), -float(found.fun)
        there = gain >= LEAST_GAIN and abs(value) >= self.least
        return (
            (gain, replace(self.suspect, law=self.suspect.law.with_values([value])))
            if there
            else None
        )


def _shifted(work: Workspace, site: Site, law: SensorFault) -> Dataset:
    """Records in which a force, or the whole motion of a DOF, is freed of a fault, what
    is held out on its own.
    """
    segments, kind, dof = [], site.channel[0], int(site.channel[1:])
    for i, seg in enumerate(work.data.segments):
        ends = {
            seg.valid.start + x
            for b in work.held
            if b.segment == i
            for x in (b.rows.start, b.rows.stop)
        }
        cuts = sorted(ends - {seg.valid.start, seg.valid.stop})
        channels = {"F": seg.F[:, dof - 1]} if kind == "F" else _motion(seg, dof)
        seen = {
            key: np.asarray(y, dtype=float)
            for key, y in channels.items()
            if np.nan_to_num(y).any()
        }
        changed = seg.moved(
            dof,
            **{key: _freed(law, y, seg.dt or 1.0, cuts) - y for key, y in seen.items()},
        )
        known = np.isfinite(seg.F[seg.valid]).all(axis=0)
        finite = np.isfinite(
            np.hstack([changed.a, changed.v, changed.s, changed.F[:, known]])
        ).all(axis=1)
        inside = seg.valid.start + np.flatnonzero(finite[seg.valid])
        segments.append(
            replace(changed, valid=slice(int(inside[0]), int(inside[-1]) + 1))
        )
    return Dataset(segments, work.data.n_samples)


def _freed(
    law: SensorFault, y: np.ndarray, dt: float, cuts: Sequence[int]
) -> np.ndarray:
    """A channel freed of a fault, its pieces on their own; as it was at cuts, where a
    correction reaches beyond one.
    """
    parts = [law.corrected(part, dt) for part in np.split(y, cuts)]
    whole = np.concatenate(parts)
    first, last = len(parts[0]) // 2, len(y) - len(parts[-1]) // 2
    whole[first:last] = np.where(np.isnan(whole), y, whole)[first:last]
    return whole


def _motion(seg: Segment, dof: int) -> dict[str, np.ndarray]:
    """Displacement, velocity and acceleration of a DOF."""
    return {
        "x": seg.s[:, :dof].sum(axis=1),
        "v": seg.v[:, :dof].sum(axis=1),
        "a": seg.a[:, dof - 1],
    }


@dataclass(frozen=True)
class _Error:
    """Part of another DOF's channel, of itself or its derivatives that a channel reads,
    and its standard deviation.
    """

    kind: str
    dof: int
    name: str
    source: int
    deviation: float


# Columns of the spectra by which errors are estimated: some for each of a hundred
# errors in each of 24 bands.
_COLUMNS = 8_000
# Gauss-Newton steps: three settle all of 24 chains with imperfect sensors; more fit the
# noise of these columns.
_ROUNDS = 4
_Line = tuple[np.ndarray, int, int]


class Errors:
    """Errors of the channels of a search; what they change at a site is kept for the
    next trial on the same ruler.

    The size of a fault that was found is uncertain by itself: it was fitted where other
    errors were taken for none.
    """

    def __init__(
        self,
        ruler: Ruler,
        ready: Prepared,
        tolerances: Mapping[str, float],
        known: Sequence[Effect],
    ) -> None:
        self.ruler, self.work, windows = ruler, ruler.work, ruler.windows
        self.thin = np.arange(0, windows.size, -(-windows.size // _COLUMNS))
        self.readings = {i: _Readings(self.work, ready, i) for i in self.work.searched}
        kinds: dict[type, str] = {GainError: "gain", ChannelDelay: "delay"}
        found = {
            (e.site.channel, kinds.get(type(e.law))): abs(e.law.values[0])
            for e in known
            if e.is_fault
        }
        errors = _errors(self.work, self.readings, tolerances)
        sizes = ((e, found.get((f"{e.kind}{e.dof}", e.name), 0.0)) for e in errors)
        self.errors = [
            replace(e, deviation=max(e.deviation, size)) for e, size in sizes
        ]
        self._changes: tuple[dict[Any, np.ndarray], ...] = (
            {},
            {},
        )  # of the last trial, and of the one before

    def freed(
        self, trial: Trial, start: np.ndarray | None = None, most: float | None = None
    ) -> tuple[Trial, np.ndarray]:
        """The trial on records freed of the likeliest errors of all channels that are
        credible together, and these.

        Least squares; masses, coefficients and weights follow them (variable
        projection, Golub and Pereyra 1973). The squares of the errors in standard
        deviations sum up to ``most``, or to the median for one error a channel.
        """
        if not self.errors:
            return trial, np.zeros(0)
        new: dict[Any, np.ndarray] = {}
        lines = [
            line
            for number, e in enumerate(self.errors)
            for line in self._lines(trial, number, e, new)
        ]
        self._changes = new, self._changes[0]
        most = (
            chi2.median(len({(e.kind, e.dof) for e in self.errors}))
            if most is None
            else most
        )
        shares = _Fit(trial, self, lines, most).fitted(
            np.zeros(len(self.errors)) if start is None else start
        )
        errors = [(e, x * e.deviation) for e, x in zip(self.errors, shares)]
        try:
            freed = on(trial, _faulty(self.work, self.readings, errors))
        except NRFError:
            return trial, shares
        return freed if freed.gain_over(trial).value > 0 else trial, shares

    def _lines(
        self, trial: Trial, number: int, error: _Error, new: dict[Any, np.ndarray]
    ) -> Iterator[_Line]:
        """What an error of unit size changes in the spectra, the rows that it changes,
        and its number.
        """
        own = error.dof - 1 + self.work.n_dof * (error.kind == "F")
        touched: list[tuple[Any, int]] = [((error, None, None), trial.at + own)]
        for site in trial.layout.sites if error.kind != "F" else ():
            at = trial.layout.slices[site].start
            for law in trial.laws.get(site, ()) if site.incidence(error.dof) else ():
                touched.append(((error, site, law), at))
                at += len(law.terms())
        new |= {
            key: held[key]
            for held in self._changes
            for key, _ in touched
            if key in held
        }
        if missing := [(key, at) for key, at in touched if key not in new]:
            moved = self.work.with_data(
                _faulty(self.work, self.readings, [(error, 0.1 * error.deviation)])
            )
            laws = [(s, law) for (_, s, law), _ in missing]
            ends = np.cumsum([len(law.terms()) if law else 1 for _, law in laws])

            def rows(group: tuple[int, ...]) -> np.ndarray:
                each = (
                    (
                        moved.columns(s, [law], group)
                        if law
                        else moved.fixed(group)[own][None]
                    )
                    for s, law in laws
                )
                return np.vstack(list(each))

            for (key, at), after in zip(
                missing, np.split(self.ruler.windows.spectra(rows), ends[:-1])
            ):
                new[key] = (
                    10.0 * (after - trial.spectra[at : at + len(after)])[:, self.thin]
                )
        yield from (
            (change, at + k, number)
            for key, at in touched
            for k, change in enumerate(new[key])
        )


class _Fit:
    """Row ``rows[i]`` of spectra changes by ``changes[i]`` for each standard deviation
    of error ``numbers[i]``.
    """

    def __init__(
        self, trial: Trial, errors: Errors, lines: Sequence[_Line], most: float
    ) -> None:
        self.fit, thin, self.most = trial.fit, errors.thin, most
        changes, rows, numbers = zip(*lines)
        self.changes, self.rows, self.numbers = (
            np.array(changes),
            np.array(rows),
            np.array(numbers),
        )
        self.spectra, self.weights, self.samples = (
            trial.spectra[:, thin],
            trial.weights,
            trial.ruler.windows.size,
        )
        self.lowest = [g.dofs[0] - 1 for g in self.fit.groups]
        self.used, self.band = (
            np.empty((len(self.lowest), len(thin))),
            np.empty(len(thin), dtype=int),
        )
        for each, spans in zip(trial.used(self.fit), trial.ruler.windows.spans):
            for k, columns in enumerate(spans):
                here = slice(*np.searchsorted(thin, [columns.start, columns.stop]))
                self.used[:, here], self.band[here] = each[:, None], k
        self.bands = np.eye(trial.weights.shape[1])[self.band].T
        self.own = [np.array(own) for own in self.fit.own]  # and the changes of these
        self.inside = [np.flatnonzero(np.isin(rows, own)) for own in self.own]

    def fitted(self, start: np.ndarray) -> np.ndarray:
        """The errors that leave the least residual, by Gauss-Newton steps; the best of
        all that were passed.
        """
        spectra = self._at(start)
        weights, cost = self._weights(spectra, self.weights)
        at, best, lowest = start, start, cost
        for _ in range(_ROUNDS):
            at = at + self._step(at, spectra, weights)
            spectra = self._at(at)
            weights, cost = self._weights(spectra, weights)
            settled = abs(lowest - cost) < 0.1 * LEAST_GAIN
            if cost < lowest:
                best, lowest = at, cost
            if settled:
                break
        return best

    def _at(self, shares: np.ndarray) -> np.ndarray:
        return self.spectra + self._sums(
            np.arange(len(self.rows)),
            self.rows,
            shares[self.numbers],
            len(self.spectra),
        )

    def _sums(
        self, some: np.ndarray, rows: np.ndarray, factors: np.ndarray, count: int
    ) -> np.ndarray:
        """Sums of some changes times their factors, by the row to which each is
        added.
        """
        held = np.flatnonzero(factors)
        return (
            csr_array(
                (factors[held], (rows[held], some[held])), (count, len(self.changes))
            )
            @ self.changes
        )

    def _grams(self, at: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Weighted products of the rows that stand in each group of balances; those of
        others are zero.
        """
        out = np.zeros((len(self.own), len(at), len(at)))
        for gram, own, j, used in zip(out, self.own, self.lowest, self.used):
            gram[own[:, None], own] = (at[own] * (weights[j, self.band] * used)) @ at[
                own
            ].T
        return out

    def _weights(self, at: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
        """One over the power of the residual by balance and band, and its mean level,
        dB.
        """
        known = self.used[self.fit.judged]
        power, whole = (
            np.array(
                [
                    np.bincount(self.band, y, weights.shape[1])
                    for y in (x[0] @ at) ** 2 * known
                ]
            )
            for x in self.fit.rows(*self.fit.solve(self._grams(at, weights)[None]))
        )
        level = share(power, whole)
        inside = (weights > 0) & np.isfinite(level)
        cost = float(fall(level, np.ones_like(level), inside))
        floored = power + FLOOR**2 * whole
        new = np.where(inside & (floored > 0), 1.0 / np.maximum(floored, 1e-300), 0.0)
        return new, cost if np.isfinite(power).all() else np.inf

    def _step(
        self, shares: np.ndarray, at: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """The step to the likeliest errors, to first order: the least residual by
        errors that are credible together.
        """
        part = 0.1
        grams = np.repeat(self._grams(at, weights)[None], len(shares) + 1, axis=0)
        for u, (own, some) in enumerate(zip(self.own, self.inside)):
            heavy = at[own] * (part * weights[self.lowest[u], self.band] * self.used[u])
            cross = self.changes[some] @ heavy.T
            number, row = self.numbers[some, None] + 1, self.rows[some, None]
            grams[number, u, own, row] += cross
            grams[number, u, row, own] += cross
        both = self.fit.rows(*self.fit.solve(grams))  # residuals and references
        lost = ~np.isfinite(both[0]).all(axis=(1, 2))
        kept = (
            np.nan_to_num(np.where((lost | lost[0])[:, None, None], rows[:1], rows))
            for rows in both
        )
        normal = np.zeros(
            (len(grams), len(grams))
        )  # of the changes of the residual by each error, and of the residual
        for j, own, below in zip(
            range(self.fit.n), *(self._moved(rows, at, part) for rows in kept)
        ):
            (mix, lines), (change, reference), used = (
                own,
                below,
                self.used[self.fit.judged[j]],
            )
            inner = (reference * (reference[-1] * used)) @ self.bands.T
            shrunk = (
                change[:-1] @ inner / np.where(inner[-1] > 0, inner[-1], 1.0)
            )  # the ruler reads shares
            lines = np.vstack([lines[:-1], lines[-1] * self.bands]) * np.sqrt(
                weights[j, self.band] * used
            )
            mix = np.hstack(
                [mix[:, :-1], np.vstack([-shrunk, np.ones(len(self.bands))])]
            )
            normal += mix @ (lines @ lines.T) @ mix.T
        size, turn = np.linalg.eigh(normal[:-1, :-1])
        pull = turn.T @ (normal[:-1, :-1] @ shares - normal[:-1, -1])

        def found(weight: float) -> np.ndarray:
            return turn @ (pull / (np.maximum(size, 0.0) + weight))

        # the prior of the errors, and more of it until all of them together are
        # credible
        weight = max(weights.shape[1] / self.samples, 1e-12 * size[-1])
        while np.sum(found(weight) ** 2) > self.most and weight < 1e12 * size[-1]:
            weight *= 1.2
        return found(weight) - shares

    def _moved(
        self, rows: np.ndarray, at: np.ndarray, part: float
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Of one combination of rows for each balance: lines, and how they add up to
        what each error changes in it.

        The last row is the combination itself.
        """
        follow = (rows[1:] - rows[0]) / part  # of masses and coefficients
        for j, u in enumerate(self.fit.judged):
            own, some = self.own[u], self.inside[u]
            errors, place = np.unique(self.numbers[some], return_inverse=True)
            factors = rows[self.numbers[some] + 1, j, self.rows[some]]
            alone = self._sums(
                some, place, factors, len(errors)
            )  # with the model as it is
            lines = np.vstack([at[own], alone, rows[0, j] @ at])
            mix = np.zeros((len(rows), len(lines)))
            mix[:-1, : len(own)] = follow[:, j, own]
            mix[errors, len(own) + np.arange(len(errors))] = mix[-1, -1] = 1.0
            yield mix, lines


def _errors(
    work: Workspace, readings: Mapping[int, _Readings], tolerances: Mapping[str, float]
) -> Iterator[_Error]:
    """Every error that a channel of the search may have."""
    measured = set().union(*(r.measured for r in readings.values()))
    dofs = range(1, work.n_dof + 1)
    # what delays a channel also weakens its high frequencies: a lag of t by (w t)^2 / 2
    every = {**tolerances, "lag": tolerances.get("delay", 0.0) ** 2 / 2}
    for kind, j, (name, most) in product("avxF", dofs, every.items()):
        if f"{kind}{j}" in measured and most:
            others = (
                [k for k in dofs if k != j and kind != "F"]
                if name == "cross_axis"
                else [j]
            )
            yield from (_Error(kind, j, name, k, most / np.sqrt(3.0)) for k in others)


def _faulty(
    work: Workspace,
    readings: Mapping[int, _Readings],
    errors: Sequence[tuple[_Error, float]],
) -> Dataset:
    """Records whose channels have further errors of some sizes."""
    segments = list(work.data.segments)
    for i, seen in readings.items():
        own: dict[int, list[tuple[_Error, float]]] = {}
        for error, size in errors:
            if f"{error.kind}{error.dof}" in seen.measured:
                own.setdefault(error.dof, []).append((error, size))
        for dof, some in own.items():
            segments[i] = segments[i].moved(dof, **seen.changes(some))
    return Dataset(segments, work.data.n_samples)


_ORDERS = {
    "delay": 1,
    "lag": 2,
}  # of the derivative that such an error adds to a channel


def _derived(y: np.ndarray, step: float, order: int) -> np.ndarray:
    """Derivative of some order by differences."""
    return _derived(np.gradient(y, step), step, order - 1) if order else y


class _Readings:
    """What errors of the channels of one record change of its fused motion and its
    forces, run by run of the search.
    """

    def __init__(self, work: Workspace, ready: Prepared, record: int) -> None:
        self.seg = seg = work.data.segments[record]
        self.runs = [
            slice(seg.valid.start + r.start, seg.valid.start + r.stop)
            for r in work.runs(record)
        ]
        self.clean, self.noise = ready.clean, ready.noise[record]
        self.step = seg.dt or 1.0
        unknown = np.isnan(seg.F[seg.valid]).any(axis=0)
        forced = {
            f"F{j}"
            for j in range(1, seg.n_dof + 1)
            if not unknown[j - 1] and seg.F[seg.valid, j - 1].any()
        }
        self.measured = {
            c for c in ready.records[record].measured if c[0] != "F"
        } | forced
        self._spectra: dict[tuple[int, int], list[np.ndarray]] = {}
        self._shares: dict[tuple[str, int, int], np.ndarray] = {}

    def changes(self, errors: Sequence[tuple[_Error, float]]) -> dict[str, Any]:
        """Changes of the motion and the force of one DOF by errors of some sizes,
        (n_samples,).
        """
        out: dict[str, Any] = {}
        lines: list[Any] = [0.0 for _ in self.runs]
        for error, size in errors:
            order, key = _ORDERS.get(error.name, 0), error.kind
            if key == "F" or self.clean:
                y = (
                    self.seg.F[:, error.dof - 1]
                    if key == "F"
                    else _motion(self.seg, error.source)[key]
                )
                out[key] = out.get(key, 0.0) + size * _derived(
                    np.asarray(y, dtype=float), self.step, order
                )
                continue
            for k, (run, spectra) in enumerate(
                zip(self.runs, self._transformed(error.source, order))
            ):
                lines[k] = (
                    lines[k]
                    + size * self._share(key, error.dof, run.stop - run.start) * spectra
                )
        if any(map(np.any, lines)):
            fused = np.zeros((3, self.seg.n_samples))
            for run, spectra in zip(self.runs, lines):
                fused[:, run] = irfft(spectra, run.stop - run.start)
            out |= dict(zip("xva", fused))
        return out

    def _transformed(self, dof: int, order: int) -> list[np.ndarray]:
        """Spectra of derivatives of displacement, velocity and acceleration of a DOF in
        each run, (3, n_lines).
        """
        if (dof, order) not in self._spectra:
            motion = _motion(self.seg, dof)
            self._spectra[dof, order] = [
                rfft([_derived(motion[key][run], self.step, order) for key in "xva"])
                for run in self.runs
            ]
        return self._spectra[dof, order]

    def _share(self, kind: str, dof: int, samples: int) -> np.ndarray:
        """Part that a channel has in the fused motion, by frequency: what fusion gives
        it by the noise of all.
        """
        if (kind, dof, samples) not in self._shares:
            omega = 2.0 * np.pi * rfftfreq(samples, self.step)
            levels = {key: self.noise.get(f"{key}{dof}", 0.0) for key in "xva"}
            weight = {
                key: (omega**k / levels[key]) ** 2
                for k, key in enumerate("xva")
                if levels[key] > 0
            }
            total = sum(weight.values(), np.zeros(len(omega)))
            own = weight.get(kind, np.zeros(len(omega)))
            self._shares[kind, dof, samples] = np.where(
                total > 0, own / np.where(total > 0, total, 1.0), 0.0
            )
        return self._shares[kind, dof, samples]


def _rebuilt(
    ready: Prepared, trial: Trial, suspect: Suspect
) -> tuple[Prepared, Trial] | None:
    """Everything again from the corrected records: fusion (which forces take no part
    in), columns, powers.
    """
    work = trial.ruler.work
    try:
        records = [as_true(r, suspect.site, suspect.law) for r in ready.records]
        if suspect.site.channel[0] == "F":
            fresh: Any = replace(
                ready, records=records, data=_shifted(work, suspect.site, suspect.law)
            )
        else:
            mine = len(records) - len(
                ready.heldout or ()
            )  # records held out stand last
            fresh = prepare(records[:mine], records[mine:], bands=ready.bands or None)
        return fresh, on(trial, fresh.data)
    except (NRFError, np.linalg.LinAlgError):  # the corrected channels cannot be fused
        return None


# Faults of sensors that are tried on rebuilt records.
SUSPECTS = 3
# Samples below which half a record tells no delay.
_HALF = 1000


@dataclass(frozen=True)
class Suspect:
    """A fault at a channel, and what bears witness of it: how another channel of its
    DOF contradicts it, in words.
    """

    law: SensorFault
    site: Site
    witness: str = ""


def _runs(work: Workspace) -> tuple[int, list[slice]]:
    """The record that has most rows of the search, and its runs without a held-out
    piece in them.
    """
    runs = {i: work.runs(i) for i in work.searched}
    chosen = max(runs, key=lambda i: sum(run.stop - run.start for run in runs[i]))
    first = work.data.segments[chosen].valid.start
    return chosen, [slice(first + run.start, first + run.stop) for run in runs[chosen]]


def contradictions(ready: Prepared, work: Workspace) -> list[Suspect]:
    """Faults that would reconcile the channels of one DOF, the largest share of a
    channel first.
    """
    if ready.contradictions is not None:
        return ready.contradictions
    try:
        chosen, runs = _runs(work)
        record = ready.records[chosen]
        table = channel_alignment(record, runs=runs)
        halves = (
            []
            if table["aligned"].all()
            else [channel_alignment(record, runs=half) for half in _halves(runs)]
        )
    except NRFError:
        ready.contradictions = []
        return []
    sized: list[tuple[float, Suspect]] = []
    for name, row in table.iterrows():
        if row["aligned"] or not np.isfinite(row["gain"]):
            continue
        channel = str(name)
        gain = float(row["sign"] * row["gain"])
        late = [float(half.loc[name, "delay"]) for half in halves]
        large = [
            float(half.loc[name, "sign"] * half.loc[name, "gain"]) - 1.0
            for half in halves
        ]
        turn = abs(row["delay"]) * pace(work, int(channel[1:]))
        # noise in either channel alone makes a gain seem off by the root of the
        # coherence; and a gain is one number
        chance = max(
            -0.5 * np.log(row["coherence"]),
            row["scatter"] if np.isfinite(row["scatter"]) else 0.0,
        )
        off = abs(gain - 1.0) if gain <= 0 or abs(np.log(gain)) > chance else 0.0
        pairs = [
            (turn, late, ChannelDelay(row["delay"]), ChannelDelay(-row["delay"])),
            (off, large, GainError(gain - 1.0), GainError(1.0 / gain - 1.0)),
        ]
        for size, seen, own, other in pairs:
            # what one half of the record denies is chance
            if not size >= LEAST_SHARE or (
                any(x > 0 for x in seen) and any(x < 0 for x in seen)
            ):
                continue
            for law, of in ((own, channel), (other, row["reference"])):
                sized.append(
                    (size, Suspect(law, Site(f"sensor {of}"), str(row["message"])))
                )
    once = {
        (s.law.name, s.site): (size, s) for size, s in sorted(sized, key=lambda p: p[0])
    }  # the largest stays
    ready.contradictions = [s for _, s in sorted(once.values(), key=lambda p: -p[0])]
    return ready.contradictions


def _halves(runs: Sequence[slice]) -> list[Sequence[slice]]:
    """The first and the second half of the rows, each as runs; the whole where that is
    too short to be halved.
    """
    ends = np.cumsum([run.stop - run.start for run in runs])
    if ends[-1] < 2 * _HALF:
        return [runs]
    cuts = [
        int(np.clip(run.stop - end + ends[-1] // 2, run.start, run.stop))
        for run, end in zip(runs, ends)
    ]
    halves = [(slice(r.start, c), slice(c, r.stop)) for r, c in zip(runs, cuts)]
    return [[part for part in half if part.stop > part.start] for half in zip(*halves)]


def pace(work: Workspace, dof: int) -> float:
    """Mean circular frequency of the displacement of a DOF's rate, 1/s."""
    top = bottom = 0.0
    for b in work.search:
        seg = work.data.segments[b.segment]
        v = seg.v[seg.valid, :dof][b.rows].sum(axis=1)
        a = np.diff(v) / (seg.dt or 1.0)
        top, bottom = top + float(a @ a), bottom + float(v @ v)
    return float(np.sqrt(top / bottom)) if bottom > 0 else 1.0
