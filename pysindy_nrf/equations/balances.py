"""The equations of motion of measured records: their columns, block by block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.layout import Block, Group, LawLayout, Layout, Recipe, block_size
from ..chain.sites import Site
from ..laws.shape import Motion
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter

States = dict[tuple[Site, int], np.ndarray]


@dataclass(frozen=True)
class BalanceEquations:
    """Equations of motion of records in which every floor is measured.

    Attributes
    ----------
    data : Dataset
    layout : LawLayout
        The laws whose columns stand in the equations.
    filters : sequence of ZeroPhaseFilter or None
        One for each record; columns and right-hand sides are filtered alike.
    """

    data: Dataset
    layout: LawLayout
    filters: Sequence[ZeroPhaseFilter | None]

    def blocks(self, record: int) -> Iterator[Block]:
        """Columns of all equations along a record, block by block."""
        segment = self.data.segments[record]
        filter = self.filters[record]
        states: States | None = {} if filter is None else None
        return blocks_of_segment(segment, self.layout, filter=filter, states=states)

    def whole_record(self, record: int) -> Block:
        """All valid rows of a record as one block."""
        segment = self.data.segments[record]
        return whole_block(segment, self.layout, self.filters[record])


def blocks_of_segment(
    segment: Segment,
    layout: LawLayout,
    size: int | None = None,
    filter: ZeroPhaseFilter | None = None,
    states: States | None = None,
) -> Iterator[Block]:
    """Columns of all equations of motion along a record, block by block.

    A record that is filtered is one block, and so is one on which a law has memory,
    unless ``states`` are given: what laws remember, by site and number of the law at
    the site. They are moved along.
    """
    start, stop = segment.valid.start, segment.valid.stop
    in_one = filter is not None or (layout.has_memory and states is None)
    step = max(stop - start, 1) if in_one else size or block_size(layout)

    reader = _BlockReader(segment, layout, states)
    for begin in range(start, stop, step):
        block = reader.block(slice(begin, min(begin + step, stop)))
        yield block if filter is None else _filtered(block, filter)


def whole_block(
    segment: Segment, layout: LawLayout, filter: ZeroPhaseFilter | None
) -> Block:
    """All valid rows of a record as one block, its arrays our own."""
    terms = []
    accelerations = []
    forces = []
    for block in blocks_of_segment(segment, layout, filter=filter):
        terms.append(block.terms)
        accelerations.append(block.acceleration)
        forces.append(block.force)
    return Block(
        np.concatenate(terms, axis=1),
        np.concatenate(accelerations, axis=1),
        np.concatenate(forces, axis=1),
    )


def rows_of(
    layout: Layout, group: Group, block: Block, known_masses: Mapping[int, float]
) -> np.ndarray:
    """Rows of one equation of motion, or of several summed, for all samples of a block.

    They are ``[terms | a | F]`` of one, ``[terms | F - m a]`` of a sum.
    """
    dofs = [j - 1 for j in group.dofs]
    rows = [block.terms[layout.slices[site]] for site in group.sites]
    if len(dofs) == 1:
        rows.append(block.acceleration[dofs])
        rows.append(block.force[dofs])
    else:
        masses = np.array([known_masses[j] for j in group.dofs])
        inertia = masses @ block.acceleration[dofs]
        rows.append((block.force[dofs].sum(axis=0) - inertia)[None])
    return np.concatenate(rows)


class _BlockReader:
    """Blocks of one record, in the order of its samples."""

    def __init__(
        self, segment: Segment, layout: LawLayout, states: States | None
    ) -> None:
        self.segment = segment
        self.layout = layout
        self.recipe = layout.recipe
        self.states = states
        self.side_by_side: np.ndarray | None = None
        if _reads_all_storeys(self.recipe, segment.n_dof):
            self.side_by_side = _side_by_side(segment.a, segment.v, segment.s)

    def block(self, rows: slice) -> Block:
        """The columns of some samples."""
        segment = self.segment
        if self.side_by_side is None:
            acceleration = _as_rows(segment.a, rows)
            source = self._source(rows)
        else:
            channels = _as_rows(self.side_by_side, rows)
            acceleration = channels[: segment.n_dof]
            source = channels[segment.n_dof :]

        force = _as_rows(segment.F, rows)
        weights = None if segment.weights is None else segment.weights[rows]
        n_terms = self.layout.n_terms
        return Block(None, acceleration, force, source, self.recipe, n_terms, weights)

    def _source(self, rows: slice) -> np.ndarray:
        """Rates, drifts and columns that are no products of them, one row each."""
        out = np.empty((self.recipe.n_source, rows.stop - rows.start))
        n_sites = len(self.recipe.motions)
        rates, drifts, others = np.split(out, [n_sites, 2 * n_sites])
        self._read_motions(rows, rates, drifts)

        # what a law remembers belongs to the sample before, which is read, too
        goes_on = rows.start > self.segment.valid.start or bool(self.states)
        lead = 1 if goes_on else 0
        motions: dict[Site, Motion] = {}
        first = 0
        for site, number, width in self.recipe.others:
            law = self.layout.laws[site][number]
            if law.has_memory and self.states is not None:
                state = self.states.setdefault((site, number), np.zeros(law.n_states))
                longer = slice(rows.start - lead, rows.stop)
                motion = self.segment.motion(site, longer)
                columns = law.features(motion, state)[lead:]
            else:
                if site not in motions:
                    # laws of a site follow each other: one motion at a time is enough
                    motions = {site: self.segment.motion(site, rows)}
                columns = law.features(motions[site])
            others[first : first + width] = columns.T
            first += width
        return out

    def _read_motions(self, rows: slice, rates: np.ndarray, drifts: np.ndarray) -> None:
        """Rates and drifts of the sites, neighbouring storeys at once."""
        v, s = self.segment.v, self.segment.s
        sites = self.recipe.motions
        storeys = _neighbouring_storeys(sites)
        if storeys is not None:
            rates[:] = v[rows, storeys].T
            drifts[:] = s[rows, storeys].T
            return
        for i, site in enumerate(sites):
            between = slice(site.q, site.p)
            rates[i] = v[rows, between].sum(axis=1, dtype=np.float64)
            drifts[i] = s[rows, between].sum(axis=1, dtype=np.float64)


def _reads_all_storeys(recipe: Recipe, n_dof: int) -> bool:
    """Whether all columns are products of the rates and drifts of all storeys."""
    ends = [(site.q, site.p) for site in recipe.motions]
    return not recipe.others and ends == [(j, j + 1) for j in range(n_dof)]


def _neighbouring_storeys(sites: Sequence[Site]) -> slice | None:
    """Columns of v and s if the sites are storeys one above the other, else None."""
    if not sites:
        return None
    first, last = sites[0].q, sites[-1].p
    ends = [(site.q, site.p) for site in sites]
    if ends != [(j, j + 1) for j in range(first, last)]:
        return None
    return slice(first, last)


def _as_rows(channels: np.ndarray, rows: slice) -> np.ndarray:
    """Some samples as doubles, one row a channel; a read-only view where they are."""
    view = channels[rows].T
    view.flags.writeable = False
    return np.asarray(view, dtype=np.float64)


def _side_by_side(a: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray | None:
    """The matrix of which a, v and s are neighbouring columns, if they are.

    It takes one transposition instead of three.
    """
    alike = a.dtype == v.dtype == s.dtype and a.shape == v.shape == s.shape
    if not alike or not a.strides == v.strides == s.strides or a.strides[1] <= 0:
        return None

    first, second, third = (x.__array_interface__["data"][0] for x in (a, v, s))
    width = a.shape[1] * a.strides[1]
    if second - first != width or third - second != width:
        return None
    shape = (a.shape[0], 3 * a.shape[1])
    return np.lib.stride_tricks.as_strided(a, shape, a.strides, writeable=False)


def _filtered(block: Block, filter: ZeroPhaseFilter) -> Block:
    """A block of a whole record, every column filtered alike."""
    terms = np.ascontiguousarray(filter.apply(block.terms.T).T)
    acceleration = np.ascontiguousarray(filter.apply(block.acceleration.T).T)
    # a column of NaN, an unknown force, stays as it is
    force = np.ascontiguousarray(filter.apply(block.force.T).T)
    return Block(terms, acceleration, force, weights=block.weights)
