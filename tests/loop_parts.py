"""Parts of the closed loop for tests: what a search begins with, and what it finds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from simulated_cases import simulated

from pysindy_nrf import Record, Site
from pysindy_nrf.diagnosis.evidence import evidence_of
from pysindy_nrf.discrepancy.amplitude import OtherCondition, at_other_amplitudes
from pysindy_nrf.discrepancy.balance_loop import BalanceLoop
from pysindy_nrf.discrepancy.candidate_search import best_findings
from pysindy_nrf.discrepancy.catalogue import (
    Experiment,
    candidates,
    with_all_storeys,
)
from pysindy_nrf.discrepancy.channel_errors import ChannelErrors
from pysindy_nrf.discrepancy.contradictions import contradictions
from pysindy_nrf.discrepancy.dictionary import dictionary
from pysindy_nrf.discrepancy.effects import Effect, RankedFinding
from pysindy_nrf.discrepancy.error_reduction import ErrorReduction, Powers
from pysindy_nrf.discrepancy.folds import split, window_length
from pysindy_nrf.discrepancy.growth import grown_law
from pysindy_nrf.discrepancy.model_extension import ModelExtension
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.request import SearchLimits, read_request
from pysindy_nrf.discrepancy.search_data import SearchData
from pysindy_nrf.discrepancy.windows import Windows
from pysindy_nrf.records import BlockRows, Dataset, Segment
from pysindy_nrf.records.fusion.noise_levels import levels_of

__all__ = ["OtherCondition", "at_other_amplitudes", "window_length"]


def start_of(record, baseline=None):
    """What a search of a record begins with."""
    limits = SearchLimits(None, None, 0, False)
    loop = BalanceLoop(read_request(record, None, baseline, None, None, limits))
    return loop.find_bands(loop.split(loop.prepare()))


def first_state(plan):
    """The linear chain fitted to a simulated record."""
    return start_of(Record(**simulated(plan).channels)).first


def tried_at(catalogue, chain, **test):
    """Candidates of a catalogue in a test of a chain."""
    experiment = Experiment(catalogue, chain, **test)
    return with_all_storeys(candidates(experiment), chain.sites)


def findings_of(state, catalogue):
    """The names of a catalogue beside a state, the best first."""
    forced = state.model.spectra.data.forced
    tried = tried_at(catalogue, state.model.chain, forced=forced)
    return best_findings(state, tried, 8)


def grown_at(state, effect_class, site):
    """The general law of a class that is grown at a site, and what it gains, dB."""
    model = state.model
    atoms = dictionary(effect_class, Site(site), model.spectra.data)
    law = grown_law(model, Site(site), atoms)
    if law is None:
        return None, 0.0
    after = model.with_laws([(Site(site), law)])
    return law, after.reduction_from(model).value


def freed_of_errors(state, model, tolerances, faults=()):
    """A model freed of likely errors, and the sizes of these by channel.

    Faults of sensors that were found before are pairs of a law and a channel.
    """
    known = []
    for law, channel in faults:
        known.append(Effect(law, Site(f"sensor {channel}"), type(law)()))
    errors = ChannelErrors(model.spectra, state.records, tolerances, known)
    freed = errors.freed(model)
    channels = [error.channel for error in errors.errors]
    return freed.model, dict(zip(channels, freed.sizes))


def scanned_reduction(model, site, law, known=None):
    """Error reduction of a law at a site on the samples of the fit, dB."""
    extension = ModelExtension(model, [(site, law)])
    return float(extension.fit_each([(law,)], known).reductions[0])


def reduction_between(before, after, reference, informative):
    """The error reduction from powers of the residual by fold, balance and band."""
    return ErrorReduction.between(
        Powers(before, reference), Powers(after, reference), informative
    )


def finding_of(value, without_fold, spread, **properties):
    """A finding with an error reduction of some size."""
    reduction = ErrorReduction(value, spread, without_fold, value, value)
    return RankedFinding(SimpleNamespace(**properties), reduction)


def windows_of(n_samples, folds, length, dt=0.01, centred=True):
    """Windows of a record of two channels, with some folds."""
    zeros = np.zeros(n_samples)
    data = Dataset([plain_segment(zeros, zeros, dt)], n_samples)
    blocks = [BlockRows(0, slice(low, high)) for low, high in folds]
    return Windows(data, blocks, length, centred=centred)


def search_data(record, heldout=None):
    """Fused records with folds and held-out pieces."""
    prepared = prepare(record, heldout)
    segments = prepared.data.segments
    folds = split(segments, window_length(segments), prepared.heldout)
    return SearchData(prepared.data, folds, {})


def plain_segment(drift, force, dt=0.01):
    """A record of two channels, its rates and accelerations equal to its drifts."""
    motion = np.column_stack([drift, drift])
    forces = np.column_stack([force, force])
    rows = slice(0, len(drift))
    time = np.arange(len(drift)) * dt
    return Segment("r", rows, motion, motion, motion, forces, time, valid=rows)


def folds_of(*segments, heldout=None):
    """Folds and held-out pieces of some records."""
    return split(segments, window_length(segments), heldout)


def contradictions_in(record, fused_as, data):
    """Contradictions of the channels of a record, its motion that of another one."""
    prepared = replace(prepare(fused_as), records=[record])
    return contradictions(prepared, data)


def noise_levels(record, rows):
    """Noise of every channel of a record, sized on some rows."""
    return levels_of(record, {}, rows)


def evidence_in(data, model):
    """What a model leaves of the rows that a search may look at."""
    return evidence_of(data.diagnosed(), model)
