"""Laws by which a storey that does not change may depend on the amplitude.

A storey that softens with the amplitude loses stiffness in a strong phase, and so does
one that is damaged. A change is claimed only where these laws do not explain it:
springs and dampings of second and third order, friction, and elasto-plastic sliders in
parallel. Together such sliders follow any hysteresis of Masing's kind (Iwan, Journal of
Applied Mechanics 33, 1966).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ...chain.sites import Site
from ...laws import (
    AbsoluteQuadraticStiffness,
    CoulombFriction,
    CubicStiffness,
    ForceLaw,
    Jenkins,
    QuadraticDamping,
    QuadraticStiffness,
)
from ...records.dataset import Dataset
from ..problem import Problem

# Yield drifts of the sliders, as shares of the largest drift: three quarters of an
# octave apart, down to a hundredth, below which a slider is dry friction.
YIELD_SHARES = 2.0 ** (-0.75 * np.arange(1, 10))


def with_amplitude_dependence(
    problem: Problem, data: Dataset, sites: Collection[Site]
) -> Problem:
    """The problem with laws of the amplitude at some sites."""
    laws: dict[Site, list[ForceLaw]] = {}
    for site in sites:
        declared = list(problem.laws[site])
        laws[site] = declared + _further_laws(declared, _largest_drift(data, site))
    return problem.with_laws(laws)


def _largest_drift(data: Dataset, site: Site) -> float:
    motions = [segment.motion(site, segment.valid) for segment in data.segments]
    return max(float(np.abs(motion.s).max()) for motion in motions)


def _further_laws(declared: list[ForceLaw], drift: float) -> list[ForceLaw]:
    """Laws whose terms the declared ones lack."""
    labels = {term.label for law in declared for term in law.terms()}
    further: list[ForceLaw] = [
        CoulombFriction(),
        QuadraticDamping(),
        QuadraticStiffness(),
        AbsoluteQuadraticStiffness(),
        CubicStiffness(),
    ]
    lacking = [law for law in further if labels.isdisjoint(_labels(law))]
    sliders = [Jenkins(uy=float(share) * drift) for share in YIELD_SHARES]
    return [*lacking, *sliders]


def _labels(law: ForceLaw) -> set[str]:
    return {term.label for term in law.terms()}
