"""Hands the channels to close_loop, then compares its report with the truth."""

from __future__ import annotations

import time
import traceback
import warnings

import numpy as np

from pysindy_nrf import Chain, NRFRegressor, Record, Site, laws
from pysindy_nrf.discrepancy.catalogue import default_catalogue
from pysindy_nrf.discrepancy.prepare import prepare

from .generators import Case, Effect, Structure

# Family of the package's catalogue that holds each kind of effect.
FAMILY = {
    "coulomb": "friction",
    "stribeck": "friction",
    "asymmetric_friction": "friction",
    "ground_friction": "friction",
    "quadratic_damping": "damping",
    "power_damping": "damping",
    "cubic": "stiffness",
    "quintic": "stiffness",
    "quadratic": "stiffness",
    "odd_quadratic": "stiffness",
    "one_sided_gap": "contact",
    "two_sided_gap": "contact",
    "bilinear": "contact",
    "dahl": "hysteresis",
    "bouc_wen": "hysteresis",
    "jenkins": "hysteresis",
    "maxwell": "hysteresis",
    "stiffness_step": "degradation",
    "stiffness_drift": "degradation",
    "damping_drift": "degradation",
    "harmonic": "forcing",
    "constant": "forcing",
    "brace": "link",
    "ground_link": "link",
}
# A steep hysteresis is a friction and the reverse: they leave the catalogue together.
ONE_CLASS = ({"friction", "hysteresis"},)
# A second test would not show these from the same start: the loop holds out the end of
# the one record.
IN_TIME = ("stiffness_step", "stiffness_drift", "damping_drift", "harmonic")


def truth_parameters(effect: Effect) -> dict[str, dict[str, float]]:
    """The effect's parameters in the words of each law of the package that is the same
    formula.
    """
    A, p = effect.par[0], effect.par
    return {
        "coulomb": lambda: {"coulomb_friction": {"Fc": A}},
        "stribeck": lambda: {"stribeck_friction": {"Fc": A}},
        "asymmetric_friction": lambda: {
            "asymmetric_coulomb_friction": {
                "Fcp": A * (1 + p[2]),
                "Fcm": A * (1 - p[2]),
            }
        },
        "ground_friction": lambda: {
            "coulomb_friction": {"Fc": A},
            "ground_friction": {"Fc": A},
        },
        "quadratic_damping": lambda: {
            "quadratic_damping": {"c2": A},
            "power_law_damping": {"n": 2.0, "cn": A},
        },
        "power_damping": lambda: {"power_law_damping": {"n": p[2], "cn": A}},
        "cubic": lambda: {"cubic_stiffness": {"k3": A}},
        "quintic": lambda: {"quintic_stiffness": {"k5": A}},
        "quadratic": lambda: {"quadratic_stiffness": {"k2": A}},
        "odd_quadratic": lambda: {"absolute_quadratic_stiffness": {"k2": A}},
        "one_sided_gap": lambda: {"one_sided_gap": {"gap": p[1], "k": A}},
        "two_sided_gap": lambda: {
            "two_sided_gap": {"gap": p[1], "k": A},
            "dead_zone": {"gap": p[1], "k": A},
        },
        "bilinear": lambda: {"bilinear": {"dk": A}},
        "dahl": lambda: {"dahl": {"sigma": p[1], "Fd": A}},
        "bouc_wen": lambda: {
            "bouc_wen": {"alpha": A / p[1], "beta": p[2] ** (1 / p[3]) / p[1]}
        },
        "jenkins": lambda: {"jenkins": {"uy": p[1], "Fy": A}},
        "maxwell": lambda: {"maxwell_branch": {"tau": p[1], "k": A}},
        "stiffness_step": lambda: {"stiffness_step": {"dk": A, "t0": p[1]}},
        "stiffness_drift": lambda: {"stiffness_drift": {"kt": A / p[1]}},
        "damping_drift": lambda: {"damping_drift": {"ct": A / p[1]}},
        "harmonic": lambda: {"harmonic_force": {"frequency": p[1], "amplitude": A}},
        "constant": lambda: {"constant_force": {"f0": -A}},
        "brace": lambda: {"link_spring_dashpot": {"k": A}},
        "ground_link": lambda: {"link_spring_dashpot": {"k": A}},
    }[effect.kind]()


def place(text: str) -> Site:
    """A site with its equivalents made one: on a DOF or between it and the ground is
    the same balance.
    """
    site = Site(text)
    return Site(f"ground {site.p}") if site.kind == "dof" else site


# -- the truth on the channels the loop used -----------------------------------


def balances(structure: Structure, effects: list[Effect], t, a, v, s, F, vg):
    """Residual of the true model in each balance, and each effect's part of it.

    Parameters
    ----------
    a, v, s, F : ndarray of shape (n_samples, n)
        Absolute accelerations, inter-storey velocities and drifts, forces.

    Returns
    -------
    residual : ndarray of shape (n_samples, n)
    parts : list of ndarray of shape (n_samples, n)
    """
    n = structure.n
    storey = structure.k * s + structure.c * v + structure.k3 * s**3
    residual = structure.m * a + storey - np.c_[storey[:, 1:], np.zeros(len(t))] - F
    parts = []
    x, rate = np.cumsum(s, axis=1), np.cumsum(v, axis=1)
    for e in effects:
        p, q = e.p - 1, e.q - 1
        force = e.force(
            t,
            x[:, p] - (x[:, q] if q >= 0 else 0.0),
            rate[:, p] - (rate[:, q] if q >= 0 else 0.0),
            vg,
        )
        part = np.zeros((len(t), n))
        part[:, p] += force
        if q >= 0:
            part[:, q] -= force
        parts.append(part)
        residual = residual + part
    return residual, parts


def audibility(case: Case, ready) -> list[float]:
    """For each effect: rms of what the baseline cannot hold, over the rms balance
    residual of the true model.

    The baseline's own columns in a balance are those that its solve determines there:
    the mass and the storeys that are still unknown when the solve order arrives (in an
    unforced balance the storey found before is given; with it free, any effect would be
    "reproduced" by the homogeneous equation itself). Where the solve sums balances
    (base excitation), so does this.
    """
    run, seg = case.runs[0], ready.data.segments[0]
    known = range(1, case.structure.n + 1) if case.base else ()
    solve_order = Chain(case.structure.n).identifiability(
        case.forced, known_masses=known
    )
    s, v = (np.diff(y, axis=1, prepend=0.0) for y in (run.x, run.v))
    _, clean = balances(case.structure, case.effects, run.t, run.a, v, s, run.F, run.vg)
    residual = true_residual(case, seg)
    powers = [
        (h, j)
        for h in range(case.degree + 1)
        for j in range(case.degree + 1)
        if 0 < h + j <= case.degree
    ]
    out = []
    for part in clean:
        lost = noise = 0.0
        for step in solve_order.steps:
            rows = [j - 1 for j in step.dofs]
            effect = part[:, rows].sum(axis=1)
            if not effect.any():
                continue
            table = [run.a[:, j - 1] for j in step.masses]
            table += [
                v[:, site.p - 1] ** h * s[:, site.p - 1] ** j
                for site in step.sites
                for h, j in powers
            ]
            if table:
                columns = np.column_stack(table)
                columns /= np.sqrt(np.mean(columns**2, axis=0))
                effect = (
                    effect - columns @ np.linalg.lstsq(columns, effect, rcond=None)[0]
                )
            lost += np.mean(effect**2)
            noise += np.mean(residual[:, rows].sum(axis=1) ** 2)
        out.append(float(np.sqrt(lost / noise)))
    return out


def true_residual(case: Case, seg):
    """Residual of the true model on fused channels."""
    rows = seg.valid
    vg = (
        seg.covariates["vg"][rows]
        if "vg" in seg.covariates
        else np.zeros(rows.stop - rows.start)
    )
    channels = (np.asarray(y[rows], dtype=float) for y in (seg.a, seg.v, seg.s, seg.F))
    return balances(case.structure, case.effects, seg.t[rows], *channels, vg)[0]


# -- one case ------------------------------------------------------------------


def records(case: Case) -> tuple[list[Record], list[Record] | None]:
    """What the loop is given."""
    seen = [
        Record(name=f"test {i + 1}", **channels) for i, channels in enumerate(case.seen)
    ]
    if any(e.kind in IN_TIME for e in case.effects):
        return seen, None
    return seen, [
        Record(name=f"held-out test {i + 1}", **channels)
        for i, channels in enumerate(case.unseen)
    ]


def baseline(case: Case) -> NRFRegressor:
    """The declared model."""
    known = (
        {j + 1: float(m) for j, m in enumerate(case.structure.m)} if case.base else None
    )
    return NRFRegressor(degree=case.degree, known_masses=known)


def catalogue_of(case: Case) -> list | None:
    """What a search of a case may try; a constant force only where there is one."""
    if case.group == "withheld":
        return withheld(case)
    if any(effect.kind == "constant" for effect in case.effects):
        covariates = ("ag", "vg") if case.base else ()
        return [*default_catalogue(covariates), laws.ConstantForce()]
    return None


def withheld(case: Case) -> list:
    """The catalogue without the families of the case's effects."""
    gone = {FAMILY[e.kind] for e in case.effects}
    gone |= set().union(*(c for c in ONE_CLASS if c & gone))
    covariates = ("ag", "vg") if case.base else ()
    return [law for law in default_catalogue(covariates) if law.family not in gone]


def matches(effect: Effect, step) -> tuple[bool, bool]:
    """Whether a step is at the effect's site, and holds its family (itself or as a
    declared tie).
    """
    families = {step.family, *step.alternatives}
    return place(step.site) == place(effect.site), FAMILY[effect.kind] in families


def parameter_errors(effect: Effect, step) -> list[float]:
    """Relative errors of the parameters the two formulas share."""
    wanted = truth_parameters(effect).get(step.law)
    if wanted is None:
        return []
    found = dict(step.parameters)
    if "A" in found and "B" in found:
        found["amplitude"] = float(np.hypot(found["A"], found["B"]))
    return [
        (
            abs(abs(found[k]) - abs(x)) / abs(x)
            if k in ("gap",)
            else abs(found[k] - x) / abs(x)
        )
        for k, x in wanted.items()
        if k in found
    ]


def run_case(case: Case) -> dict:
    """Run the loop on one case and score it.

    Returns
    -------
    dict
        One row of the battery's table.
    """
    from pysindy_nrf import close_loop

    row = {
        "case": case.name,
        "group": case.group,
        "seed": case.seed,
        "noise %": 100 * case.noise,
        "sensors": case.sensors,
        "n": case.structure.n,
        "degree": case.degree,
        "excitation": ("base " if case.base else "") + case.excitation,
        "forced": (
            "base"
            if case.base
            else (
                "all"
                if len(case.forced) == case.structure.n
                else f"dof {case.forced[0]}"
            )
        ),
        "effect": " + ".join(e.kind for e in case.effects) or "none",
        "site": " + ".join(e.site for e in case.effects),
        "share %": " + ".join(f"{100 * e.share:.0f}" for e in case.effects),
    }
    seen, unseen = records(case)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ready = prepare(seen, unseen)
        heard = audibility(case, ready)
        row |= {
            "heard": min(heard, default=np.nan),
            "eligible": bool(heard) and min(heard) >= 2.0,
        }
        start, cpu = time.perf_counter(), time.process_time()
        try:
            report = close_loop(
                seen,
                baseline(case),
                catalogue_of(case),
                heldout=unseen,
            )
        except Exception as error:  # a crash is a failure of the case, shown in its row
            row |= {
                "seconds": time.perf_counter() - start,
                "stopped": f"{type(error).__name__}: {error}",
                "crash": traceback.format_exc(limit=-3),
            }
            return row | judge(case, None)
        row |= {
            "seconds": time.perf_counter() - start,
            "cpu": time.process_time() - cpu,
        }
    steps, claimed = report.steps, claims(report)
    right = [s for s in claimed if any(all(matches(e, s)) for e in case.effects)]
    row |= {
        "steps": len(steps),
        "claims": len(claimed),
        "names right": len(right),
        "sure": sum(s.sure for s in claimed),
        "sure right": sum(s.sure for s in right),
        "found": " ; ".join(
            f"{s.law} at {s.site}"
            + (f" (or {', '.join(s.alternatives)})" if s.alternatives else "")
            + ("" if s.sure else " [not sure]")
            + ("" if s.confirmed else " [not confirmed]")
            for s in steps
        ),
        "error before": float(report.table["held-out"].iloc[0]),
        "error after": float(report.final["held-out"]),
        "gain": steps[0].gain if steps else np.nan,
        "gain error": steps[0].gain_error if steps else np.nan,
        "gain least": steps[0].gain_least if steps else np.nan,
        "gain held-out": steps[0].gain_heldout if steps else np.nan,
        "mass error before": _mass_error(report.models[0], case),
        "mass error after": _mass_error(report.model, case),
        "stopped": report.stopped_because,
        "tied": "; ".join(
            f"{a} at {b} {c:.3g}" for a, b, c in (steps[0].tied if steps else [])
        ),
        "best rejected": "; ".join(
            f"{r['law']} at {r['site']} {r['gain (dB)']:.3g}"
            for _, r in report.candidates.head(3).iterrows()
        ),
    }
    return row | judge(case, report)


def _mass_error(model, case: Case) -> float:
    return float(100 * np.max(np.abs(model.masses / case.structure.m - 1)))


def claims(report) -> list:
    """The effects that held-out data confirm."""
    return [step for step in report.steps if step.confirmed]


def judge(case: Case, report) -> dict:
    """The verdict of one case: what is not confirmed is not claimed."""
    steps = claims(report) if report is not None else []
    if case.group == "nothing":
        return {"right": report is not None and not steps}
    if case.group == "sensors":
        return {
            "right": (
                report is not None
                and all(place(s.site).kind == "sensor" for s in steps)
            )
        }
    if case.group == "withheld":
        wrong = [
            s
            for s in steps
            if s.sure and not any(all(matches(e, s)) for e in case.effects)
        ]
        return {"right": report is not None and not wrong}
    errors: list[float] = []
    if len(case.effects) > 1:
        hit = [
            next((s for s in steps if all(matches(e, s))), None) for e in case.effects
        ]
        for e, s in zip(case.effects, hit):
            errors += parameter_errors(e, s) if s is not None else []
        return {
            "right": all(s is not None for s in hit),
            "hits": sum(s is not None for s in hit),
            "parameter errors": errors,
        }
    effect = case.effects[0]
    if not steps:
        return {
            "right": False,
            "right site": False,
            "right family": False,
            "parameter errors": errors,
        }
    site, family = matches(effect, steps[0])
    if site and family:
        errors = parameter_errors(effect, steps[0])
    return {
        "right": site and family,
        "right site": site,
        "right family": family,
        "parameter errors": errors,
    }
