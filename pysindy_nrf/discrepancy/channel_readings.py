"""What errors of the channels change of the fused motion and the forces of a record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ..records.dataset import Dataset, Segment
from ..records.fusion import integrate
from ..records.record import Record
from .prepare import PreparedRecords
from .search_data import SearchData

# Orders of the derivative that an error adds to a channel, as ``gain`` and
# ``cross_axis`` add the channel itself.
_ORDERS = {"delay": 1, "lag": 2}


@dataclass(frozen=True)
class CalibrationError:
    """An error that a channel may have: it reads part of a channel, or of a derivative.

    Attributes
    ----------
    kind : str
        ``"a"``, ``"v"``, ``"x"`` or ``"F"``.
    dof : int
        Of the channel.
    name : str
        ``"gain"``, ``"cross_axis"``, ``"delay"`` or ``"lag"``.
    source : int
        DOF whose channel is read, too.
    deviation : float
        Standard deviation of that part.
    """

    kind: str
    dof: int
    name: str
    source: int
    deviation: float

    @property
    def channel(self) -> str:
        """Name of the channel."""
        return f"{self.kind}{self.dof}"

    @property
    def order(self) -> int:
        """Order of the derivative that is read, too."""
        return _ORDERS.get(self.name, 0)


SizedError = tuple[CalibrationError, float]


def possible_errors(
    measured: set[str], n_dof: int, tolerances: Mapping[str, float]
) -> Iterator[CalibrationError]:
    """Every error that a measured channel may have within rectangular tolerances.

    What delays a channel by tau also weakens its high frequencies, by
    ``(w tau)^2 / 2``: that is its lag.
    """
    lag = tolerances.get("delay", 0.0) ** 2 / 2
    for kind in "avxF":
        for dof in range(1, n_dof + 1):
            if f"{kind}{dof}" not in measured:
                continue
            for name, limit in {**tolerances, "lag": lag}.items():
                if limit:
                    for source in _sources(kind, dof, name, n_dof):
                        deviation = limit / np.sqrt(3.0)
                        yield CalibrationError(kind, dof, name, source, deviation)


def _sources(kind: str, dof: int, name: str, n_dof: int) -> list[int]:
    """DOFs whose motion a channel may read; a force is read from its own DOF alone."""
    if name != "cross_axis":
        return [dof]
    if kind == "F":
        return []
    return [j for j in range(1, n_dof + 1) if j != dof]


def reads_absolute(record: Record, kind: str) -> bool:
    """Whether a kind of channel reads the motion of the base, too."""
    return kind == "a" or record.coordinates == "absolute"


def motion_of_dof(segment: Segment, dof: int, absolute: bool) -> dict[str, np.ndarray]:
    """Displacement, velocity and acceleration of a DOF.

    All absolute or all relative to the base, as the channel that derives them reads.
    """
    motion = {
        "x": segment.s[:, :dof].sum(axis=1),
        "v": segment.v[:, :dof].sum(axis=1),
        "a": segment.a[:, dof - 1],
    }
    if not segment.base_moves:
        return motion
    base = _base_motion(segment)
    if absolute:
        return {**motion, "x": motion["x"] + base["x"], "v": motion["v"] + base["v"]}
    return {**motion, "a": motion["a"] - base["a"]}


def _base_motion(segment: Segment) -> dict[str, np.ndarray]:
    """Displacement, velocity and acceleration of the base, from the last of them.

    In the band of the fused motion; NaN where the acceleration is.
    """
    assert segment.ag is not None and segment.dt is not None
    known = np.isfinite(segment.ag)
    motion = {"a": segment.ag}
    for kind, order in (("v", 1), ("x", 2)):
        motion[kind] = np.full(segment.n_samples, np.nan)
        motion[kind][known] = integrate(
            segment.ag[known], segment.dt, order=order, detrend=True
        )
    return motion


class ChannelReadings:
    """The channels of one record, as far as the search sees them."""

    def __init__(self, data: SearchData, records: PreparedRecords, record: int) -> None:
        self.segment = data.data.segments[record]
        self.runs = data.runs_in_record(record)
        self.clean = records.clean
        self.noise = records.fusion[record].noise
        self.step = self.segment.dt or 1.0
        self.record = records.records[record]
        motions = {c for c in self.record.measured if c[0] != "F"}
        self.measured = motions | self._forces()
        self._spectra: dict[tuple[int, int, bool], list[np.ndarray]] = {}
        self._shares: dict[tuple[str, int, int], np.ndarray] = {}

    def _forces(self) -> set[str]:
        """Channels of the forces that are known and act."""
        forces = self.segment.F[self.segment.valid]
        known = ~np.isnan(forces).any(axis=0) & forces.any(axis=0)
        return {f"F{j + 1}" for j in np.flatnonzero(known)}

    def with_errors(self, errors: Sequence[SizedError]) -> Segment:
        """The record with further errors of its channels."""
        by_dof: dict[int, list[SizedError]] = {}
        for error, size in errors:
            if error.channel in self.measured:
                by_dof.setdefault(error.dof, []).append((error, size))

        segment = self.segment
        for dof, sized in by_dof.items():
            segment = segment.moved(dof, **self._changes(sized))
        return segment

    def _changes(self, errors: Sequence[SizedError]) -> dict[str, np.ndarray]:
        """Changes of the motion and the force of one DOF, (n_samples,)."""
        changes: dict[str, np.ndarray] = {}
        spectra = [np.zeros((3, 1)) for _ in self.runs]

        for error, size in errors:
            if error.kind == "F" or self.clean:
                change = size * self._direct(error)
                changes[error.kind] = changes.get(error.kind, 0.0) + change
                continue
            transforms = self._transforms(error)
            for k, (run, transform) in enumerate(zip(self.runs, transforms)):
                share = self._share(error.kind, error.dof, run.stop - run.start)
                spectra[k] = spectra[k] + size * share * transform

        if any(np.any(spectrum) for spectrum in spectra):
            fused = np.zeros((3, self.segment.n_samples))
            for run, spectrum in zip(self.runs, spectra):
                fused[:, run] = irfft(spectrum, run.stop - run.start)
            changes.update(zip("xva", fused))
        return changes

    def _direct(self, error: CalibrationError) -> np.ndarray:
        """What a channel that is taken as it is reads, too."""
        if error.kind == "F":
            channel = self.segment.F[:, error.dof - 1]
        else:
            channel = self._motion(error)[error.kind]
        return _derivative(np.asarray(channel, dtype=float), self.step, error.order)

    def _motion(self, error: CalibrationError) -> dict[str, np.ndarray]:
        """The motion that a channel with an error reads, too."""
        absolute = reads_absolute(self.record, error.kind)
        return motion_of_dof(self.segment, error.source, absolute)

    def _transforms(self, error: CalibrationError) -> list[np.ndarray]:
        """Spectra of derivatives of displacement, velocity, acceleration in each run.

        Each of shape (3, n_lines).
        """
        order = error.order
        key = error.source, order, reads_absolute(self.record, error.kind)
        if key not in self._spectra:
            motion = self._motion(error)
            transforms = []
            for run in self.runs:
                lines = [_derivative(motion[k][run], self.step, order) for k in "xva"]
                transforms.append(rfft(lines))
            self._spectra[key] = transforms
        return self._spectra[key]

    def _share(self, kind: str, dof: int, n_samples: int) -> np.ndarray:
        """Part that a channel has in the fused motion, by frequency.

        Fusion gives it this part by the noise of all channels of the DOF.
        """
        key = kind, dof, n_samples
        if key not in self._shares:
            omega = 2.0 * np.pi * rfftfreq(n_samples, self.step)
            weight, total = np.zeros(len(omega)), np.zeros(len(omega))
            for power, channel in enumerate("xva"):
                noise = self.noise.get(f"{channel}{dof}", 0.0)
                if noise > 0:
                    square = (omega**power / noise) ** 2
                    total += square
                    weight = square if channel == kind else weight
            self._shares[key] = np.where(
                total > 0, weight / np.where(total > 0, total, 1.0), 0.0
            )
        return self._shares[key]


def with_errors(
    data: SearchData,
    readings: Mapping[int, ChannelReadings],
    errors: Sequence[SizedError],
) -> Dataset:
    """Records whose channels have further errors of some sizes."""
    segments = list(data.data.segments)
    for record, channels in readings.items():
        segments[record] = channels.with_errors(errors)
    return Dataset(segments, data.data.n_samples)


def _derivative(signal: np.ndarray, step: float, order: int) -> np.ndarray:
    """Derivative of some order by differences."""
    for _ in range(order):
        signal = np.gradient(signal, step)
    return signal
