"""What the paper prints: polynomials (11)-(23) and masses, as data with units.

Every polynomial is stored in the order in which the paper prints its terms,
``PRINTED_ORDER``; ``law`` turns it into a ``PowerSeries``, whose own order is that of
eq. (9). Coefficients of v^h s^j are in N s^h / m^(h+j), masses in kg.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import ChainModel
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.laws import PowerSeries

PRINTED_ORDER = ("s", "v", "s^2", "v s", "v^2", "s^3", "v s^2", "v^2 s", "v^3")
TOTAL_MASS = 51.41  # kg, of the four-storey frame as weighed
NOISE_SENTENCE = (
    "the standard deviation of the random noise is equal to 5% of the corresponding"
    " mean value"
)
_EXPONENTS = ((0, 1), (1, 0), (0, 2), (1, 1), (2, 0), (0, 3), (1, 2), (2, 1), (3, 0))


@dataclass(frozen=True)
class Result:
    """One identification of the paper.

    Attributes
    ----------
    equations, title : str
    storeys : dict
        Coefficients by storey, in the order of PRINTED_ORDER (the first two if linear).
    masses : dict
        kg, by DOF; empty where the paper prints none.
    twins : dict
        Coefficients from the balance below a storey (eq. 10b).
    figures : dict
        Contents by the number of the figure.
    """

    equations: str
    title: str
    storeys: dict[int, tuple[float, ...]]
    masses: dict[int, float] = field(default_factory=dict)
    twins: dict[int, tuple[float, ...]] = field(default_factory=dict)
    figures: dict[str, str] = field(default_factory=dict)

    def law(self, storey: int) -> PowerSeries:
        """Power series of a storey."""
        return law(self.storeys[storey])

    def table(self) -> pd.DataFrame:
        """Coefficients: a row for each term as printed, a column for each storey.

        The last column has the units.
        """
        n_terms = len(next(iter(self.storeys.values())))
        terms = pd.Index(PRINTED_ORDER[:n_terms], name="term")
        table = pd.DataFrame(index=terms)
        for storey in sorted(self.storeys):
            table[f"storey {storey}"] = self.storeys[storey]
        units = {term.label: term.unit for term in PowerSeries(3).terms()}
        return table.assign(unit=terms.map(units))

    def model(self) -> ChainModel:
        """The result as a model; ChainError if the paper does not print its masses."""
        if self.masses.keys() != self.storeys.keys():
            raise ChainError(
                f"The paper prints no masses with eqs. {self.equations}",
                "Use .law(storey) for its restoring forces.",
            )
        masses = [self.masses[j] for j in sorted(self.masses)]
        return ChainModel(masses, {i: self.law(i) for i in self.storeys})


def law(printed: Any) -> PowerSeries:
    """Power series from 2 or 9 coefficients in the order of :data:`PRINTED_ORDER`."""
    by_symbol = {f"c_{h}_{j}": float(c) for (h, j), c in zip(_EXPONENTS, printed)}
    return PowerSeries(1 if len(printed) == 2 else 3, by_symbol)


def force(printed: Any, v: Any, s: Any) -> np.ndarray:
    """Force (N) of a published polynomial at rates ``v`` (m/s) and drifts ``s`` (m)."""
    v, s = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(s, dtype=float))
    return sum(c * v**h * s**j for (h, j), c in zip(_EXPONENTS, printed))


TWO_DOF_COMPLETE = Result(
    "(10), (11)",
    "2 DOF, both forced, noise-free",
    {
        2: (1.00e5, 100.01, -0.05, -6.62e-4, -1.99e-6, 31.03, 0.08, 0.01, -2.65e-6),
        1: (1.01e5, 666.24, -6.77e4, -552.97, -7.25, 1.97e6, 5.16e5, -2.83e3, -332.71),
    },
    {1: 10.01, 2: 10.00},
    {2: (1.01e5, 96.32, 1.15e4, -610.32, -5.26, 2.73e6, -1.89e3, -2.26e3, 6.91)},
    {"2": "forces and responses", "3": "surfaces", "4": "damper force"},
)
TWO_DOF_COMPLETE_NOISY = Result(
    "(12)",
    "2 DOF, both forced, 5 % noise",
    {
        2: (9.96e4, 95.24, -6.23e4, 276.54, -2.90, -2.75e6, -1.45e4, 140.75, 7.89),
        1: (9.87e4, 564.95, -2.12e4, -1.15e3, -1.63, -1.08e6, -1.89e5, 423.82, -35.75),
    },
    figures={"5": "damper force"},
)
TWO_DOF_INCOMPLETE = Result(
    "(13), (14), (16)",
    "2 DOF, DOF 2 forced, noise-free",
    {
        2: (1.00e5, 100.01, -0.07, 0.01, -7.86e-6, 56.68, 0.42, -0.01, -2.34e-5),
        1: (0.98e5, 749.74, 1.60e5, 5.02e3, -68.26, 1.71e7, 1.27e5, 9.52e3, -1.04e3),
    },
    {1: 9.85, 2: 10.00},
    figures={"6": "surfaces", "7": "damper force"},
)
TWO_DOF_INCOMPLETE_NOISY = Result(
    "(17)",
    "2 DOF, DOF 2 forced, 5 % noise",
    {
        2: (1.02e5, 97.73, 1.79e5, 103.36, -27.49, -7.38e7, 9.12e5, 2.74e3, 11.47),
        1: (9.92e4, 652.72, 2.46e4, 1.71e3, 3.70, -1.13e7, -3.91e5, -8.43e3, -340.31),
    },
    figures={"8": "damper force"},
)
FRAME_COMPLETE = Result(
    "(18)",
    "four-storey frame with dampers, all floors hit",
    {
        4: (1.49e5, 354.75, -6.88e5, 2.18e4, -72.42, 4.11e9, -3.89e7, 1.13e5, -2.65e3),
        3: (1.34e5, 22.02, -1.25e6, 4.64e4, -187.77, 2.69e9, -2.45e6, 2.09e5, -132.48),
        2: (1.39e5, 16.11, -4.12e5, -2.20e4, -50.73, -4.96e8, 2.70e6, 1.06e5, 193.31),
        1: (1.35e5, 30.35, 5.47e5, -6.55e4, -101.36, -4.17e8, 1.73e6, -3.84e5, 1.05e5),
    },
    {1: 12.53, 2: 12.41, 3: 12.47, 4: 12.16},
    figures={
        "10": "forces and responses",
        "11": "surfaces",
        "12": "damper force",
        "13": "dissipated energy",
    },
)
LINEAR_COMPLETE = Result(
    "(20)",
    "four-storey frame without dampers, all floors hit",
    {4: (1.37e5, 19.25), 3: (1.45e5, 26.63), 2: (1.48e5, 14.77), 1: (1.31e5, 24.09)},
    {1: 12.33, 2: 12.28, 3: 12.24, 4: 12.09},
)
FRAME_INCOMPLETE = Result(
    "(22)",
    "four-storey frame with dampers, floor 3 hit",
    {
        4: (1.37e5, 320.16, -9.68e5, 9.03e4, 248.69, 3.27e9, -2.61e7, -4.43e5, 1.56e3),
        3: (1.41e5, 20.58, -9.11e5, 1.93e4, 480.82, 5.17e9, 2.68e6, -4.82e5, -515.44),
        2: (1.31e5, 16.29, 1.96e6, -1.52e4, 124.84, -2.38e9, 2.31e7, -9.76e4, 266.51),
        1: (1.32e5, 52.50, 1.78e6, -8.47e4, -128.72, -2.19e8, 2.19e7, -4.28e5, 210.84),
    },
    {1: 12.97, 2: 13.00, 3: 12.41, 4: 12.84},
    figures={"14": "surfaces", "15": "damper force", "16": "dissipated energy"},
)
LINEAR_INCOMPLETE = Result(
    "(23)",
    "four-storey frame without dampers, floor 2 hit",
    {4: (1.37e5, 23.36), 3: (1.46e5, 27.32), 2: (1.49e5, 13.06), 1: (1.26e5, 12.25)},
    {1: 12.35, 2: 12.11, 3: 12.56, 4: 12.66},
)

RESULTS = (
    TWO_DOF_COMPLETE,
    TWO_DOF_COMPLETE_NOISY,
    TWO_DOF_INCOMPLETE,
    TWO_DOF_INCOMPLETE_NOISY,
    FRAME_COMPLETE,
    LINEAR_COMPLETE,
    FRAME_INCOMPLETE,
    LINEAR_INCOMPLETE,
)
