"""Masses and laws of a chain with fewer sensors than floors: its free run fitted to the
channels that there are.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from scipy.fft import next_fast_len
from scipy.stats import chi2, norm

from ..chain.layout import LawLayout, with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.structure import Chain
from ..equations.chain_solve import scales_of
from ..equations.errors import COLUMNS
from ..exceptions import (
    ChannelError,
    ExcitationError,
    IdentifiabilityError,
    NRFError,
)
from ..laws import PowerSeries
from ..laws.shape import ShapeScale
from ..records.channels import finite_span
from ..records.dataset import Dataset, Segment
from ..records.fusion.kinematics import base_acceleration_if_any
from ..records.record import Record
from .chain_starts import Linear, chain_starts
from .noise_spectra import (
    common_band,
    expected,
    linearised,
    lines_of,
    transfer,
    white_density,
)
from .output_error import (
    FreeRunFit,
    Rebuild,
    Shot,
    Solution,
    free_parameters,
    lengths,
    placed,
)
from .parameters import Known, linear_equations, with_values
from .problem import Problem

MOST_STEPS, FEW_STEPS = 100, 6  # iterations at most; of a trial
ROUNDS = 2  # of noise and estimate
WINDOW, WINDOWS = (
    150,
    8,
    # samples at least, and number at most, of windows in which nonlinear laws are
    # fitted first
)
TRIALS = (
    0.3,
    0.5,
    0.7,
)  # first values of shape parameters, as shares of the way between their bounds
# largest mass over smallest from which on a chain is followed only if there is no
# other: a fixed floor
UNEVEN = 100.0
NEAR = 3.0  # cost of a trial over the least, above which it is not followed
RIVAL, APART = (
    0.999,
    0.2,
    # level of the joint confidence region, and distance of logarithms, of another chain
    # in it
)
UNSURE, UNKNOWN, SURE = (
    0.1,
    0.5,
    0.33,
)  # standard error, as a share, that is said; that is refused; of a sure sign
# condition of the sensitivities, each of length one, from which on they are not told
# apart
ILL = 1e9
# spread of an equation that has none, as a share of its terms: round-off of
# sensitivities
EXACT = 1e-6
LEVEL = 0.95  # of the intervals of motions
FORGOTTEN, LONGEST = (
    7.0,
    6,
)  # time constants after which a thousandth is left; lengths of a record at most


def shot_of(record: Record, number: int, n: int) -> Shot:
    """What drives a record, and its channels."""
    if record.n_dof != n:
        what = f"Record {record.name!r} has {record.n_dof} DOFs, {n} are needed"
        raise ChannelError(what, "Give records of one chain.")
    if record.unknown:
        what = (
            f"The force on DOF {record.unknown[0]} of record {record.name!r} is"
            " unknown, and floors have no sensor"
        )
        cure = (
            "Measure it (zeros: known to be unforced), put a sensor on every floor, or"
            " take the floors above it as "
        )
        raise ChannelError(
            what,
            f"{cure}a chain on it: its acceleration as base_acceleration=, one mass"
            " known.",
        )
    channels = {
        c: line
        for c, line in record.channels().items()
        if c[0] in "avx" and c[1:].isdigit()
    }
    if record.coordinates == "absolute" and record.base_moves:
        for kind, base in (
            ("v", record.base_velocity),
            ("x", record.base_displacement),
        ):
            for c in [c for c in channels if c[0] == kind]:
                if base is None:
                    cure = (
                        "Give it, or motion relative to the base, or accelerations"
                        " alone."
                    )
                    raise ChannelError(
                        f"Channel {c} of record {record.name!r} is absolute, and"
                        f" {kind}g lacks",
                        cure,
                    )
                channels[c] = channels[c] - base
    ag, forces = (
        base_acceleration_if_any(record),
        {f"F{j + 1}": line for j, line in enumerate(record.force.T)},
    )
    every = channels | forces | ({} if ag is None else {"ag": ag}) | record.covariates
    rows = finite_span(list(every.values()), list(every), f"record {record.name!r}")
    blank = np.full((record.n_samples, n), np.nan)
    segment = Segment(
        record.name,
        slice(0, record.n_samples),
        blank,
        blank,
        blank,
        record.force,
        record.time,
        ag,
        dict(record.covariates),
        valid=rows,
    )
    measured = np.column_stack([line[rows] for line in channels.values()])
    return Shot(
        segment,
        number,
        np.zeros((2, n)),
        tuple(channels),
        measured,
        np.ones((len(measured), 1)),
        "linear",
    )


def estimate(
    problem: Problem,
    shots: Sequence[Shot],
    known: Mapping[int, float],
    given: Known = MappingProxyType({}),
) -> tuple[FreeRunFit, Solution, list[str]]:
    """Free run of the problem's laws fitted to the channels of shots, from several
    starts; a rival, in words.
    """
    chain, layout, band = problem.chain, problem.layout, problem.band
    links = [site for site in layout.acting if site.kind == "link"]
    linear = LawLayout(chain, {site: (PowerSeries(1),) for site in links})
    tried: list[tuple[FreeRunFit, Solution]] = []
    value = {f"m{j}": m for j, m in known.items()} | {
        name: p.value
        for name, p in with_values(given, _drawn_names(chain, links), chain).items()
        if p.value is not None
    }
    seen = {int(channel[1:]) for channel in shots[0].channels}
    forced = {
        int(j) + 1
        for s in shots
        for j in np.flatnonzero(s.segment.F[s.segment.valid].any(axis=0))
    }
    about = (
        known
        if known or forced
        else {int(name[1:]): m for name, m in value.items() if name[0] == "m"}
    )
    if not forced and not about:
        cure = (
            "Measure a force on one DOF, or give a mass: known_masses={dof: kg}; ratios"
            " to it then come out."
        )
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            cure,
        )
    declared = [(site, law) for site, held in problem.laws.items() for law in held]
    plain = all(
        site in links and isinstance(law, PowerSeries) and law.degree == 1
        for site, law in declared
    )
    if (
        plain
        and not given
        and not (sensing := chain.sensing(seen, forced, known_masses=known)).complete
    ):
        raise IdentifiabilityError(
            str(sensing).rstrip("."),
            "So do more known_masses=, or a Parameter with a spread for each.",
        )
    starts, band_of_all = (
        _drawn(value, chain.n_dof, links),
        common_band([shot.segment for shot in shots], band),
    )
    with suppress(*[IdentifiabilityError] * len(starts)):
        starts += chain_starts(shots, chain, links, about, band_of_all)
    for one in starts:
        laws = {
            site: PowerSeries(1, pair)
            for site, *pair in zip(links, one.damping, one.stiffness)
        }
        rebuild = free_parameters(ChainModel(one.masses, laws, chain), known)
        fit = FreeRunFit(
            rebuild,
            list(map(replace, shots)),
            linear,
            band,
            _prior(given, rebuild, known, plain),
        )
        if got := _solved(fit, rebuild.start, FEW_STEPS):
            tried.append((fit, got))
    if not tried:
        raise IdentifiabilityError(
            "No linear chain follows the channels",
            "Check units and DOFs, or add a sensor.",
        )
    even = [
        pair for pair in tried if np.ptp(np.log(pair[1].model.masses)) < np.log(UNEVEN)
    ]
    tried = sorted(even or tried, key=lambda pair: pair[1].cost)
    near = [(fit, got) for fit, got in tried[:2] if got.cost <= NEAR * tried[0][1].cost]
    if not plain:
        rivals, (fit, best) = [], _with_laws(problem, near, known, given)
    else:
        size = tried[0][0].lines * len(
            shots[0].channels
        )  # of the data: the ratio of likelihoods as one of costs
        alike = np.exp(chi2.ppf(RIVAL, len(tried[0][1].u)) / size)
        near += [
            (fit, got) for fit, got in tried[2:] if got.cost <= alike * tried[0][1].cost
        ]
        ends = sorted(
            ((fit, _solved(fit, got.u, MOST_STEPS) or got) for fit, got in near),
            key=lambda end: end[1].cost,
        )
        rivals, (fit, best) = (
            _rivals([got for _, got in ends if got.cost < alike * ends[0][1].cost]),
            ends[0],
        )
    fit.choose_hold(best.model)
    if fit.shots[0].hold != "linear":
        best = _solved(fit, best.u, MOST_STEPS) or best
    for _ in range(ROUNDS):
        again = copy(fit)
        again.shots = list(map(replace, fit.shots))
        if not again.learn_noise(best.model, fit.shots[0].channels) or not (
            got := _solved(again, best.u, MOST_STEPS)
        ):
            break
        if any(
            _model_error(again, shot, best.model) for shot in again.shots
        ):  # which is no noise: it may mislead
            missed = [
                _channel_errors(f.shots, x.model)["error"]["pooled"]
                for f, x in ((fit, best), (again, got))
            ]
            if missed[1] > (1 + UNSURE) * missed[0]:
                break
        fit, best = again, got
    if fit.noise is None:  # weights do without it, intervals of motions do not
        fit.learn_noise(best.model, fit.shots[0].channels)
    return fit, best, rivals


def _prior(
    given: Known,
    rebuild: Rebuild,
    known: Mapping[int, float],
    whole: bool = True,
) -> Any:
    """Equations of what is known of the free parameters, over their spreads."""
    equations = linear_equations(
        given, _names(rebuild), rebuild.model.chain, dict(known), whole
    )
    A, b, spread = equations.factors, equations.values, equations.spreads
    spread = np.where(
        spread > 0,
        spread,
        EXACT * (np.abs(A) @ np.abs(rebuild.numbers(rebuild.start)) + np.abs(b)),
    )
    return A / spread[:, None], b / spread


def _drawn_names(chain: Chain, links: Sequence[Site]) -> list[str]:
    """Masses and stiffnesses that drawings tell."""
    masses = [f"m{j}" for j in range(1, chain.n_dof + 1)]
    return [*masses, *(f"{site}: s" for site in links)]


def _drawn(value: Mapping[str, float], n: int, links: Sequence[Site]) -> list[Linear]:
    """The chain of known values, damped by a hundredth, if they give every mass and
    stiffness.
    """
    masses = np.array([value.get(f"m{j}", 0.0) for j in range(1, n + 1)])
    k = np.array([value.get(f"{site}: s", 0.0) for site in links])
    if (masses <= 0).any() or (k <= 0).any():
        return []
    first = (
        ChainModel(
            masses, {site: PowerSeries(1, [0.0, s]) for site, s in zip(links, k)}
        )
        .modes()["frequency"]
        .min()
    )
    return [Linear(masses, k, 0.02 * k / (2 * np.pi * first), 0.0)]


def _solved(fit: FreeRunFit, u: np.ndarray, steps: int) -> Solution | None:
    """Estimate with free initial states; None if the first free run diverges."""
    try:
        return fit.solve(u, steps=steps, move=True, settled=0.02)
    except NRFError:
        return None


def _with_laws(
    problem: Problem,
    starts: Sequence[tuple[FreeRunFit, Solution]],
    known: Mapping[int, float],
    given: Known,
) -> tuple[FreeRunFit, Solution]:
    """The declared laws, first in windows, from linear chains on their way: what these
    lack drives them off later.
    """
    free = [
        (site, i, p)
        for site, held in problem.laws.items()
        for i, law in enumerate(held)
        for p in law.shapes
        if law.shape[p.name] is None
    ]
    tried: list[tuple[Solution, FreeRunFit]] = []
    for first, linear in starts:
        shots, model = first.shots, linear.model
        if any(
            np.abs(np.log(model.masses / fit.rebuild.model.masses)).max() < APART
            for _, fit in tried
        ):
            continue
        runs = Dataset([shot.run(model) for shot in shots], 0)
        scale = ShapeScale(
            [p for *_, p in free],
            [scales_of(runs, problem.layout)[site] for site, *_ in free],
        )
        for share in TRIALS if free else (0.5,):
            laws = {site: list(held) for site, held in problem.laws.items()}
            for (site, i, p), value in zip(
                free, scale.values(scale.low + share * (scale.high - scale.low))
            ):
                laws[site][i] = laws[site][i].with_values(shape={p.name: float(value)})
            values, sizes = _coefficients(LawLayout(problem.chain, laws), runs, model)
            start = ChainModel(
                model.masses, with_coefficients(laws, values), problem.chain
            )
            rebuild = free_parameters(start, known, sizes, free)
            parts = [
                _windows(shot, run, problem.layout.has_memory)
                for shot, run in zip(shots, runs.segments)
            ]
            rest = problem.layout, problem.band, _prior(given, rebuild, known)
            fit = FreeRunFit(rebuild, sum(parts, []), *rest)
            if got := _solved(fit, rebuild.start, FEW_STEPS):
                whole = [
                    replace(shot, start=each[0].start)
                    for shot, each in zip(shots, parts)
                ]
                tried.append((got, FreeRunFit(rebuild, whole, *rest)))
    for got, fit in sorted(tried, key=lambda pair: pair[0].cost):
        if best := _solved(fit, got.u, MOST_STEPS // 2):
            return fit, best
    raise IdentifiabilityError(
        "The free run of the declared laws diverges", "Start from a simpler law."
    )


def _coefficients(
    layout: LawLayout, runs: Dataset, model: ChainModel
) -> tuple[dict[Site, np.ndarray], dict[tuple, float]]:
    """Coefficients whose forces are nearest to those of a linear model along its run,
    and the size of each term.
    """
    values, sizes = {}, {}
    for site in layout.acting:
        motions = [run.motion(site, run.valid) for run in runs.segments]
        wide = np.concatenate([layout.columns(site, motion) for motion in motions])
        rms = np.sqrt(np.mean(wide**2, axis=0))
        rms[rms == 0] = 1.0
        held = (
            model.restoring_forces[site].linear_part()
            if site.kind == "link"
            else {"k": 0.0, "c": 0.0}
        )
        force = np.concatenate(
            [held["k"] * motion.s + held["c"] * motion.v for motion in motions]
        )
        values[site] = np.linalg.lstsq(wide / rms, force, rcond=1e-6)[0] / rms
        for k in range(wide.shape[1]):
            sizes[site, k] = float(
                0.1 * max(np.sqrt(np.mean(force**2)), 1e-300) / rms[k]
            )
    return values, sizes


def _windows(shot: Shot, run: Segment, memory: bool) -> list[Shot]:
    """Parts of a shot, each from the state of a run; the whole shot if a law remembers
    the path.
    """
    seg = shot.segment
    count = 1 if memory else int(np.clip(shot.n_samples // WINDOW, 1, WINDOWS))
    edges = np.linspace(0, shot.n_samples, count + 1).astype(int)
    out = []
    for low, high in zip(edges[:-1], edges[1:]):
        rows = slice(seg.valid.start + int(low), seg.valid.start + int(high))
        state = np.array([np.cumsum(y[rows.start]) for y in (run.s, run.v)])
        part = replace(
            shot,
            segment=replace(seg, valid=rows),
            start=state,
            weights=shot.weights[low:high],
        )
        out.append(replace(part, measured=shot.measured[low:high]))
    return out


def _names(rebuild: Rebuild) -> list[str]:
    """Parameters in words."""
    labels = {
        site: [term.label for law in held for term in law.terms()]
        for site, held in rebuild.model.laws.items()
    }
    return [
        (
            f"m{site + 1}"
            if not rest
            else f"{site}: {rest[1].name if len(rest) == 2 else labels[site][rest[0]]}"
        )
        for site, *rest in rebuild.places
    ]


def _shares(best: Solution, rebuild: Rebuild) -> np.ndarray:
    """Standard errors of parameters as shares of them."""
    errors = np.sqrt((best.influences**2).sum(axis=0))
    return errors / np.where((rebuild.scale == 0) | (best.u == 0), 1.0, np.abs(best.u))


def told(best: Solution, rebuild: Rebuild) -> list[str]:
    """Sentences on masses and stiffnesses that the channels tell poorly; an error if
    they do not tell them.
    """
    names, spread = _names(rebuild), _shares(best, rebuild)
    singular, vectors = np.linalg.svd(best.jacobian / lengths(best.jacobian))[1:]
    cure = (
        "Add a sensor (Chain.sensing says where), give known_masses=, or declare fewer"
        " laws."
    )
    if singular[-1] * ILL < singular[0]:
        blind = [name for name, part in zip(names, np.abs(vectors[-1])) if part > 0.3]
        raise IdentifiabilityError(
            f"The measured channels do not tell {', '.join(blind)} apart", cure
        )
    judged = [
        k for k, name in enumerate(names) if ":" not in name or name.endswith(": s")
    ]
    bad = sorted((k for k in judged if spread[k] > UNSURE), key=lambda k: -spread[k])
    if bad and spread[bad[0]] > UNKNOWN:
        size = (
            f"{100 * spread[bad[0]]:.0f} %"
            if spread[bad[0]] < 1
            else "more than itself"
        )
        raise IdentifiabilityError(
            f"The channels do not tell {names[bad[0]]}: its standard error is {size}",
            cure,
        )
    said = ", ".join(f"{names[k]} to {100 * spread[k]:.0f} %" for k in bad)
    return (
        [f"The measured channels tell {said} only (standard error). {cure}"]
        if bad
        else []
    )


def negative(best: Solution, rebuild: Rebuild) -> list[str]:
    """A sentence if the channels ask for a negative damper."""
    every = zip(_names(rebuild), best.u, _shares(best, rebuild))
    odd = [
        name
        for name, u, share in every
        if name[-3:] == ": v" and u < 0 and share < SURE
    ]
    said = (
        "The channels ask for a negative {}, which no passive storey has: the chain is"
        " another, or lacks a law."
    )
    return [said.format(odd[0])] if odd else []


def _rivals(found: Sequence[Solution]) -> list[str]:
    """A sentence if chains far apart fit alike; the best comes first."""
    said = (
        "Another linear chain fits the channels as well, with masses of {} kg: add a"
        " sensor."
    )
    far = [
        m
        for one in found
        if np.abs(np.log((m := one.model.masses) / found[0].model.masses)).max() > APART
    ]
    return [said.format(", ".join(f"{m:.3g}" for m in far[0]))] if far else []


def _model_error(fit: FreeRunFit, shot: Shot, model: ChainModel) -> float:
    """Largest share of a channel that neither the other channels nor twice its noise
    tell.
    """
    noise = fit.noise and fit.noise.with_model_error(shot.segment, shot.measured)
    step, gap, found = shot.segment.step, shot.measured - shot.read(model), [0.0]
    for c, line in enumerate(shot.measured.T if noise else ()):
        rest = [k for k in range(gap.shape[1]) if k != c]
        others = noise.of(rest) if noise and rest else None
        own = (
            expected(others, shot.channels[c : c + 1], gap[:, rest], step)[:, 0]
            if others
            else 0.0
        )
        beyond = (
            np.mean((gap[:, c] - own) ** 2) - 4.0 * white_density(line, step) / step
        )
        found.append(float(np.sqrt(max(beyond, 0.0) / np.mean(line**2))))
    return max(found)


class Linearised:
    """The free run of a model, and what forces beside its own would do to the measured
    channels, to first order.

    If masses m and laws R are true, the channels miss the run by ``-G (M a + R - F)``,
    G the response of the model.
    """

    def __init__(self, model: ChainModel, shots: Sequence[Shot]) -> None:
        motions = [shot.motion(model) for shot in shots]
        self.measured = {i: shot.measured.T for i, shot in enumerate(shots)}
        self.gaps = {
            i: (s.measured - s.of(motion)).T
            for i, (s, motion) in enumerate(zip(shots, motions))
        }
        self.runs = [
            placed(shot.segment, motion) for shot, motion in zip(shots, motions)
        ]
        M, C, K = matrices = linearised(
            model, LawLayout(model.chain, model.laws), self.runs
        )
        poles = np.linalg.eigvals(
            np.vstack(
                [np.eye(2 * len(M))[len(M) :], -np.linalg.solve(M, np.hstack([K, C]))]
            )
        )
        rest = (
            FORGOTTEN / np.abs(poles.real).min()
        )  # s, in which the end of a record has died out
        self.responses = []
        for shot in shots:
            size = next_fast_len(
                int(
                    min(
                        shot.n_samples + rest / shot.segment.step,
                        LONGEST * shot.n_samples,
                    )
                ),
                True,
            )
            f = np.fft.rfftfreq(size, shot.segment.step)
            f[0] = 1e-3 * f[1]
            self.responses.append(
                (size, transfer(matrices, f, shot.channels)[:, :, :-1])
            )

    def through(self, rows: np.ndarray, ends: np.ndarray, number: int) -> np.ndarray:
        """Channels from forces that enter the balances with some signs, (n_rows *
        n_channels, n_samples).
        """
        size, response = self.responses[number]
        lines = np.fft.rfft(rows, size, axis=1)[:, None] * (response @ ends).T
        return np.fft.irfft(lines, size, axis=2)[:, :, : rows.shape[1]].reshape(
            -1, rows.shape[1]
        )


def _channel_errors(shots: Sequence[Shot], model: ChainModel) -> pd.DataFrame:
    """Free-run errors of the measured channels, percent NRMSE; of each DOF the channel
    with the largest.
    """
    pairs = [(shot.measured, shot.read(model)) for shot in shots]
    measured, run = (np.concatenate(part) for part in zip(*pairs))
    left, size = (
        np.sqrt(np.mean((run - measured) ** 2, axis=0)),
        np.sqrt(np.mean(measured**2, axis=0)),
    )
    found = sorted(
        (100 * e / s, e, s, c) for c, e, s in zip(shots[0].channels, left, size)
    )
    rows: dict[str, list] = {f"dof {one[3][1:]}": list(one) for one in found}
    rows["pooled"] = [
        100 * float(np.sqrt(np.mean((left / size) ** 2))),
        np.nan,
        np.nan,
        "",
    ]
    return pd.DataFrame.from_dict(rows, orient="index", columns=COLUMNS)


def _motions(
    fit: FreeRunFit, number: int, best: Solution, error: float
) -> pd.DataFrame:
    """Motions of all DOFs and forces of all sites in a record, with intervals (noise;
    error of the model, as a share).

    What the run misses of the measured channels tells what it misses of the others: as
    much as forces on the floors would that make up for the error of the model.
    """
    shot, n, h = fit.shots[number], best.model.n_dof, 1e-4
    sites, names = (
        list(best.model.laws),
        tuple(f"{kind}{j}" for kind in "avx" for j in range(1, n + 1)),
    )
    noise = fit.noise and fit.noise.with_model_error(shot.segment, shot.measured)
    f, step = lines_of(shot.segment), shot.segment.step

    def everything(model: ChainModel) -> np.ndarray:
        motion = shot.motion(model)
        if noise is not None:
            more = expected(noise, names, shot.measured - shot.of(motion), step)
            motion = {
                kind: motion[kind] + part
                for kind, part in zip("avx", np.hsplit(more, 3))
            }
        forces = model.site_forces(Dataset([placed(shot.segment, motion)], 0))[0]
        return np.hstack([motion["a"], motion["v"], motion["x"], forces])

    own = everything(best.model)
    _, size, turned = np.linalg.svd(best.influences, full_matrices=False)
    variance = np.zeros_like(own) + np.mean((error * own) ** 2, axis=0)
    for direction in (
        size[:, None] * turned
    ):  # independent directions, each one standard error long
        variance += ((everything(fit.rebuild(best.u + h * direction)) - own) / h) ** 2
    if noise is not None:
        f = f[(f >= fit.low) & (f <= fit.high)]
        linear = [best.model.restoring_forces[site].linear_part() for site in sites]
        for rows, G, S in noise.blocks(f):
            T = transfer(noise.matrices, f[rows], names)
            x = np.pad(T[:, 2 * n :], ((0, 0), (1, 0), (0, 0)))
            iw = 2j * np.pi * f[rows, None]
            extra = [
                (p["k"] + iw * p["c"]) * (x[:, s.p] - x[:, s.q or 0])
                for s, p in zip(sites, linear)
            ]
            T = np.concatenate([T, np.stack(extra, axis=1)], axis=1)
            known = np.linalg.solve(
                S, G * noise.force
            )  # what the channels tell of the forces
            left = (
                np.diag(noise.force)
                - (G * noise.force).conj().transpose(0, 2, 1) @ known
            )
            variance += (
                2
                * np.einsum("fck,fkl,fcl->c", T, left, T.conj(), optimize=True).real
                * (f[1] - f[0])
            )
    half = norm.ppf(0.5 + LEVEL / 2) * np.sqrt(variance)
    columns = [*names, *(f"R {site}" for site in sites)]
    tables = [
        pd.DataFrame(own + k * half, columns=[name + end for name in columns])
        for k, end in ((0, ""), (-1, "_lower"), (1, "_upper"))
    ]
    time = None if shot.segment.t is None else shot.segment.t[shot.segment.valid]
    return pd.concat(tables, axis=1).set_axis(pd.Index(time, name="t"), axis=0)
