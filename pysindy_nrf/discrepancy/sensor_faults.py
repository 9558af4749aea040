"""Faulty sensors as undeclared effects: channels late, wrongly scaled, or off zero.

A fault of a sensor is not a force: it changes the channels from which every column is
built, and the fusion that mixes them. So a candidate corrects the channel, and the same
model is fitted again to what follows. Where a DOF has several kinds of channels their
contradiction gives the fault, and the balances show which of them is wrong. Where it
has one, or all of its channels have the fault, and for forces, the fault is found from
the balances alone.

What the data cannot show is not tried: the gain of the only force where no mass is
known (it scales the chain), the gain of the only DOF, the zero of x1 (a constant force
on DOF 1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from ..chain.sites import Site
from ..exceptions import NRFError
from ..laws.sensor import SensorFault
from ..records.dataset import Dataset, Segment
from ..records.record import Record
from ..simulation.api import as_true
from .channel_readings import motion_of_dof, reads_absolute
from .contradictions import Contradiction, contradictions, longest_record, mean_rate
from .effects import Candidate, Effect, Finding, SearchState
from .error_fit import ErrorFit, thinned_columns
from .fitted_model import FittedModel
from .prepare import FusionRecipe, PreparedRecords, prepare
from .row_changes import RowChange, changes_of_rows, touched_rows
from .search_data import SearchData


@dataclass(frozen=True)
class FaultSettings:
    """Effort of the search for faults of sensors."""

    # Faults that are tried on records fused again, of each kind: those that channels
    # contradict, and those of the balances alone.
    suspects: int = 3
    # Channels whose fault is scanned for each of these.
    scans: int = 4
    # Error reduction to first order that makes a fault worth a search, dB.
    worth_scanning: float = 0.125
    # Error reduction, dB, and size, as a share, of a fault that is worth trying.
    least_reduction: float = 0.5
    least_share: float = 0.03
    # Size to first order, as a share, of a fault that is worth a search. Of those that
    # are there (12 chains of 2 to 5 floors, all sensors of one late or wrongly scaled)
    # the least had 0.02; most that are not have 0.003 at most.
    least_start: float = 0.01
    # Evaluations of a scan.
    evaluations: int = 16


FAULTS = FaultSettings()
# A loss that no fault has, dB.
LARGE_LOSS = 1e6


@dataclass(frozen=True)
class Suspect:
    """A fault at a channel, or at all of a DOF.

    Witnessed if another channel of its DOF contradicts it.
    """

    law: SensorFault
    site: Site
    witnessed: bool = False


class FaultSearch:
    """Finds faults of sensors in a state.

    Parameters
    ----------
    laws : sequence of SensorFault
        Faults that are tried.
    only_witnessed : bool
        Whether only those are tried that another channel contradicts.
    """

    def __init__(
        self, laws: Sequence[SensorFault], only_witnessed: bool = False
    ) -> None:
        self.laws = list(laws)
        self.only_witnessed = only_witnessed
        self._fusion: list[FusionRecipe] | None = None
        self._contradictions: list[Contradiction] = []

    def findings(self, state: SearchState) -> list[Finding]:
        """Corrected sensors as findings added to a state."""
        if not self.laws or state.records is None:
            return []

        data = state.model.spectra.data
        witnessed = self._witnessed(state.records, data)
        alone = []
        # channels that contradict each other make others look wrong
        if not (witnessed or self.only_witnessed):
            alone = self._best_alone(state)

        findings = []
        for suspect in [*witnessed[: FAULTS.suspects], *alone[: FAULTS.suspects]]:
            corrected = _corrected(state.records, state.model, suspect)
            if corrected is not None:
                findings.append(self._finding(state, suspect, *corrected))
        return findings

    def contradictions(
        self, records: PreparedRecords, data: SearchData
    ) -> list[Contradiction]:
        """Contradictions of the channels, looked for once.

        A corrected force changes none of them: it takes no part in the fusion.
        """
        if self._fusion is not records.fusion:
            self._fusion = records.fusion
            self._contradictions = contradictions(records, data)
        return self._contradictions

    def known_contradictions(self, records: PreparedRecords) -> list[Contradiction]:
        """Contradictions of the channels of records that were searched for faults."""
        return self._contradictions if self._fusion is records.fusion else []

    def _finding(
        self,
        state: SearchState,
        suspect: Suspect,
        records: PreparedRecords,
        model: FittedModel,
    ) -> Finding:
        """A corrected sensor; a second correction of a channel joins the first."""
        fault, earlier = suspect.law, _earlier(state, suspect)
        if earlier is not None:
            assert isinstance(earlier.law, SensorFault)
            fault = earlier.law.followed_by(fault)

        template = next(law for law in self.laws if law.name == fault.name)
        effects = [effect for effect in state.effects if effect is not earlier]
        effects.append(Effect(fault, suspect.site, template, suspect.witnessed))
        reduction = model.reduction_from(state.model)
        return Finding(
            Candidate(template, (suspect.site,)),
            (fault,),
            state,
            reduction.value,
            reduction,
            SearchState(model, tuple(effects), records),
            suspect.witnessed,
        )

    # -- faults that channels contradict ---------------------------------------

    def _witnessed(self, records: PreparedRecords, data: SearchData) -> list[Suspect]:
        """Faults of the catalogue that would reconcile the channels of one DOF."""
        suspects = []
        for contradiction in self.contradictions(records, data):
            for law in self.laws:
                if law.order == contradiction.order:
                    fault = law.with_share(contradiction.share)
                    suspects.append(Suspect(fault, contradiction.site, True))
        return suspects

    # -- faults that the balances alone show -----------------------------------

    def _best_alone(self, state: SearchState) -> list[Suspect]:
        """Faults of channels that no other contradicts, by what they gain."""
        assert state.records is not None
        suspects = list(self._alone(state.records, state.model.spectra.data))
        if not suspects:
            return []

        promising = []
        scans = _promising_scans(state.model, state.records, suspects)
        for scan in scans[: FAULTS.scans * FAULTS.suspects]:
            best = scan.best()
            if best is not None:
                promising.append(best)
        promising.sort(key=lambda pair: -pair[0])
        return [suspect for _, suspect in promising]

    def _alone(self, records: PreparedRecords, data: SearchData) -> Iterator[Suspect]:
        """Sensors that no other of their DOF can contradict, with possible faults."""
        motions = _sensors_of_motion(records.records[longest_record(data)])
        forces = [Site(f"sensor F{j}") for j in data.forced]
        motions_are_scaled = data.n_dof > 1 and bool(data.forced)
        forces_are_scaled = len(data.forced) + len(data.known_masses) > 1

        for law in self.laws:
            # the mean of every column over a fold is taken out
            if not law.acts_on_derivatives:
                continue
            if motions_are_scaled or not law.changes_scale:
                yield from _suspects(law, motions)
            if forces_are_scaled or not law.changes_scale:
                yield from _suspects(law, forces)


def _sensors_of_motion(record: Record) -> list[Site]:
    """The only sensor of each DOF, or all that it has.

    Where one sensor is integrated to the other channels they share its faults.
    """
    sites = []
    for j in range(1, record.n_dof + 1):
        site = Site(f"sensors {j}")
        measured = [name for name in site.channels if name in record.measured]
        if len(measured) == 1:
            site = Site(f"sensor {measured[0]}")
        if measured:
            sites.append(site)
    return sites


def _suspects(law: SensorFault, sites: Sequence[Site]) -> Iterator[Suspect]:
    """A fault at each of some sensors."""
    for site in sites:
        yield Suspect(law, site)


def _earlier(state: SearchState, suspect: Suspect) -> Effect | None:
    """The same kind of fault of the same channel, if it was found before."""
    for effect in state.effects:
        if effect.site == suspect.site and effect.law.name == suspect.law.name:
            return effect
    return None


# -- values of a fault ---------------------------------------------------------


def _promising_scans(
    model: FittedModel, records: PreparedRecords, suspects: Sequence[Suspect]
) -> list[_Scan]:
    """Scans of the faults that are worth it, from what each explains to first order.

    Masses and coefficients follow the fault. The best come first.
    """
    thin = thinned_columns(model.spectra)
    steps = [_unit_of(suspect, model) * suspect.law.scan[0] for suspect in suspects]
    changes = []
    for number, (suspect, step) in enumerate(zip(suspects, steps)):
        changes += _changes_by_fault(model, records, suspect, step, thin, number)
    fit = ErrorFit(model, thin, changes)
    sizes, shares = fit.each_alone(len(suspects))

    n_balances = len(model.weights)
    scans = []
    for number in np.argsort(-shares).tolist():
        # as if all balances fell alike
        reduction = -10.0 * n_balances * np.log10(max(1.0 - shares[number], 1e-300))
        scan = _Scan(model, records, suspects[number], sizes[number] * steps[number])
        if reduction >= FAULTS.worth_scanning and scan.is_large:
            scans.append(scan)
    return scans


def _unit_of(suspect: Suspect, model: FittedModel) -> float:
    """The scale on which a fault is searched; of a time, a radian of the mean rate."""
    if suspect.law.terms()[0].unit == "s":
        return 1.0 / mean_rate(model.spectra.data, suspect.site.p)
    return 1.0


def _changes_by_fault(
    model: FittedModel,
    records: PreparedRecords,
    suspect: Suspect,
    step: float,
    thin: np.ndarray,
    number: int,
) -> list[RowChange]:
    """What records freed of a fault of some size change in the rows of a model."""
    data, site = model.spectra.data, suspect.site
    law = suspect.law.with_values([step])
    segments = []
    for segment, record in zip(data.data.segments, records.records):
        changes = {}
        for key, channel in _channels_of(segment, record, site).items():
            added = law.added_to(np.nan_to_num(channel), segment.dt or 1.0)
            changes[key] = -added
        segments.append(segment.moved(site.p, **changes))

    moved = data.with_data(Dataset(segments, data.data.n_samples))
    touched = list(touched_rows(model, site.p, site.channel.startswith("F")))
    made = changes_of_rows(model, moved, touched)
    return [
        RowChange(change[thin], first + k, number)
        for rows, first in touched
        for k, change in enumerate(made[rows])
    ]


class _Scan:
    """Values of a fault at one site, from one that is near the best."""

    def __init__(
        self,
        model: FittedModel,
        records: PreparedRecords,
        suspect: Suspect,
        start: float,
    ) -> None:
        self.model = model
        self.records = records
        self.suspect = suspect
        unit = _unit_of(suspect, model)
        self.least = FAULTS.least_share * unit
        self.reach = suspect.law.scan[1] * unit
        self.start = float(np.clip(start, -self.reach, self.reach))
        self.is_large = abs(start) >= FAULTS.least_start * unit

    def reduction(self, value: float) -> float:
        """Error reduction of the records that are freed of the fault, dB."""
        law = self.suspect.law.with_values([value])
        data = self.model.spectra.data
        try:
            motions = _freed(data, self.records, self.suspect.site, law)
            freed = self.model.on_motions(motions)
        except NRFError:
            return -np.inf
        return freed.reduction_from(self.model).value

    def best(self) -> tuple[float, Suspect] | None:
        """The best value and its error reduction; None if it is too small."""
        best = minimize_scalar(
            lambda value: -max(self.reduction(value), -LARGE_LOSS),
            bounds=sorted(self._bracket()),
            options={"maxiter": FAULTS.evaluations},
        )
        value, reduction = float(best.x), -float(best.fun)
        if reduction < FAULTS.least_reduction or abs(value) < self.least:
            return None
        law = self.suspect.law.with_values([value])
        return reduction, replace(self.suspect, law=law)

    def _bracket(self) -> tuple[float, float]:
        """Values on both sides of the best of the start, its double, and so on."""
        below, best = 0.0, self.start
        reduction = self.reduction(best)
        while abs(best) < self.reach:
            further = self.reduction(2.0 * best)
            if further < reduction:
                break
            below, best, reduction = best, 2.0 * best, further
        return below, 2.0 * best


# -- records freed of a fault --------------------------------------------------


def _corrected(
    records: PreparedRecords, model: FittedModel, suspect: Suspect
) -> tuple[PreparedRecords, FittedModel] | None:
    """Everything again from the corrected records: fusion, columns, powers.

    Forces take no part in the fusion. None if the channels cannot be fused.
    """
    data = model.spectra.data
    try:
        true = [as_true(r, suspect.site, suspect.law) for r in records.records]
        if suspect.site.channel.startswith("F"):
            motions = _freed(data, records, suspect.site, suspect.law)
            fresh = replace(records, records=true, data=motions)
        else:
            n_searched = len(records.searched)
            bands = [FusionRecipe({}, recipe.band) for recipe in records.fusion]
            fresh = prepare(true[:n_searched], true[n_searched:], bands)
        return fresh, model.on_motions(fresh.data)
    except (NRFError, np.linalg.LinAlgError):
        return None


def _freed(
    data: SearchData, records: PreparedRecords, site: Site, law: SensorFault
) -> Dataset:
    """Records in which a force, or the whole motion of a DOF, is freed of a fault.

    What is held out is corrected on its own.
    """
    segments = []
    for i, segment in enumerate(data.data.segments):
        channels = _channels_of(segment, records.records[i], site)
        changed = _freed_segment(segment, site, law, channels, _cuts(data, i))
        segments.append(replace(changed, valid=_finite_rows(changed, segment)))
    return Dataset(segments, data.data.n_samples)


def _cuts(data: SearchData, record: int) -> list[int]:
    """Rows of a record at which held-out pieces begin or end."""
    valid = data.data.segments[record].valid
    ends = set()
    for block in data.heldout:
        if block.segment == record:
            ends |= {valid.start + block.rows.start, valid.start + block.rows.stop}
    return sorted(ends - {valid.start, valid.stop})


def _channels_of(segment: Segment, record: Record, site: Site) -> dict[str, np.ndarray]:
    """A force, or the whole motion of a DOF as its channels read it."""
    if site.channel.startswith("F"):
        return {"F": segment.F[:, site.p - 1]}
    if site.channel:
        absolute = reads_absolute(record, site.channel[0])
        return motion_of_dof(segment, site.p, absolute)
    motion = motion_of_dof(segment, site.p, reads_absolute(record, "x"))
    return {**motion, "a": segment.a[:, site.p - 1]}


def _freed_segment(
    segment: Segment,
    site: Site,
    law: SensorFault,
    channels: Mapping[str, np.ndarray],
    cuts: Sequence[int],
) -> Segment:
    """A record with some channels freed of a fault, their pieces on their own."""
    changes = {}
    for key, channel in channels.items():
        if np.nan_to_num(channel).any():
            reading = np.asarray(channel, dtype=float)
            freed = _freed_channel(law, reading, segment.dt or 1.0, cuts)
            changes[key] = freed - reading
    return segment.moved(site.p, **changes)


def _freed_channel(
    law: SensorFault, reading: np.ndarray, dt: float, cuts: Sequence[int]
) -> np.ndarray:
    """A channel freed of a fault, its pieces on their own.

    As it was at the cuts, where a correction reaches beyond a piece.
    """
    pieces = [law.corrected(piece, dt) for piece in np.split(reading, cuts)]
    freed = np.concatenate(pieces)
    first = len(pieces[0]) // 2
    last = len(reading) - len(pieces[-1]) // 2
    filled = np.where(np.isnan(freed), reading, freed)
    freed[first:last] = filled[first:last]
    return freed


def _finite_rows(changed: Segment, before: Segment) -> slice:
    """From the first to the last row of a record that is finite after a correction."""
    valid = before.valid
    known = np.isfinite(before.F[valid]).all(axis=0)
    motion = np.hstack([changed.a, changed.v, changed.s, changed.F[:, known]])
    finite = np.isfinite(motion).all(axis=1)
    inside = valid.start + np.flatnonzero(finite[valid])
    return slice(int(inside[0]), int(inside[-1]) + 1)
