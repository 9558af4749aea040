"""Parts of the closed loop for tests: what a search begins with, and what it finds."""

import numpy as np
from simulated_cases import simulated

from pysindy_nrf import Record
from pysindy_nrf.discrepancy.balance_loop import BalanceLoop
from pysindy_nrf.discrepancy.candidate_search import CandidateSearch
from pysindy_nrf.discrepancy.catalogue import (
    Experiment,
    candidates,
    with_all_storeys,
)
from pysindy_nrf.discrepancy.folds import split, window_length
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.request import SearchLimits, read_request
from pysindy_nrf.discrepancy.search_data import SearchData
from pysindy_nrf.records import Segment


def start_of(record, baseline=None):
    """What a search of a record begins with."""
    limits = SearchLimits(None, None, 0, False)
    loop = BalanceLoop(read_request(record, None, baseline, None, None, limits))
    return loop.find_bands(loop.split(loop.prepare()))


def first_state(plan):
    """The linear chain fitted to a simulated record."""
    return start_of(Record(**simulated(plan).channels)).first


def findings_of(state, catalogue):
    """What a search finds beside a state, the best first."""
    chain = state.model.chain
    experiment = Experiment(catalogue, chain, (), state.model.spectra.data.forced)
    tried = with_all_storeys(candidates(experiment), chain.sites)
    return CandidateSearch(tried).findings(state)


def search_data(record, heldout=None):
    """Fused records with folds and held-out pieces."""
    prepared = prepare(record, heldout)
    segments = prepared.data.segments
    folds = split(segments, window_length(segments), prepared.heldout)
    return SearchData(prepared.data, *folds, {})


def plain_segment(drift, force, dt=0.01):
    """A record of two channels, its rates and accelerations equal to its drifts."""
    motion = np.column_stack([drift, drift])
    forces = np.column_stack([force, force])
    rows = slice(0, len(drift))
    time = np.arange(len(drift)) * dt
    return Segment("r", rows, motion, motion, motion, forces, time, valid=rows)
