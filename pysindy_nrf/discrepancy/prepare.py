"""From the records of a user to fused records, ready to be searched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..diagnosis.motions import covariates_with_base
from ..exceptions import ChannelError
from ..identification.displacement_drifts import without_drifts
from ..identification.force_corners import without_force_corners
from ..identification.force_courses import with_force_courses
from ..identification.problem import Problem, flexible_laws
from ..records.checks.corners import without_corners
from ..records.dataset import Dataset
from ..records.fusion.kinematic_smoother import KinematicSmoother
from ..records.fusion.kinematics import FusedRecord, fuse_record
from ..records.input_arrays import require_one_chain, segment_of
from ..records.record import Record

Band = tuple[float | None, float | None]


@dataclass(frozen=True)
class FusionSettings:
    """Numbers of the fusion that a search asks for."""

    # Noise of every channel, as a share of its rms, below which the channels are taken
    # as they are: the bias of least squares is its square, 2e-5 of a mass or stiffness.
    clean_noise: float = 0.004
    # Share of a motion that noise may be where accelerations alone are integrated. Its
    # square biases the estimates; the smaller share of a fit would cost first modes.
    integration_noise: float = 0.1
    # A displacement starts at rest if it scatters there by less than this share of its
    # own scatter.
    at_rest: float = 0.03
    # Rest is looked for in the first of so many parts of a record, and in so many
    # samples at least.
    rest_parts: int = 500
    rest_samples: int = 4


FUSION = FusionSettings()


@dataclass(frozen=True)
class FusionRecipe:
    """How the channels of one record were fused; like records are fused alike."""

    # Noise of each channel, SI rms; estimated where there is none.
    noise: dict[str, float]
    # Hz, where accelerations alone give a motion; None elsewhere.
    band: Band | str | None = None
    # Distances of the knots of each DOF, samples.
    knots: Mapping[int, float] | None = None


@dataclass(frozen=True, eq=False)
class PreparedRecords:
    """Fused records.

    Attributes
    ----------
    records : list of Record
        As measured, accelerations before the high-pass filters that were found; those
        held out completely stand last.
    data : Dataset
        The fused motion; that of the base is among the covariates as ``ag``, ``vg``.
    fusion : list of FusionRecipe
        One for each record.
    heldout : list of int or None
        Numbers of the records held out completely.
    clean : bool
        Whether all channels were taken as they are.
    """

    records: list[Record]
    data: Dataset
    fusion: list[FusionRecipe]
    heldout: list[int] | None = None
    clean: bool = False

    @property
    def searched(self) -> list[Record]:
        """The records that are not held out completely."""
        return self.records[: len(self.records) - len(self.heldout or ())]


def prepare(
    records: Record | Sequence[Record],
    heldout: Record | Sequence[Record] | None = None,
    like: Sequence[FusionRecipe] | None = None,
) -> PreparedRecords:
    """Fuse the channels of every record.

    Parameters
    ----------
    records, heldout : Record or sequence of Record
    like : sequence of FusionRecipe, optional
        Noise levels, bands and knots to fuse each record with. Such records were made
        from checked ones, and their channels are not checked again.
    """
    searched = as_records(records, "records")
    not_searched = as_records(heldout, "heldout")
    every = [_without_offset(rec) for rec in (*searched, *not_searched)]
    require_one_chain(every, every[0].n_dof)

    segments = []
    fusion = []
    as_used = []
    clean, n_rows = True, 0
    for number, record in enumerate(every):
        wanted = None if like is None else like[number]
        fused, recipe = _fused(record, wanted)
        record = without_corners(record, fused.notes)
        as_used.append(record)
        if _is_clean(record, recipe.noise):
            as_measured = fuse_record(record, False, check=False)
            fused = replace(
                as_measured,
                notes=fused.notes,
                simulation_method=fused.simulation_method,
                hold=fused.hold,
            )
        else:
            clean = False

        segments.append(segment_of(record, fused, n_rows, covariates_with_base(record)))
        n_rows += record.n_samples
        fusion.append(recipe)

    numbers = list(range(len(searched), len(every))) if not_searched else None
    return PreparedRecords(as_used, Dataset(segments, n_rows), fusion, numbers, clean)


def with_corrected_channels(
    prepared: PreparedRecords, problem: Problem
) -> PreparedRecords:
    """The records with forces before their high-pass filters, and without slow drifts.

    Asked with general laws, so that a law that is missing is neither.
    """
    drifts = {}
    for site in problem.chain.sites:
        sizes = [seg.motion(site, seg.valid).s.std() for seg in prepared.data.segments]
        drifts[site] = float(max(sizes))
    general = problem.with_laws(flexible_laws(problem, drifts))

    data = replace(prepared.data, records=tuple(prepared.records))
    corrected = without_drifts(general, without_force_corners(general, data))
    if not general.has_free_shapes:
        corrected = with_force_courses(general, corrected)
    if corrected is data:
        return prepared
    return replace(
        prepared,
        records=list(corrected.records),
        data=replace(corrected, records=()),
    )


def as_records(records: object, name: str) -> list[Record]:
    """A list of records, or an error."""
    if isinstance(records, Record):
        return [records]

    records = [] if records is None else records
    if not isinstance(records, Sequence) or not all(
        isinstance(r, Record) for r in records
    ):
        raise ChannelError(
            f"{name} holds something that is not a Record",
            "Build them with Record(...) or Record.from_frame(df).",
        )
    if not records and name == "records":
        raise ChannelError(
            "There is no record to search", "Pass a Record or a list of them."
        )
    return list(records)


def _fused(
    record: Record, like: FusionRecipe | None
) -> tuple[FusedRecord, FusionRecipe]:
    """The motion of a record, and how its channels were fused."""
    recipe = FusionRecipe({}, band="auto") if like is None else like
    noise = {name: level for name, level in recipe.noise.items() if level > 0}
    smoother = KinematicSmoother(
        noise=noise or "estimate",
        band=recipe.band,
        spacing=recipe.knots,
        noise_share=FUSION.integration_noise,
    )

    fused = fuse_record(record, smoother, check=like is None)

    levels = {str(name): float(level) for name, level in smoother.noise_.items()}
    return fused, FusionRecipe(levels, smoother.band_, smoother.spacing_.to_dict())


def _without_offset(record: Record) -> Record:
    """The record with the zero of displacements that no other channel knows at rest.

    At the mean of the motion if the record does not start at rest.
    """
    others = (record.acceleration, record.velocity)
    if record.displacement is None or any(y is not None for y in others):
        return record

    changes = {}
    for key in ("displacement", "base_displacement"):
        x = getattr(record, key)
        if x is None:
            continue
        start = x[: max(FUSION.rest_samples, len(x) // FUSION.rest_parts)]
        moves = np.nanstd(start, axis=0) > FUSION.at_rest * np.nanstd(x, axis=0)
        zero = np.where(moves, np.nanmean(x, axis=0), np.nanmean(start, axis=0))
        changes[key] = x - zero
    return record.replace(**changes)


def _is_clean(record: Record, noise: dict[str, float]) -> bool:
    """Whether every motion is measured and the channels of each DOF agree."""
    channels = record.channels()
    wanted = []
    for kind in "avx":
        wanted += [f"{kind}{j}" for j in range(1, record.n_dof + 1)]

    needed = list(wanted)
    if record.coordinates == "absolute" and record.base_moves:
        needed += ["vg", "xg"]
    if any(name not in channels for name in needed):
        return False

    for name in wanted:
        size = np.nanstd(channels[name])
        if not noise.get(name, np.inf) <= FUSION.clean_noise * size:
            return False
    return True
