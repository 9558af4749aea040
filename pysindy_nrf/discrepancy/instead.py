"""Faults of sensors that explain the data instead of a force.

A gain or a delay that all sensors of a floor share is, to the equations of motion, a
tie of the floor above. No other alternative to the model names it: once the force is in
the model, nothing is left for the fault to explain.
"""

from __future__ import annotations

from collections.abc import Collection

from ..diagnosis.effects import effect_words
from ..diagnosis.facts import Alternative, Move
from ..identification.alternatives import masses_and_stiffnesses
from ..identification.intervals import parameters_of
from .effects import Finding


def fault_instead(
    force: Finding, fault: Finding, known_masses: Collection[int] = ()
) -> Alternative:
    """A fault, with which a force is not there, as an alternative to it.

    Parameters
    ----------
    force, fault : Finding
        Both added to one state.
    known_masses : collection of int
        DOFs whose mass is no parameter.
    """
    assert force.after is not None and fault.after is not None
    known = dict.fromkeys(known_masses, 0.0)
    here = parameters_of(force.after.model.chain_model(), known)
    there = parameters_of(fault.after.model.chain_model(), known)
    # of the force nothing remains
    change = there.reindex(here.index, fill_value=0.0) - here

    watched = masses_and_stiffnesses(here.index)
    shares = (change / here.abs())[watched].fillna(0.0)
    most = str(shares.abs().idxmax())

    law, site = fault.laws[0], fault.candidate.sites[0]
    words = effect_words(law.name, site, law.parameters, {}, law.units)
    return Alternative(
        f"a {words}",
        str(site),
        most,
        float(shares[most]),
        half_width=0.0,
        wider=0.0,
        # the force is not there beside it: both leave the same
        residual_share=1.0,
        residual_share_by_equation=1.0,
        moves={str(name): Move(float(size)) for name, size in change.items()},
    )
