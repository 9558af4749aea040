"""The verdict on a model: may it be used, what was found, and, where a balance does not
close, which channels do.
"""

import itertools
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..equations.errors import balance_errors, free_run_by_either, squares_of
from ..exceptions import NRFError, NRFWarning
from ..records.checks.alignment import channel_alignment
from ..records.dataset import Dataset, Segment
from ..records.record import MATRICES, Record
from .planning import creates_energy

__all__ = ["Verdict"]

# percent of a balance unexplained, above which nothing may be concluded from it
OPEN = 50.0
DOUBTFUL = 25.0  # and above which other mappings of the channels are tried
# and above which its estimates deserve a word: as much as 5 % noise left of linear
# chains (14.7 at most)
LARGE = 15.0
ASTRAY = 20.0  # percent of the measured motion by which a free run may miss it
# ratios of two channels of one motion that no calibration has, and only a unit (the
# nearest are cm and in) or column
OFF, OTHER_UNIT = 1.2, 2.0
# fall of an error that tells mappings apart: of two equally wrong, one leaves a third
# of the other once in a thousand where a record holds ten independent cycles (0.999
# quantile of the variance ratio F(10, 10): 8.8)
FALL = 3.0
NOTICED = 0.02  # share of the force of a site from which on a nonlinear term is named
CARRIES = 0.25  # and from which on a negative stiffness is no error of a weak spring
_TRIED = 6  # mappings of the channels that are fitted to fused motions
# samples of all records that are enough to tell which channels close a balance
_ROWS = 10_000
_EXCHANGES = (
    6  # DOFs up to which every pair of channels is exchanged; beyond, neighbours only
)

Bounds = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Verdict:
    """Whether a model may be used, in one sentence, and why.

    Attributes
    ----------
    state : {"green", "amber", "red"}
        Green: the balances close and the free run follows the motion. Amber: usable
        with the care that the reasons name. Red: not to be used.
    sentence : str
    reasons : tuple of str
        What makes it amber or red, the gravest first.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.verdict import Verdict
    >>> print(
    ...     Verdict(
    ...         "amber", "Linear storeys.", ("The intervals are withheld.",)
    ...     )
    ... )
    AMBER: Linear storeys.
      - The intervals are withheld.
    """

    state: str
    sentence: str
    reasons: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join(
            [
                f"{self.state.upper()}: {self.sentence}",
                *(f"  - {one}" for one in self.reasons),
            ]
        )


@dataclass
class FreeRuns:
    """Free runs of a model over its records: percent NRMSE by record and DOF, the runs,
    why one is missing.
    """

    table: pd.DataFrame
    runs: list[tuple[Segment, Record]] = field(default_factory=list)
    why_not: str = ""
    failed: bool = False  # a run was tried and came to no end

    @property
    def error(self) -> float:
        """Percent NRMSE of all records and DOFs; NaN without a run."""
        return (
            float(np.sqrt(np.mean(np.square(self.table.to_numpy()))))
            if len(self.table)
            else float("nan")
        )


def free_runs(
    model: ChainModel,
    data: Dataset,
    filters: Sequence[Any] | None = None,
    names: Sequence[str] | None = None,
    dt: float | None = None,
) -> FreeRuns:
    """Run a model alone, from the first measured state, under the measured force of
    every record.
    """
    out, rows = FreeRuns(pd.DataFrame()), {}
    if (model.masses <= 0).any():
        out.why_not = "a mass is not positive, as that of an element by itself"
        return out
    names = names or [seg.name for seg in data.segments]
    for seg, filter, name in zip(data.segments, filters or [None] * len(names), names):
        if np.isnan(seg.F[seg.valid]).any() or (dt is None and seg.dt is None):
            out.why_not = (
                f"a force of {name} is unknown"
                if seg.dt or dt
                else "the sampling step is not known"
            )
            continue
        try:
            run = free_run_by_either(model, seg, seg.valid, dt)
        except NRFError as error:
            out.why_not, out.failed = str(error), True
            continue
        out.runs.append((seg, run))
        missed, moved = squares_of(run, seg, seg.valid, filter)
        number, label = 2, name
        while label in rows:
            label, number = f"{name} ({number})", number + 1
        rows[label] = list(100.0 * np.sqrt(missed / moved))
    out.table = pd.DataFrame.from_dict(
        rows, orient="index", columns=[f"x{j + 1}" for j in range(model.n_dof)]
    )
    return out


def rearranged(
    record: Record, worst: Iterable[int] = ()
) -> Iterator[tuple[str, Callable[[Record], Record]]]:
    """Errors of wiring that a record may hold: in words, and as a function that
    corrects a record.
    """
    n, unknown = record.n_dof, set(record.unknown)
    measured = {
        key: _columns(record, key)
        for key in ("acceleration", "velocity", "displacement")
    }
    for j, k in itertools.product(record.forced, range(1, n + 1)):
        if k not in unknown and (k not in record.forced or j <= k):
            words = (
                f"F{j} and F{k} exchanged"
                if k in record.forced
                else f"the force F{j} acting on floor {k}"
            )
            yield f"F{j} reversed" if j == k else words, _changed(("force",), j, k, n)
    if len(record.forced) > 1:
        yield "all forces reversed", lambda one: one.replace(force=-one.force)
    for j, k in itertools.combinations_with_replacement(range(1, n + 1), 2):
        if n > _EXCHANGES and k > j + 1 and not {j, k} <= set(worst):
            continue
        both = [key for key, held in measured.items() if {j, k} <= set(held)]
        for keys in [(key,) for key in both] + ([tuple(both)] if len(both) > 1 else []):
            words = " and ".join(
                f"{MATRICES[key]}{j}" + f" with {MATRICES[key]}{k}" * (j != k)
                for key in keys
            )
            yield (
                f"{words} {'reversed' if j == k else 'exchanged'}",
                _changed(keys, j, k, n),
            )
    if record.base_moves:
        other = {"relative": "absolute", "absolute": "relative"}[record.coordinates]
        if measured["displacement"] or measured["velocity"]:
            words = "relative to the base" if other == "relative" else "absolute"
            yield (
                f"velocities and displacements taken as {words}",
                lambda one: one.replace(coordinates=other),
            )
        if record.base_acceleration is not None:
            yield (
                "ag reversed",
                lambda one: one.replace(
                    base_acceleration=-np.asarray(one.base_acceleration)
                ),
            )


def _columns(record: Record, key: str) -> list[int]:
    """DOFs at which a kind of channel was measured."""
    held = getattr(record, key)
    return (
        []
        if held is None
        else [j + 1 for j in range(held.shape[1]) if not np.isnan(held[:, j]).all()]
    )


def _changed(
    keys: tuple[str, ...], j: int, k: int, n: int
) -> Callable[[Record], Record]:
    """A function that exchanges channels of two DOFs, or reverses those of one."""
    order, signs = np.arange(n), np.ones(n)
    order[[j - 1, k - 1]] = k - 1, j - 1
    signs[j - 1] = -1.0 if j == k else 1.0
    return lambda one: one.replace(
        **{key: getattr(one, key)[:, order] * signs for key in keys}
    )


def mapping_that_closes(
    records: Sequence[Record],
    solve: Callable[[list[Record]], Any],
    quick: Callable[[list[Record]], Any],
    known: Collection[int] = (),
) -> str:
    """The error of wiring without which balances close that did not, in words; empty if
    there is none.

    ``solve`` turns records into an estimate of a model, with its Gram matrices. So does
    ``quick``, coarsely: by it and half of the samples mappings are put in order, and
    only the best are solved. Masses of ``known`` DOFs are free.
    """
    records = [
        rec if rec.n_samples <= _ROWS else rec.rows(_loudest(rec)) for rec in records
    ]
    records.sort(key=lambda rec: -_size(rec).max())
    records = records[
        : 1 + np.searchsorted(np.cumsum([rec.n_samples for rec in records]), _ROWS)
    ]

    def left(
        change: Callable[[Record], Record] | None = None, solve: Any = solve
    ) -> tuple[bool, float, np.ndarray]:
        """Whether no structure has the masses, the size of the errors, and the error of
        each balance.
        """
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            try:
                some = [
                    (
                        rec.rows(slice(0, (rec.n_samples + 1) // 2))
                        if solve is quick
                        else rec
                    )
                    for rec in records
                ]
                found = solve([rec if change is None else change(rec) for rec in some])
            except NRFError:
                return True, np.inf, np.full(records[0].n_dof, np.inf)
        table = balance_errors(found.model, found.grams)
        errors = np.maximum(table["error"].drop("pooled").to_numpy(dtype=float), 1e-9)
        unreal = any(
            m <= 0 for j, m in enumerate(found.model.masses, 1) if j not in known
        )
        return unreal, float(np.log(errors).sum()), errors

    unreal, most, given = left()
    if not unreal and given.max() <= LARGE and not suspect_channels(records):
        return ""
    rows, tried = [], list(rearranged(records[0], np.flatnonzero(given > OPEN) + 1))
    roughly = left(solve=quick)[:2]
    if np.isfinite(roughly[1]):  # else motions are missing that only fusion fills in
        rated = sorted(
            ((left(one[1], quick)[:2], one) for one in tried), key=lambda pair: pair[0]
        )
        tried = [one for size, one in rated[:_TRIED] if size < roughly]
    for words, change in tried:
        wrong, size, error = left(change)
        closes = error <= np.minimum(OPEN, np.inf if unreal else given / FALL)
        if not wrong and (closes.all() or closes.any() and size < most - np.log(FALL)):
            rows.append((size, words, error, closes))
    if not rows:
        return ""
    _, words, error, closes = min(rows, key=lambda row: row[0])
    equal = [w for _, w, e, _ in rows if w != words and (e <= 1.1 * error).all()]
    said = " or ".join([words, *equal[:2]])
    shut = ", ".join(str(j) for j in np.flatnonzero(closes) + 1)
    which = (
        "every balance closes"
        if error.max() <= OPEN
        else f"the balance of DOF {shut} closes"
    )
    return (
        f"With {said} {which} ({error[closes].max():.2g} % left at most): check the"
        " mapping of the channels."
    )


def suspect_channels(records: Iterable[Record]) -> dict[str, bool]:
    """What says that a channel is reversed, in another unit or another column, by one
    of its DOF; is it sure?
    """
    out: dict[str, bool] = {}
    for record in records:
        with suppress(NRFError):  # no DOF has two kinds of channels
            table = channel_alignment(record)
            for _, row in table[~table["aligned"].astype(bool)].iterrows():
                if row["sign"] < 0:
                    out[f"{row['message']}: one of them is reversed."] = True
                elif abs(np.log(row["gain"])) > np.log(OTHER_UNIT):
                    out[
                        f"{row['message']}: one of them is in another unit or another"
                        " column."
                    ] = True
                elif not abs(np.log(row["gain"])) < np.log(
                    OFF
                ):  # another motion, or none that it resembles
                    out[f"{row['message']}."] = False
    return out


def _size(record: Record) -> np.ndarray:
    """Size of the force from sample to sample, or of the motion where no force was
    measured.
    """
    lines = (
        record.force
        if record.forced
        else next(iter(record.channels().values()))[:, None]
    )
    return np.abs(np.nan_to_num(lines)).max(axis=1)


def _loudest(record: Record) -> slice:
    """Rows about the largest force, or motion where no force was measured."""
    start = int(
        np.clip(int(np.argmax(_size(record))) - _ROWS // 4, 0, record.n_samples - _ROWS)
    )
    return slice(start, start + _ROWS)


def verdict_on(
    model: ChainModel,
    balances: Mapping[int, float],
    found: Sequence[str],
    free: FreeRuns | None = None,
    bounds: Bounds | None = None,
    *,
    known_masses: Iterable[int] = (),
    doubts: Sequence[str] = (),
    faults: Mapping[str, bool] | None = None,
    stopped: str = "",
    follows: float = float("nan"),
    wiring: Callable[[], str] | None = None,
) -> Verdict:
    """Verdict on a model.

    ``balances``: percent NRMSE by DOF. ``found``: what it holds beside linear storeys,
    in words. ``bounds``: intervals by parameter (``"m1"``, ``"storey 2: s"``).
    ``doubts``: what else is doubtful. ``faults``: channels that seem reversed or in the
    wrong column, and whether that is sure. ``stopped``: why nothing may be claimed.
    ``follows``: error of free runs over some periods. ``wiring`` gives the error of
    wiring without which the balances close; it is asked where one does not close well.
    """
    bounds, known = dict(bounds or {}), set(known_masses)
    error = float("nan") if free is None else free.error
    left = {
        j: f"The balance of DOF {j} leaves {e:.3g} % of its force unexplained."
        for j, e in balances.items()
    }
    red = [left[j] for j, e in balances.items() if e > OPEN]
    wrong = [
        f"m{j} = {m:.4g} kg"
        for j, m in enumerate(model.masses, 1)
        if m <= 0 and j not in known
    ]
    red += (
        [f"{', '.join(wrong)}: no structure has a mass that is not positive."]
        if wrong
        else []
    )
    soft = [str(site) for site in _negative_stiffness(model, bounds)]
    red += [f"The stiffness of {', '.join(soft)} came out negative."] if soft else []
    if wide := [
        name
        for name, (low, high) in bounds.items()
        if name[:1] == "m" and low <= 0 < high
    ]:
        red.append(
            f"The data do not determine {', '.join(wide)}: the interval holds zero."
        )
    if free is not None and not wrong:
        diverged = [
            name
            for name, row in free.table.iterrows()
            if not np.isfinite(row.to_numpy()).all()
        ]
        if diverged or free.failed:
            red.append(free.why_not or "The free run diverges.")
        elif error > 100.0 and not _floats(model, free) and not follows < ASTRAY:
            red.append(
                "The free run diverges"
                + (f": it misses the motion by {error:.3g} %." if error < 1e3 else ".")
            )
    red += [stopped] if stopped and not red else []
    red += [text for text, sure in (faults or {}).items() if sure]
    doubts = [
        one
        for one in doubts
        if not any(one.rstrip(".") in fault for fault in faults or ())
    ]
    poor = {j: e for j, e in balances.items() if e > LARGE}
    asked = red or faults or max(poor.values(), default=0.0) > DOUBTFUL
    cause = wiring() if wiring is not None and asked else ""
    if red or cause:
        red = list(dict.fromkeys([*(red or [left[j] for j in poor]), *(faults or ())]))
        more = red if cause else [*red, *doubts]
        named = cause or next(
            (text for text, sure in (faults or {}).items() if sure), red[0]
        )
        return Verdict(
            "red",
            f"Do not use this model. {named}",
            tuple(x for x in dict.fromkeys(more) if x != named),
        )
    doubts = [*(faults or ()), *doubts]
    amber = [
        f"{e:.3g} % of the force in the balance of DOF {j} is unexplained: a law is"
        " missing, or the channels are noisy."
        for j, e in poor.items()
    ]
    alone = "Linear storeys" + ", nothing else was found" * (not amber and not doubts)
    what = "; ".join([*found, "linear otherwise"]) if found else alone
    shown = follows if error > ASTRAY and follows < error else error
    damping = (
        pd.Series([0.0])
        if (model.total_masses <= 0).any()
        else model.modes()["damping"]
    )
    if damping.min() < 0 and not shown < ASTRAY:
        amber.append(creates_energy(damping.idxmin(), damping.min()))
    if np.isfinite(shown):
        what += (
            f"; the free run predicts the motion to {shown:.2g}"
            f" %{' over ten periods' if shown < error else ''}"
        )
        if shown > ASTRAY:
            amber.append(
                f"The free run misses the measured motion by {shown:.3g} %. A model can"
                " be right and still drift (a stage without a spring, a yielding"
                " storey, a record that starts in motion); see its figure."
            )
    reasons = [*amber, *doubts]
    return Verdict(
        "amber" if reasons else "green",
        f"{what[:1].upper()}{what[1:]}.",
        tuple(dict.fromkeys(reasons)),
    )


def _negative_stiffness(model: ChainModel, bounds: Bounds) -> list[Any]:
    """Storeys without memory whose stiffness is negative beyond its interval and
    carries a part of their force.
    """
    out = []
    for site, force in model.restoring_forces.items():
        region, (c, k) = model.visited.get(site), force.linear_part()
        if not site.is_storey or k >= 0 or force.has_memory or region is None:
            continue
        if bounds.get(f"{site}: s", (k, k))[1] >= 0 or not all(
            set(t.label) <= {"s", "v", " ", "^", *"123456789"}
            for law in force.laws
            for t in law.terms()
        ):
            continue
        rate, drift = (max(abs(region.low[i]), abs(region.high[i])) for i in (0, 1))
        outwards = (
            force(np.zeros(2), np.array([-drift, drift])) @ np.array([-1.0, 1.0]) < 0
        )
        if outwards and -k * drift > CARRIES * (-k * drift + abs(c) * rate):
            out.append(site)
    return out


def _floats(model: ChainModel, free: FreeRuns) -> bool:
    """Whether the chain has hardly a spring to the ground: its slowest mode takes
    longer than a third of a record.
    """
    slowest = float(model.modes()["frequency"].min())
    return (
        not free.runs
        or slowest * max(seg.n_valid * (seg.dt or 1.0) for seg, _ in free.runs) < 3.0
    )


def shares_of(model: ChainModel, data: Dataset) -> dict[str, pd.Series]:
    """Rms of each term's force, percent of the rms of the site's force, by site and
    largest first.
    """
    out = {}
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        terms, whole = np.zeros(len(force.coefficients)), 0.0
        for seg in data.segments:
            motion = seg.motion(site, seg.valid)
            columns = np.hstack(
                [law.features(motion) * law.coefficients for law in force.laws]
            )
            terms += (columns**2).sum(axis=0)
            whole += (columns.sum(axis=1) ** 2).sum()
        if whole:
            shares = pd.Series(
                100 * np.sqrt(terms / whole), index=force.coefficients.index
            )
            out[str(site)] = shares.sort_values(ascending=False)
    return out


def nonlinear_parts(
    model: ChainModel, shares: Mapping[str, pd.Series], bounds: Bounds | None = None
) -> dict[str, str]:
    """What the laws of a model add to linear storeys, in words by site, where it
    carries a part of the force.
    """
    out: dict[str, list[str]] = {}
    for site, law in (
        (str(site), law) for site, held in model.laws.items() for law in held
    ):
        terms = [t for t in law.terms() if t.label not in ("v", "s")]
        own = shares.get(site, pd.Series(dtype=float))
        seen = [t.label for t in terms if own.get(t.label, 0.0) > 100 * NOTICED]
        if law.name == "power_series" and seen:
            drift, rate = (
                any("s" in label for label in seen),
                any("v" in label for label in seen),
            )
            kind = (
                "a nonlinear force"
                if drift and rate
                else "nonlinear stiffness"
                if drift
                else "nonlinear damping"
            )
            text = (
                f"{kind} in {site} ({seen[0]} carries {own[seen[0]]:.2g} % of its"
                " force)"
            )
            out.setdefault(site, []).append(text)
        elif terms and law.name != "power_series" and (seen or not len(own)):
            ends = {
                t.symbol: (bounds or {}).get(f"{site}: {t.label}") for t in law.terms()
            }
            values = dict(
                zip(
                    (t.symbol for t in law.terms()),
                    np.asarray(law.coefficients, dtype=float),
                )
            )
            values = {
                t.symbol: values[t.symbol] for t in terms
            }  # what is linear is no effect
            units = {t.symbol: t.unit for t in terms}
            out.setdefault(site, []).append(
                effect_words(law.name, site, values, ends, units)
            )
    return {site: ", ".join(texts) for site, texts in out.items()}


def effect_words(
    law: str,
    site: str,
    values: Mapping[str, Any],
    ends: Mapping[str, Any],
    units: Mapping[str, str],
) -> str:
    """An effect with its leading parameter and interval: ``"dry friction of 173 N (169
    to 189 N) in storey 2"``.
    """
    name, unit = (
        law.replace("_", " "),
        {k: u.replace("^2", "²").replace("^3", "³") for k, u in units.items()},
    )
    name = "dry friction" if law == "coulomb_friction" else name.removeprefix("ground ")
    kind, _, where = site.partition(" ")
    place = {
        "ground": f"between floor {where} and the ground",
        "dof": f"on floor {where}",
    }.get(kind, f"in {site}")
    for key, x in values.items():
        if x is not None and key in unit:
            low, high = ends.get(key) or (np.nan, np.nan)
            span = (
                f" ({digits(low, high)} {unit[key]})" if np.isfinite(high - low) else ""
            )
            return f"{name} of {digits(low, high, float(x))} {unit[key]}{span} {place}"
    return f"{name} {place}"


def digits(low: float, high: float, *more: float) -> str:
    """Two ends of an interval with the digits that tell them apart; or other numbers
    with the same digits.
    """
    need, most = 3, max(abs(low), abs(high))
    if high > low:
        need = int(
            np.clip(
                np.floor(np.log10(most)) - np.floor(np.log10((high - low) / 2)) + 1,
                3,
                7,
            )
        )
    return " to ".join(f"{x:.{need}g}" for x in more or (low, high))
