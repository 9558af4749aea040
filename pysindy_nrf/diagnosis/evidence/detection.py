"""Is the residual noise: what the motion explains beyond what it explains of noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...chain.sites import Site
from ...chain.structure import Chain
from ...equations.normal_equations import Regression
from ...exceptions import NRFError
from ...records.dataset import Segment
from ..residual import Filters, Residual, filtered
from .kinds import ResidualKind
from .motion_columns import own_columns, thinning
from .noise_floor import NoiseFloor
from .settings import RESIDUAL

_COLUMNS = ["verdict", "percent", "floor ratio", "linear share", "nonlinear share"]
# Groups of columns that explain a residual linearly.
_LINEAR = ["motion", "inputs"]


@dataclass(frozen=True, eq=False)
class Detection:
    """What the residual of every balance and storey holds.

    ``verdicts`` has rows ``"dof j"`` and ``"storey i"``. Its columns are:

    - ``verdict``: a ``ResidualKind``.
    - ``percent``: of the reference.
    - ``floor ratio``: rms over that of the noise floor.
    - ``linear share``: of the squares that drifts, rates and inputs explain on data
      left out.
    - ``nonlinear share``: of the rest, by laws of the site's own motion.
    """

    verdicts: pd.DataFrame

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise is left in any balance."""
        return bool((self.verdicts["verdict"] == ResidualKind.NOISE).all())


def detect(residual: Residual, floor: NoiseFloor | None = None) -> Detection:
    """Find what every balance and storey holds apart from noise.

    Parameters
    ----------
    residual : Residual
    floor : NoiseFloor, optional
        What noise alone would leave, if it is known.

    Returns
    -------
    Detection

    Raises
    ------
    NRFError
        If it is no residual.

    Examples
    --------
    Friction of which the model knows nothing:

    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.diagnosis import residual_of
    >>> from pysindy_nrf.diagnosis import detect
    >>> linear = [laws.LinearElastic(4e4), laws.LinearViscous(30.0)]
    >>> friction = [*linear, laws.CoulombFriction(20.0)]
    >>> truth = ChainModel([10.0, 8.0], {1: linear, 2: friction})
    >>> model = ChainModel([10.0, 8.0], {1: linear, 2: linear})
    >>> F = excitation.band_limited_random(
    ...     2, 10.0, 500.0, excited=2, rms=60.0, band=(1, 40), random_state=0
    ... )
    >>> residual = residual_of(model, simulate(truth, F, 1 / 500))
    >>> detect(residual).verdicts.loc["storey 2", "verdict"]
    <ResidualKind.NONLINEAR: 'nonlinear effect missing'>
    """
    if not isinstance(residual, Residual):
        raise NRFError(
            f"{type(residual).__name__} is not a residual",
            "Make one with residual_of(model, data).",
        )

    regressions = _Regressions(residual, floor)
    rows: dict[str, dict[str, object]] = {}
    for place, size in residual.sizes.iterrows():
        if not np.isfinite(size["rms"]):
            continue
        ratio = np.nan
        if floor is not None and floor.rms_at(str(place)) > 0:
            ratio = size["rms"] / floor.rms_at(str(place))
        row: dict[str, object] = {
            "verdict": ResidualKind.NOISE,
            "percent": size["percent"],
            "floor ratio": ratio,
        }
        resolved = RESIDUAL.resolution * size["reference"]
        if size["rms"] > resolved:
            least_share = (resolved / size["rms"]) ** 2
            row |= regressions.verdict(str(place), ratio, least_share)
        rows[str(place)] = row

    table = pd.DataFrame.from_dict(rows, orient="index")
    return Detection(table.reindex(columns=_COLUMNS))


class _Regressions:
    """Regressions of a residual, and of draws of noise alone, on the motion."""

    def __init__(self, residual: Residual, floor: NoiseFloor | None) -> None:
        segments = residual.data.segments
        chain = residual.model.chain
        every = []
        for i in range(residual.n_dof):
            every.append(thinning([seg.s[seg.valid, i] for seg in segments]))
        thin = min(every)

        self.residual = MotionRegression(residual, chain, thin)
        self.noise: list[MotionRegression] = []
        if floor is not None:
            # the model of the draws may be one of fewer sites
            made = [MotionRegression(draw, chain, thin) for draw in floor.draws]
            self.noise = floor.motions.setdefault((chain.sites, thin), made)

    def verdict(
        self, place: str, ratio: float, least_share: float
    ) -> dict[str, object]:
        """What one balance or storey holds.

        ``least_share`` of its power is round-off: a linear effect that leaves less is
        all there is.
        """
        laws = self.residual.law_groups(place)
        linear, is_linear = self._share(place, _LINEAR, [])
        nonlinear, is_nonlinear = self._share(place, laws, _LINEAR)

        # its size alone speaks for noise, and residual and floor may both be off
        at_floor = RESIDUAL.at_floor
        kind = ResidualKind.UNMEASURED
        if ratio < at_floor**2:
            kind = ResidualKind.NOISE
        # below the floor it is the bias of the fit
        if is_linear and not ratio < at_floor:
            kind = ResidualKind.LINEAR
        remains = 1.0 - linear > least_share
        if is_nonlinear and remains and not ratio < 1 / at_floor:
            kind = ResidualKind.NONLINEAR
        return {"verdict": kind, "linear share": linear, "nonlinear share": nonlinear}

    def _share(
        self, place: str, groups: list[str], beside: list[str]
    ) -> tuple[float, bool]:
        """Share that groups of columns explain beside others, and whether it is sure.

        Squares that the motion explains of noise alone are taken off.
        """
        fit = self.residual.fit(place)
        share, error = fit.share(place, groups, beside)
        explained = []
        for noise in self.noise:
            regression = noise.fit(place)
            before = regression.unexplained(place, beside)
            after = regression.unexplained(place, [*beside, *groups])
            explained.append(float((before - after).sum()))

        of_noise = 0.0
        if explained:
            remaining = max(fit.unexplained(place, beside).sum(), 1e-300)
            of_noise = max(float(np.mean(explained)), 0.0) / remaining
        least = max(RESIDUAL.alike, RESIDUAL.sure_errors * error)
        return max(share, 0.0), share - of_noise > least


class MotionRegression:
    """Regression of a residual on drifts, rates, inputs and laws of the own motion."""

    def __init__(self, residual: Residual, chain: Chain, every: int) -> None:
        self.residual = residual
        self.chain = chain
        self.every = every
        self._columns = residual.columns.setdefault((chain.sites, every), {})
        self._fits: dict[tuple[int, ...], Regression] = {}

    def law_groups(self, place: str) -> list[str]:
        """Columns of the laws that enter one balance or storey."""
        site = Site(place)
        entering = [site]
        if site.kind == "dof":
            entering = [s for s in self.chain.sites if s.incidence(site.p)]
        return [f"law {s}" for s in entering]

    def fit(self, place: str) -> Regression:
        """The regression on all records in which a residual is known."""
        known = []
        for i, residual in enumerate(self.residual.at_place(place)):
            if np.isfinite(residual).all():
                known.append(i)

        records = tuple(known)
        if records not in self._fits:
            if records not in self._columns:
                self._columns[records] = self._groups(records)
            groups = self._columns[records] | self._targets(records)
            self._fits[records] = Regression.of(groups)
        return self._fits[records]

    def _targets(self, records: Sequence[int]) -> dict[str, list[np.ndarray]]:
        """Residuals of all balances and storeys that are known in some records."""
        targets = {}
        for name in self.residual.sizes.index:
            residual = self.residual.at_place(name)
            parts = [residual[i][:: self.every] for i in records]
            if all(np.isfinite(line).all() for line in parts):
                targets[name] = parts
        return targets

    def _groups(self, records: Sequence[int]) -> dict[str, list[np.ndarray]]:
        """Columns of the motion, by group, along some records."""
        segments = [self.residual.data.segments[i] for i in records]
        filters = [self.residual.filters[i] for i in records]

        motion = [np.hstack([seg.s[seg.valid], seg.v[seg.valid]]) for seg in segments]
        groups = {
            "motion": self._filtered(motion, filters),
            "inputs": self._filtered(self._inputs(segments), filters),
        }
        storeys = [Site(i) for i in range(1, self.residual.n_dof + 1)]
        for site in dict.fromkeys([*self.chain.sites, *storeys]):
            motions = [seg.motion(site, seg.valid) for seg in segments]
            groups[f"law {site}"] = own_columns(motions, filters, self.every)
        return groups

    def _filtered(
        self, parts: Iterable[np.ndarray], filters: Filters
    ) -> list[np.ndarray]:
        """Columns as the residual sees them, thinned."""
        out = []
        for columns, filter_ in zip(parts, filters):
            columns = np.asarray(columns, dtype=float)
            out.append(filtered(columns, filter_)[:: self.every])
        return out

    def _inputs(self, segments: Sequence[Segment]) -> list[np.ndarray]:
        """Accelerations of forced DOFs, covariates and base motion, and their slopes.

        Of a measured force the slope alone, which stands for a delay: no balance closes
        by the others.
        """
        forced = [j - 1 for j in self.residual.data.forced]
        names = _shared_covariates(segments)
        bases = [seg.ag for seg in segments if seg.ag is not None]
        shaken = len(bases) == len(segments)

        inputs = []
        for number, seg in enumerate(segments):
            lines = [seg.a[:, forced]]
            lines += [seg.covariates[name] for name in names]
            if shaken:
                lines.append(bases[number])
            forces = np.nan_to_num(seg.F[:, forced])
            moving = np.column_stack([*lines, forces])[seg.valid].astype(float)
            slopes = np.gradient(moving[:, len(forced) :], axis=0)
            values = moving[:, : moving.shape[1] - len(forced)]
            inputs.append(np.hstack([values, slopes]))
        return inputs


def _shared_covariates(segments: Sequence[Segment]) -> list[str]:
    """Covariates that all records have, those of the base's motion aside."""
    names = []
    for name in segments[0].covariates:
        shared = all(name in seg.covariates for seg in segments)
        if shared and name not in ("ag", "vg"):
            names.append(name)
    return names
