"""The bundled demonstration record, and the frame it was simulated with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..records.files import inspect_record
from ..records.files.reading import Reading
from ..records.record import Record

if TYPE_CHECKING:
    from ..chain.model import ChainModel

__all__ = ["demo_truth", "load_demo"]

FILE = Path(__file__).with_name("demo_record.csv")


def load_demo() -> Record:
    """Three-storey frame with a shaker on floor 2; simulated, 2 % noise on every
    channel.

    Returns
    -------
    Record
        ``F2`` (N), ``a1``..``a3`` (m/s^2) and ``x1``..``x3`` (m, relative to the base),
        200 Hz, 20 s.

    Notes
    -----
    Made by ``benchmarks/make_demo_record.py`` from :func:`demo_truth`: masses 12, 10
    and 8 kg; storey 1 hardens, ``R1 = 30 v1 + 4e4 s1 + 1.5e9 s1^3``; ``R2 = 25 v2 +
    3.5e4 s2``; ``R3 = 20 v3 + 3e4 s3``.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> record = datasets.load_demo()
    >>> record
    Record('demo': 3 DOF, 4000 samples at 200 Hz (20 s), channels F1, F2, F3, a1, a2,
    a3, x1, x2, x3)
    >>> NRFRegressor(degree=3).fit(record).masses_.round(1)
    array([12., 10.,  8.])
    """
    return read_demo().record


def read_demo() -> Reading:
    """The demonstration record with how its file was understood."""
    return inspect_record(FILE, name="demo")


def demo_truth() -> ChainModel:
    """The frame that the demonstration record was simulated with.

    Returns
    -------
    ChainModel

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> print(datasets.demo_truth())
    m1 = 12 kg, m2 = 10 kg, m3 = 8 kg  (R in N, s in m, v in m/s)
    R1 = 30 v1 + 4e+04 s1 + 1.5e+09 s1^3
    R2 = 25 v2 + 3.5e+04 s2
    R3 = 20 v3 + 3e+04 s3
    """
    from ..chain.model import ChainModel
    from ..laws import Duffing, LinearElastic, LinearViscous

    return ChainModel(
        [12.0, 10.0, 8.0],
        {
            "storey 1": [LinearViscous(c=30.0), Duffing(k=40e3, k3=1.5e9)],
            "storey 2": [LinearViscous(c=25.0), LinearElastic(k=35e3)],
            "storey 3": [LinearViscous(c=20.0), LinearElastic(k=30e3)],
        },
    )
