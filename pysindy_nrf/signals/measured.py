"""Summary of a measured record for pages: channels, units, clock, noise."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from ..data.record import Record


@dataclass
class Measured:
    """One record in words and numbers."""

    name: str
    n_dof: int
    n_samples: int
    fs: float
    channels: pd.DataFrame
    forced: tuple[int, ...] = ()
    unknown: tuple[int, ...] = ()
    base_moves: bool = False
    role: str = ""

    @property
    def facts(self) -> str:
        """Size, clock, forces and base of the record in one line."""
        text = f"{self.n_dof} DOF{'s' if self.n_dof > 1 else ''}, {self.n_samples} samples at {self.fs:g} Hz, "
        text += f"{self.n_samples / self.fs:.4g} s"
        text += f"; forced: DOF {', '.join(map(str, self.forced))}" if self.forced else "; no force measured"
        if self.unknown:
            text += f"; force unknown on DOF {', '.join(map(str, self.unknown))}"
        text += "; the base moves" if self.base_moves else "; the base is at rest"
        return text + (f"; {self.role}" if self.role else "")

    @property
    def sentence(self) -> str:
        """The record in one line, its name first."""
        return f"{self.name}: {self.facts}"


def measured(record: Record, noise: Mapping[str, float] | None = None, role: str = "") -> Measured:
    """Summary of a record; ``noise`` is the estimated rms by channel, SI."""
    from ..data.io.summary import kind_of, summary

    levels = dict(noise or {})
    rows = [
        (name, kind_of(record, name), size["unit"], size["rms"], size["peak"], levels.get(name, float("nan")))
        for name, size in summary(record)["channels"].items()
    ]
    channels = pd.DataFrame(rows, columns=["channel", "what", "unit", "rms", "peak", "noise"])
    size = (record.n_dof, record.n_samples, record.fs)
    return Measured(record.name, *size, channels, record.forced, record.unknown, record.base_moves, role)


def as_measured(records: Record | Sequence[Record] | None) -> list[Measured]:
    """Summaries of records, with the noise levels estimated by the fusion."""
    from ..exceptions import NRFError, NRFWarning
    from . import KinematicSmoother
    from .kinematics import to_features

    out = []
    for record in [] if records is None else [records] if isinstance(records, Record) else records:
        smoother = KinematicSmoother()
        try:
            with warnings.catch_warnings():  # the fit has warned of faulty channels
                warnings.simplefilter("ignore", NRFWarning)
                to_features(record, smoother)
            noise = {str(k): float(v) for k, v in smoother.noise_.items()}
        except NRFError:  # the page shows the record, whatever fusion makes of it
            noise = {}
        out.append(measured(record, noise))
    return out
