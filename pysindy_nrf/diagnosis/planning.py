"""Diagnosis of what limits an estimate, and planning of the next test."""

import itertools
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..chain.sites import dofs_of
from ..chain.structure import Chain
from ..exceptions import BiasWarning, NRFError
from .bias import sentences_of, wrong_zeros
from .force_delays import force_delay

__all__ = ["diagnose", "plan"]

# rms drift of a storey as a share of the largest, below which its excitation is poor
WEAK = 0.05
ILL = 1e4  # scaled condition number from which on terms are hard to tell apart
# half-width of a 95 % interval, as a share, from which on a parameter is uncertain
WIDE = 0.05
LARGE_ERROR = (
    15.0  # percent of a balance unexplained, above which its estimates deserve a word
)
BIASED = 0.01  # expected relative bias of a mass from which on it is named

Finding = tuple[
    float, str, str, float, str
]  # gravity; limit, where, size and message as in the table


@dataclass
class Diagnosis:
    """The limits of an estimate, the gravest first."""

    table: pd.DataFrame  # limit, where, size and message of each finding

    def __str__(self) -> str:
        return (
            "\n".join(self.table["message"])
            if len(self.table)
            else "Nothing limits the estimate noticeably."
        )


def diagnose(model: Any) -> Diagnosis:
    """Diagnosis of what limits the estimate of a fitted regressor.

    Parameters
    ----------
    model : fitted NRFRegressor

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis.planning import diagnose
    >>> with warnings.catch_warnings(action="ignore"):
    ...     linear = NRFRegressor(degree=1).fit(
    ...         datasets.load_demo()
    ...     )  # storey 1 is cubic
    >>> "missing law" in diagnose(linear).table["limit"].tolist()
    True
    """
    checks = (
        _doubts,
        _missing,
        _jumping,
        _excitation,
        _conditioning,
        _uncertainty,
        _energy,
        _estimation,
        _delays,
        _noise,
        _unexplained,
    )
    rows = sorted(
        (row for check in checks for row in check(model)), key=lambda row: -row[0]
    )
    return Diagnosis(
        pd.DataFrame(
            [row[1:] for row in rows], columns=["limit", "where", "size", "message"]
        )
    )


def _doubts(model: Any) -> list[Finding]:
    """Findings that ``fit`` warned of: faulty channels, contradicting balances,
    implausible masses.
    """
    # a faulty channel causes many other findings; noise in the motion, if found,
    # explains a doubtful mass
    gravity = {"channels": 7.0, "records": 6.5, "forces": 6.0, "masses": 3.9}
    return [
        (gravity[key], "channel" if key == "channels" else "doubt", key, np.nan, text)
        for key, held in model.data_warnings_.items()
        for text in held
    ]


def _missing(model: Any) -> list[Finding]:
    if zeros := wrong_zeros(
        model.missing_terms_
    ):  # before they are right no law is missed
        return [
            (
                6.0,
                "wrong zero",
                "sensors",
                float(model.missing_terms_["lasting"].max()),
                text,
            )
            for text in zeros
        ]
    out = []
    for name, row in model.missing_terms_.iterrows():
        if row["biased"]:
            text = (
                f"{name[0].upper()}{name[1:]}: {row['residual']:.2g} % is unexplained,"
                f" and terms that the laws lack explain {row['gain']:.0f} % of that. A"
                " law is missing, or the motion is noisy: fuse the channels, then add"
                " the law (laws=) or search for it (close_loop)."
            )
            out.append(
                (
                    3.0 + row["missing"] / 100,
                    "missing law",
                    name,
                    float(row["missing"]),
                    text,
                )
            )
    return out


def _jumping(model: Any) -> list[Finding]:
    wrong = model.jump_bias_[model.jump_bias_["wrong"].astype(bool)]
    return [
        (
            2.7,
            "jump",
            str(name),
            float(wrong.loc[name, "lost"]),
            f"{text[0].upper()}{text[1:]}",
        )
        for name, text in zip(wrong.index, sentences_of(wrong))
    ]


def _excitation(model: Any) -> list[Finding]:
    out = []
    visited = (
        (site, region)
        for site, region in model.model_.visited.items()
        if site.is_storey
    )
    sizes = {
        site: max(abs(region.low[1]), abs(region.high[1])) for site, region in visited
    }
    top = max(sizes.values(), default=0.0)
    for site, size in sizes.items():
        if top and size < WEAK * top:
            text = (
                f"{site} moves {size:.2g} m at most, {100 * size / top:.1f} % of the"
                f" largest drift: its law is poorly determined. Hit floor {site.p}, or"
                " excite a mode that bends it."
            )
            out.append((2.0 + WEAK - size / top, "excitation", str(site), size, text))
    return out


def _conditioning(model: Any) -> list[Finding]:
    return [
        (
            1.5,
            "conditioning",
            name,
            float(value),
            (
                f"{name[0].upper()}{name[1:]}: condition number {value:.1e}; some of"
                " its terms are nearly collinear. Excite more frequencies and"
                " amplitudes, lower the degree, or give what is known (known_masses,"
                " constraints)."
            ),
        )
        for name, value in model.condition_.items()
        if value > ILL
    ]


def _uncertainty(model: Any) -> list[Finding]:
    try:
        with warnings.catch_warnings(action="error", category=BiasWarning):
            ci = model.confidence_intervals()
    except (NRFError, BiasWarning) as error:
        return [
            (1.0, "uncertainty", "data", np.nan, f"No interval can be given: {error}")
        ]
    out = []
    for row in ci[ci["estimate"] != 0].itertuples():
        share = (row.upper - row.lower) / 2 / abs(row.estimate)
        stiffness_or_mass = row.parameter.startswith("m") or row.parameter.endswith(
            ": s"
        )
        if share > WIDE and stiffness_or_mass:
            out.append(
                (
                    1.0 + min(share, 1.0) / 2,
                    "uncertainty",
                    row.parameter,
                    float(share),
                    (
                        f"{row.parameter} is known to +-{100 * share:.0f} % only (95"
                        " %). Measure longer or hit harder nearer to it."
                    ),
                )
            )
    return out


def _energy(model: Any) -> list[Finding]:
    """Modes whose damping is negative beyond its error."""
    try:
        with warnings.catch_warnings(action="ignore", category=BiasWarning):
            ci = model.confidence_intervals(of="modes").set_index("parameter")
    except (NRFError, np.linalg.LinAlgError):
        return []
    return [
        (
            3.8,
            "energy",
            name,
            float(row["estimate"]),
            creates_energy(name.split()[-1], row["estimate"]),
        )
        for name, row in ci.iterrows()
        if name.startswith("damping") and row["upper"] < 0
    ]


def creates_energy(mode: Any, damping: float) -> str:
    """The verdict on a mode that grows by itself."""
    return (
        f"This model creates energy: mode {mode} has a damping of {100 * damping:.2g} %"
        " of critical. No structure does so by itself: a sign, a unit, a delay or a"
        " mass is wrong, a law is missing, or noise outweighs the damping."
    )


def _unexplained(model: Any) -> list[Finding]:
    error = float(model.errors_.loc["pooled", "error"])
    if not error > LARGE_ERROR:
        return []
    text = (
        f"{error:.0f} % of the balances is unexplained in all. Is it noise"
        " (estimation='iv'), or is a law missing?"
    )
    return [(0.9, "unexplained", "all", error, text)]


def _estimation(model: Any) -> list[Finding]:
    facts = model.model_.info.get("estimation", {})
    if (facts.get("asked") == "iv" or facts.get("notes")) and facts.get(
        "found"
    ) == "ls":
        why = " ".join(facts.get("notes", ["see the warning of fit"]))
        text = (
            f"Instrumental variables could not be used ({why.rstrip('.')}): noise in"
            " the motion biases masses and stiffnesses low."
        )
        return [(2.5, "estimation", "all", np.nan, text)]
    return []


def _delays(model: Any) -> list[Finding]:
    try:
        table = force_delay(model)
    except NRFError:
        return []
    return [
        (2.6, "delay", name, float(row["samples"]), row["message"])
        for name, row in table.iterrows()
        if not row["aligned"]
    ]


def _noise(model: Any) -> list[Finding]:
    """The bias that noise in the motions gives a least-squares mass, balance by
    balance.
    """
    return [
        (
            4.0 + one.mass,
            "noise",
            f"m{one.dof}",
            one.mass,
            (
                f"m{one.dof} is expected to come out {100 * one.mass:.0f} % low or"
                " more, and with it all that is solved from it: noise in the motion,"
                f" most in {one.channel} ({100 * one.share:.1f} % of its rms). Give the"
                " records so that the channels are fused, with estimation='iv'."
            ),
        )
        for one in model.result_.noise_biases
        if one.mass >= BIASED
    ]


@dataclass
class Plan:
    """Ranking of floors to hit, and sensors to add."""

    table: (
        pd.DataFrame
    )  # by test: hit, identifies (share of masses and laws), depth, response, left
    advice: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return "\n".join(self.advice)


def plan(
    chain: Chain,
    *,
    can_hit: int | Iterable[int] | None = None,
    sensors: int | Iterable[int] | None = None,
    unknown: int | Iterable[int] = (),
    known_masses: int | Iterable[int] = (),
    model: Any = None,
    most: int = 2,
) -> Plan:
    """Plan of floors to hit and sensors to add so that masses and laws can be
    identified.

    Parameters
    ----------
    chain : Chain
    can_hit, sensors : int or iterable of int, optional
        Floors a hammer or shaker reaches, and whose motion is measured; all if None.
    unknown, known_masses : int or iterable of int
        DOFs on which an unmeasured force acts, and whose mass is known.
    model : ChainModel, optional
        A first guess; floors are then ranked by how well its modes respond to a blow
        there.
    most : int
        Floors hit at most (in one record, or one after another).

    Raises
    ------
    ChainError
        If a floor that is named is not in the chain.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.diagnosis.planning import plan
    >>> print(plan(Chain(3), can_hit=[1, 3], unknown=[2]).advice[0])
    Hit floor 1 and 3: out of reach remain m2.
    """
    every = tuple(range(1, chain.n_dof + 1))
    reach, seen, unknown = (
        (
            every
            if given is None
            else tuple(sorted(set(dofs_of(name, given, chain.n_dof))))
        )
        for name, given in (
            ("can_hit", can_hit),
            ("sensors", sensors),
            ("unknown", unknown),
        )
    )
    blind = sorted(set(every) - set(seen))
    total = chain.n_dof + len(chain.sites)
    rows = []
    for count in range(1, most + 1):
        for floors in itertools.combinations(
            [j for j in reach if j not in unknown], count
        ):
            order = chain.identifiability(
                floors,
                unknown=unknown,
                known_masses=known_masses,
                strategy="sequential",
            )
            left = [f"m{j}" for j in order.missing_masses] + [
                str(s) for s in order.missing_sites
            ]
            rows.append(
                (
                    floors,
                    1 - len(left) / total,
                    _depth(order),
                    _modal_response(model, floors),
                    ", ".join(left),
                )
            )
    table = pd.DataFrame(
        rows, columns=["hit", "identifies", "depth", "response", "left"]
    )
    if not len(table):
        return Plan(
            table,
            [
                "No floor can be hit with a known force; give a mass (known_masses=) to"
                " scale the chain."
            ],
        )
    by = {"identifies": False, "count": True, "response": False, "depth": True}
    table = table.assign(count=table["hit"].map(len)).sort_values(
        [*by], ascending=[*by.values()], ignore_index=True
    )
    table = table.drop(columns="count")
    best = table.iloc[0]
    where = " and ".join(map(str, best["hit"]))
    if best["identifies"] == 1:
        once = ", with a sensor on every floor" if blind else ""
        text = (
            f"Hit floor {where}{once}: every mass and law can be found; an error"
            f" travels through {best['depth']} balances at most."
        )
    else:
        text = f"Hit floor {where}: out of reach remain {best['left']}."
    if model is not None:
        text += (
            f" The weakest mode still gets {100 * best['response']:.0f} % of what the"
            " best floor would give it."
        )
    advice = [text]
    if blind:
        advice.append(
            f"Floor {', '.join(map(str, blind))} has no sensor: the free run is then"
            " fitted to the others."
        )
        if seen:
            advice.append(
                str(
                    chain.sensing(
                        seen, best["hit"], known_masses=known_masses, model=model
                    )
                )
            )
    if len(best["hit"]) < chain.n_dof and best["identifies"] == 1:
        advice.append(
            "Hitting every floor once, each in a record of its own, lets each balance"
            " be solved by itself, and the two estimates of each storey check each"
            " other."
        )
    return Plan(table, advice)


def _depth(solve_order: Any) -> int:
    """Most balances one after another through which an error travels."""
    after: dict[Any, int] = {}
    for step in solve_order.steps:
        depth = 1 + max((after.get(s, 0) for s in step.known_sites), default=0)
        after |= dict.fromkeys([*step.sites, step.name], depth)
    return max(after.values(), default=0)


def _modal_response(model: Any, floors: Iterable[int]) -> float:
    """The weakest mode's response to blows on these floors, over that to a blow on the
    best floor.
    """
    if model is None:
        return np.nan
    shapes = np.abs(model.modes().filter(like="dof ").to_numpy())
    return float(
        (shapes[:, [j - 1 for j in floors]].max(axis=1) / shapes.max(axis=1)).min()
    )
