"""The channels of one contiguous record fused into one motion of each DOF, SI units.

Band, noise levels, fusion, filter: each step is a function of what the steps before
return.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...common.warn import warn_user
from ...exceptions import ChannelError, DataQualityWarning
from ..checks.transfer_function import ORDERS
from ..record import BASES, Record
from ..zero_phase_filter import (
    MAX_NOISE_SHARE,
    Band,
    ZeroPhaseFilter,
    check_band,
    lowest_frequency,
)
from .block_fusion import ChannelSet, FusedMotions, fuse_motions
from .channel_table import MOTION_NAME, TIME_NAMES, ChannelTable
from .dof_fusion import DofKnowledge, FusedMotion
from .integration_rules import ComputedMotions, IntegrationRule, computed_motions

MIN_SAMPLES = 8
# Lower edge of a band over the corner of the fusion: 1 / (1 + (1/8)^4) of the motion at
# the edge is left.
EDGE_OVER_CORNER = 8


@dataclass(frozen=True)
class FusionSettings:
    """How channels are fused; the parameters of KinematicSmoother."""

    noise: str | Mapping[str, float] = "estimate"
    band: Band | str = None
    joint: bool = True
    spacing: Mapping[int, float] | None = None
    noise_share: float = MAX_NOISE_SHARE


@dataclass(frozen=True)
class FusedChannels:
    """The fused motion of a record, and how it was made.

    Arrays have a row for each sample of the record, NaN where a filter spoils it or a
    channel is NaN, and a column for each of ``dofs``.

    Attributes
    ----------
    dofs : list of int
        DOFs that have a motion channel.
    a, v, x : ndarray of shape (n_samples, len(dofs))
        Absolute accelerations, m/s^2, velocities, m/s, and displacements, m.
    others : dict of str to ndarray of shape (n_samples,)
        Channels that are not motions, through the same filter, and those that are NaN
        throughout.
    noise : dict of str to float
        Noise level of each measured motion channel, SI rms.
    spacing : dict of int to float
        Distance of the spline's knots by DOF, samples.
    high_pass : dict of int to float
        Frequency by DOF at which half of the motion is lost, Hz; 0 where displacement
        is measured.
    band : (float or None, float or None) or None
        The band applied, Hz.
    edge : int
        Rows at each end that the filter spoils.
    dof_by_dof : tuple of list of FusedMotion
        What each DOF by itself gave; empty unless it was to be kept.
    rule : IntegrationRule or None
        The rule by which the channels were computed: they are taken as they are. None
        if they are fused.
    """

    dofs: list[int]
    a: np.ndarray
    v: np.ndarray
    x: np.ndarray
    others: dict[str, np.ndarray]
    noise: dict[str, float]
    spacing: dict[int, float]
    high_pass: dict[int, float]
    band: Band
    edge: int = 0
    dof_by_dof: tuple[list[FusedMotion], ...] = ()
    rule: IntegrationRule | None = None

    def columns(self) -> dict[str, np.ndarray]:
        """``a1.., v1.., x1..``, then the other channels."""
        columns: dict[str, np.ndarray] = {}
        for kind, matrix in (("a", self.a), ("v", self.v), ("x", self.x)):
            columns |= {f"{kind}{j}": line for j, line in zip(self.dofs, matrix.T)}
        return columns | self.others

    def as_record(self, record: Record) -> Record:
        """The record with this motion in place of its channels."""
        unknown = np.full(record.n_samples, np.nan)
        force = [self.others.get(f"F{j + 1}", unknown) for j in range(record.n_dof)]
        return record.replace(
            force=np.array(force).T,
            acceleration=self._of_every_dof(self.a, record.n_dof),
            velocity=self._of_every_dof(self.v, record.n_dof),
            displacement=self._of_every_dof(self.x, record.n_dof),
            covariates={name: self.others[name] for name in record.covariates},
            **{key: self.others.get(name) for key, name in BASES.items()},
        )

    def as_frame(self, table: pd.DataFrame) -> pd.DataFrame:
        """This motion as a table, with the clock of the one that it comes from."""
        clock = {name: table[name].to_numpy() for name in TIME_NAMES if name in table}
        return pd.DataFrame(clock | self.columns(), index=table.index)

    def _of_every_dof(self, matrix: np.ndarray, n_dof: int) -> np.ndarray:
        """A column for every DOF, NaN where it has no motion channel."""
        if len(self.dofs) == n_dof:
            return matrix
        out = np.full((len(matrix), n_dof), np.nan)
        out[:, np.array(self.dofs) - 1] = matrix
        return out


def fuse_channels(
    table: ChannelTable,
    settings: FusionSettings,
    band: Band,
    noise: Mapping[str, float],
    keep: bool = False,
    dof_by_dof: Sequence[list[FusedMotion]] = (),
) -> FusedChannels:
    """Fuse the channels of one contiguous record.

    Parameters
    ----------
    table : ChannelTable
    settings : FusionSettings
    band : (float or None, float or None) or None
        Hz; see :func:`choose_band`.
    noise : mapping of str to float
        Levels that are known, by channel, SI rms.
    keep, dof_by_dof
        See :func:`~.block_fusion.fuse_motions`.

    Raises
    ------
    ChannelError
        If no channel is a motion, one is constant, or the samples are too few.
    """
    _require_motion(table)
    table.require_moving()
    units = unit_factors(table.fs)
    dofs = list(table.motions)
    channels = ChannelSet([table.channels_of(j) for j in dofs], list(units.values()))
    known = [_knowledge(table, j, settings, band, noise) for j in dofs]
    computed = _computed_by_a_rule(table, channels, known)
    if computed is None:
        fused = fuse_motions(channels, known, settings.joint, keep, dof_by_dof)
    else:
        fused = FusedMotions(computed.motions)

    a, v, x = _in_si_units(fused.motions, table)
    others = dict(table.other_channels)
    edge = 0
    if band is not None:
        operator = _band_filter(band, table)
        edge = operator.edge
        a, v, x = (_without_edges(operator.apply(y), edge) for y in (a, v, x))
        for name, values in others.items():
            others[name] = _without_edges(operator.apply(values), edge)
    return FusedChannels(
        dofs,
        table.in_all_rows(a),
        table.in_all_rows(v),
        table.in_all_rows(x),
        {name: table.in_all_rows(y) for name, y in others.items()} | table.unmeasured,
        _noise_levels(table, fused.motions),
        {j: float(motion.spacing) for j, motion in zip(dofs, fused.motions)},
        {j: float(m.high_pass) * table.fs for j, m in zip(dofs, fused.motions)},
        band,
        edge,
        fused.dof_by_dof,
        None if computed is None else computed.rule,
    )


def _computed_by_a_rule(
    table: ChannelTable, channels: ChannelSet, known: Sequence[DofKnowledge]
) -> ComputedMotions | None:
    """Motions that a time integration rule made; None if they were measured.

    Where the base has a displacement, accelerometers were integrated to give all of
    them: what obeys a rule there is the processing, not the motion.
    """
    if "xg" in table.measured:
        return None
    levels = np.array([knowledge.noise for knowledge in known])
    return computed_motions(channels, _drives(table), levels)


def known_noise(
    table: ChannelTable, noise: str | Mapping[str, float]
) -> dict[str, float]:
    """Noise levels given for the motion channels of a record, by channel or by kind."""
    if isinstance(noise, str) and noise == "estimate":
        return {}
    if not isinstance(noise, Mapping):
        raise ChannelError(
            f"noise={noise!r} is unknown",
            "Give 'estimate' or levels like {'a': 0.02, 'x': 1e-5}.",
        )
    for key in noise:
        if key not in ORDERS and not MOTION_NAME.fullmatch(str(key)):
            raise ChannelError(
                f"noise has an unknown key {key!r}",
                "Use 'a', 'v', 'x' or channel names like 'a1'.",
            )

    levels = {}
    for names in table.motions.values():
        for kind, name in names.items():
            level = noise.get(name, noise.get(kind))
            if level is not None:
                levels[name] = _checked_level(level, name)
    return levels


def _checked_level(level: float, channel: str) -> float:
    if not np.isfinite(level) or level <= 0:
        raise ChannelError(
            f"The noise level {level!r} of channel {channel} is not positive",
            "Give its rms in SI units.",
        )
    return float(level)


def choose_band(tables: Sequence[ChannelTable], settings: FusionSettings) -> Band:
    """The band that was given, or the one that all records support.

    With ``"auto"`` that is None where every DOF has a sensor of velocity or
    displacement; else from the lowest frequency up at which accelerations determine the
    displacement in every record, which a warning names.
    """
    if not isinstance(settings.band, str):
        return settings.band
    if settings.band != "auto":
        raise ChannelError(
            f"band={settings.band!r} is unknown", "Give (lo, hi) in Hz, None or 'auto'."
        )
    edges = []
    accelerated: set[int] = set()
    for table in tables:
        dofs = [j for j, names in table.motions.items() if set(names) == {"a"}]
        if not dofs:
            continue
        measured = [table.measured[table.motions[j]["a"]] for j in dofs]
        accelerations = np.column_stack(measured) - table.base[:, None]
        lowest = lowest_frequency(accelerations, table.fs, settings.noise_share)
        if lowest is not None:
            edges.append(lowest)
            accelerated.update(dofs)
    if not edges:
        return None

    warn_user(
        f"DOF {', '.join(map(str, sorted(accelerated)))}: only the acceleration is"
        f" measured, which determines the displacement above about {max(edges):.3g} Hz."
        " Force and response are taken from there up; give band=(lo, hi) to choose"
        " yourself.",
        DataQualityWarning,
    )
    return max(edges), None


def warn_of_lost_motion(fused: FusedChannels) -> None:
    """Warn of motion below a frequency that the fusion loses and the force keeps."""
    corners = {j: corner for j, corner in fused.high_pass.items() if corner > 0}
    if not corners or fused.band is not None:
        return
    warn_user(
        f"DOF {', '.join(map(str, corners))}: no displacement is measured, so motion"
        f" below about {2 * max(corners.values()):.3g} Hz is lost while the force keeps"
        " it. Give band=(lo, hi) above that, so that force and response are treated"
        " alike.",
        DataQualityWarning,
    )


def unit_factors(fs: float) -> dict[str, float]:
    """Factors that bring a channel of each kind to units of samples."""
    return {kind: 1.0 / fs**order for kind, order in ORDERS.items()}


def _require_motion(table: ChannelTable) -> None:
    if not table.motions:
        names = ", ".join(list(table.measured)[:9]) or "the table"
        raise ChannelError(
            f"No channel of {names} is a motion",
            "Name accelerations a1.., velocities v1.., displacements x1...",
        )
    if table.n_samples < MIN_SAMPLES:
        raise ChannelError(
            f"{table.n_samples} samples are too few to fuse",
            "Give a longer record, or use smooth=False.",
        )


def _knowledge(
    table: ChannelTable,
    dof: int,
    settings: FusionSettings,
    band: Band,
    noise: Mapping[str, float],
) -> DofKnowledge:
    """What need not be found of a DOF, in units of samples."""
    names = table.motions[dof]
    levels = np.full(3, np.nan)
    for (kind, unit), order in zip(unit_factors(table.fs).items(), ORDERS.values()):
        if kind in names:
            levels[order] = noise.get(names[kind], np.nan) * unit

    lowest, _ = check_band(band, table.fs)
    corner = None if lowest is None else lowest / EDGE_OVER_CORNER / table.fs
    spacing = None if settings.spacing is None else settings.spacing.get(dof)
    # knots at every sample may mean clean channels: these are looked at again
    if spacing is not None and not spacing > 1.0:
        spacing = None
    return DofKnowledge(levels, corner, spacing)


def _drives(table: ChannelTable) -> list[list[np.ndarray]]:
    """Force on each DOF, and the acceleration of the base."""
    others = table.other_channels
    base = [table.base] if table.base.any() else []
    forces = [[others[f"F{j}"]] if f"F{j}" in others else [] for j in table.motions]
    return [force + base for force in forces]


def _in_si_units(
    motions: Sequence[FusedMotion], table: ChannelTable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Absolute accelerations, velocities and displacements, (n_samples, n_dof)."""
    fs = table.fs
    shape = len(motions), table.n_samples
    a = np.empty(shape)
    v = np.empty(shape)
    x = np.empty(shape)
    for j, motion in enumerate(motions):
        displacement, velocity, acceleration = motion.evaluate()
        x[j] = displacement
        v[j] = velocity * fs
        a[j] = acceleration * fs**2 + table.base
    return a.T, v.T, x.T


def _band_filter(band: Band, table: ChannelTable) -> ZeroPhaseFilter:
    """The filter of all channels, if the record is long enough for it."""
    operator = ZeroPhaseFilter(band, table.fs)
    if table.n_samples <= 2 * operator.edge:
        raise ChannelError(
            f"The record has {table.n_samples} samples, the filter {band} Hz spoils"
            f" {operator.edge} at each end",
            "Raise the lower band edge, give a longer record, or filter with"
            " ZeroPhaseFilter and keep the ends.",
        )
    return operator


def _without_edges(values: np.ndarray, edge: int) -> np.ndarray:
    """Values with NaN in the rows at the ends that the filter spoils."""
    values[:edge] = np.nan
    values[len(values) - edge :] = np.nan
    return values


def _noise_levels(
    table: ChannelTable, motions: Sequence[FusedMotion]
) -> dict[str, float]:
    """Noise level of each measured motion channel, SI rms, in the order given."""
    units = unit_factors(table.fs)
    levels = {}
    for names, motion in zip(table.motions.values(), motions):
        for kind, name in names.items():
            levels[name] = float(motion.noise[ORDERS[kind]] / units[kind])
    return {name: levels[name] for name in table.measured if name in levels}
