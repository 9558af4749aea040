"""Gives the channels to close_loop, then compares its report with the truth."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import search_path
import numpy as np
from harness import quietly

from pysindy_nrf import Chain, NRFRegressor, Record, Site, close_loop, laws
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
# Class of the package's effects that holds each family.
CLASS = {
    "friction": "memoryless",
    "damping": "memoryless",
    "stiffness": "memoryless",
    "contact": "memoryless",
    "hysteresis": "hysteresis",
    "degradation": "change in time",
    "forcing": "outside force",
    "link": "tie",
}
# The group "ordinary" has Rayleigh damping: these ties to the ground are there.
DASHPOTS = ("link_spring_dashpot", "power_law_damping", "ground_dashpot")
# A steep hysteresis is a friction and the reverse: they leave the catalogue together.
ONE_CLASS = {"friction", "hysteresis"}
# A second test would not show these from the same start: the loop holds out the end of
# the one record.
IN_TIME = ("stiffness_step", "stiffness_drift", "damping_drift", "harmonic")
# Effect over noise in the balances from which on an effect must be found.
ELIGIBLE = 2.0


# -- what the loop is given ----------------------------------------------------


def records(case: Case) -> tuple[list[Record], list[Record] | None]:
    """Records to search, and records to hold out."""
    searched = named_records("test", case.searched)
    if any(effect.kind in IN_TIME for effect in case.effects):
        return searched, None
    return searched, named_records("held-out test", case.unseen)


def named_records(name: str, tests: list[dict]) -> list[Record]:
    """Records of the channels of some tests."""
    return [Record(name=f"{name} {i}", **test) for i, test in enumerate(tests, 1)]


def known_masses(case: Case) -> dict[int, float] | None:
    """Under base excitation all masses are known."""
    if not case.base:
        return None
    return dict(enumerate(case.structure.m.tolist(), 1))


def baseline(case: Case) -> NRFRegressor:
    """The declared model."""
    return NRFRegressor(degree=case.degree, known_masses=known_masses(case))


def catalogue(case: Case) -> list | None:
    """Laws to search: all, or those without the families of the case's effects.

    A constant force is searched for only where there is one.
    """
    covariates = ("ag", "vg") if case.base else ()
    if any(effect.kind == "constant" for effect in case.effects):
        return [*default_catalogue(covariates), laws.ConstantForce()]
    if case.group != "withheld":
        return None
    gone = {FAMILY[effect.kind] for effect in case.effects}
    if gone & ONE_CLASS:
        gone |= ONE_CLASS
    return [law for law in default_catalogue(covariates) if law.family not in gone]


# -- parameters in the words of the package ------------------------------------
# of p, the parameters of an effect, the amplitude first


def amplitude(p: np.ndarray) -> float:
    return p[0]


def applied(p: np.ndarray) -> float:
    return -p[0]


def shape(p: np.ndarray) -> float:
    return p[1]


def per_shape(p: np.ndarray) -> float:
    return p[0] / p[1]


def forward(p: np.ndarray) -> float:
    return p[0] * (1 + p[2])


def backward(p: np.ndarray) -> float:
    return p[0] * (1 - p[2])


def exponent(p: np.ndarray) -> float:
    return p[2]


def square(p: np.ndarray) -> float:
    return 2.0


def bouc_wen_beta(p: np.ndarray) -> float:
    return p[2] ** (1 / p[3]) / p[1]


# For each kind the laws of the package that are the same formula. The battery's
# friction is rounded. What is stronger one way is a constant beside it, which no search
# sees.
SAME_LAWS: dict[str, dict[str, dict[str, Callable[[np.ndarray], float]]]] = {
    "coulomb": {
        "coulomb_friction": {"Fc": amplitude},
        "regularized_friction": {"Fc": amplitude},
    },
    "stribeck": {"stribeck_friction": {"Fc": amplitude}},
    "asymmetric_friction": {
        "asymmetric_coulomb_friction": {"Fcp": forward, "Fcm": backward},
        "coulomb_friction": {"Fc": amplitude},
        "regularized_friction": {"Fc": amplitude},
    },
    "ground_friction": {
        "coulomb_friction": {"Fc": amplitude},
        "ground_friction": {"Fc": amplitude},
        "regularized_friction": {"Fc": amplitude},
    },
    "quadratic_damping": {
        "quadratic_damping": {"c2": amplitude},
        "power_law_damping": {"n": square, "cn": amplitude},
    },
    "power_damping": {"power_law_damping": {"n": exponent, "cn": amplitude}},
    "cubic": {"cubic_stiffness": {"k3": amplitude}},
    "quintic": {"quintic_stiffness": {"k5": amplitude}},
    "quadratic": {"quadratic_stiffness": {"k2": amplitude}},
    "odd_quadratic": {"absolute_quadratic_stiffness": {"k2": amplitude}},
    "one_sided_gap": {"one_sided_gap": {"gap": shape, "k": amplitude}},
    "two_sided_gap": {
        "two_sided_gap": {"gap": shape, "k": amplitude},
        "dead_zone": {"gap": shape, "k": amplitude},
    },
    "bilinear": {"bilinear": {"dk": amplitude}},
    "dahl": {"dahl": {"sigma": shape, "Fd": amplitude}},
    "bouc_wen": {"bouc_wen": {"alpha": per_shape, "beta": bouc_wen_beta}},
    "jenkins": {"jenkins": {"uy": shape, "Fy": amplitude}},
    "maxwell": {"maxwell_branch": {"tau": shape, "k": amplitude}},
    "stiffness_step": {"stiffness_step": {"dk": amplitude, "t0": shape}},
    "stiffness_drift": {"stiffness_drift": {"kt": per_shape}},
    "damping_drift": {"damping_drift": {"ct": per_shape}},
    "harmonic": {"harmonic_force": {"frequency": shape, "amplitude": amplitude}},
    "constant": {"constant_force": {"f0": applied}},
    "brace": {"link_spring_dashpot": {"k": amplitude}},
    "ground_link": {"link_spring_dashpot": {"k": amplitude}},
}


def parameter_errors(effect: Effect, step: Any) -> list[float]:
    """Relative errors of the parameters that the two formulas share."""
    parameters = dict(step.parameters)
    if "A" in parameters and "B" in parameters:
        parameters["amplitude"] = float(np.hypot(parameters["A"], parameters["B"]))

    errors = []
    for name, value_of in SAME_LAWS[effect.kind].get(step.law, {}).items():
        true = value_of(effect.par)
        if name not in parameters:
            continue
        if name == "gap":  # of either side
            errors.append(abs(abs(parameters[name]) - abs(true)) / abs(true))
        else:
            errors.append(abs(parameters[name] - true) / abs(true))
    return errors


# -- the truth on the channels the loop used -----------------------------------


@dataclass(frozen=True)
class Motion:
    """Time, absolute accelerations, rates, drifts, forces, and the base's velocity."""

    t: np.ndarray
    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    vg: np.ndarray


def drifts(y: np.ndarray) -> np.ndarray:
    """Motions of the storeys from those of the DOFs."""
    return np.diff(y, axis=1, prepend=0.0)


def parts_of(effects: list[Effect], motion: Motion) -> list[np.ndarray]:
    """What each effect adds to each balance."""
    x = np.cumsum(motion.s, axis=1)
    rate = np.cumsum(motion.v, axis=1)
    parts = []
    for effect in effects:
        s, v = effect.between_ends(x), effect.between_ends(rate)
        force = effect.force(motion.t, s, v, motion.vg)
        forces = np.zeros_like(x)
        forces[:, effect.p - 1] += force
        if effect.q:
            forces[:, effect.q - 1] -= force
        parts.append(forces)
    return parts


def true_residual(structure: Structure, effects: list[Effect], motion: Motion):
    """Residual of the true model in each balance, the zeros of sensors taken out."""
    storey = (
        structure.k * motion.s + structure.c * motion.v + structure.k3 * motion.s**3
    )
    above = np.column_stack([storey[:, 1:], np.zeros(len(storey))])
    residual = structure.m * motion.a + storey - above - motion.F
    residual = residual + sum(parts_of(effects, motion))
    return residual - residual.mean(axis=0)


def simulated_motion(case: Case) -> Motion:
    """The motion without noise."""
    run = case.runs[0]
    return Motion(run.t, run.a, drifts(run.v), drifts(run.x), run.F, run.vg)


def fused_motion(ready: Any) -> Motion:
    """The motion that the loop made of the channels."""
    segment = ready.data.segments[0]
    rows = segment.valid
    still = np.zeros(len(segment.t))
    channels = (segment.a, segment.v, segment.s, segment.F)
    values = [np.asarray(y[rows], dtype=float) for y in channels]
    vg = segment.covariates.get("vg", still)
    return Motion(segment.t[rows], *values, vg[rows])


def audibility(case: Case, ready: Any) -> list[float]:
    """For each effect: rms of what the baseline cannot hold, over the noise.

    The noise is the rms balance residual of the true model on fused channels. The
    baseline's own columns in a balance are those that its solve determines there: the
    mass and the storeys that are still unknown when the solve order arrives (in an
    unforced balance the storey found before is given; with it free, any effect would be
    "reproduced" by the homogeneous equation itself). Where the solve sums balances
    (base excitation), so does this.
    """
    chain = Chain(case.structure.n)
    order = chain.identifiability(case.forced, known_masses=known_masses(case) or ())
    clean = simulated_motion(case)
    there = [*case.effects, *case.beside]
    residual = true_residual(case.structure, there, fused_motion(ready))

    matched = []
    for true_effect in parts_of(case.effects, clean):
        lost = noise = 0.0
        for step in order.steps:
            rows = [dof - 1 for dof in step.dofs]
            effect = true_effect[:, rows].sum(axis=1)
            if effect.any():
                columns = columns_of(step, clean, case.degree)
                lost += np.mean(unexplained(effect, columns) ** 2)
                noise += np.mean(residual[:, rows].sum(axis=1) ** 2)
        matched.append(float(np.sqrt(lost / noise)))
    return matched


def columns_of(step: Any, motion: Motion, degree: int) -> np.ndarray:
    """Columns that a step of the baseline's solve determines."""
    columns = [motion.a[:, dof - 1] for dof in step.masses]
    for site in step.sites:
        v, s = motion.v[:, site.p - 1], motion.s[:, site.p - 1]
        for h in range(degree + 1):
            for j in range(degree + 1 - h):
                if h + j > 0:
                    columns.append(v**h * s**j)
    if not columns:
        return np.empty((len(motion.t), 0))
    return np.column_stack(columns)


def unexplained(force: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What the columns leave of a force."""
    if not columns.size:
        return force
    scaled = columns / np.sqrt(np.mean(columns**2, axis=0))
    return force - scaled @ np.linalg.lstsq(scaled, force, rcond=None)[0]


# -- the verdict ---------------------------------------------------------------


def place(text: str) -> Site:
    """A site; on a DOF or between it and the ground is the same balance."""
    site = Site(text)
    return Site(f"ground {site.p}") if site.kind == "dof" else site


def at_site(effect: Effect, step: Any) -> bool:
    """Whether a step is where the effect is."""
    return place(step.site) == place(effect.site)


def of_class(effect: Effect, step: Any) -> bool:
    """Whether a step is of the effect's class, or of its family by a declared tie."""
    family = FAMILY[effect.kind]
    if step.effect_class == class_of(effect):
        return True
    return family in {step.family, *step.alternatives}


def class_of(effect: Effect) -> str:
    """The class of an effect: whatever joins no neighbours is a tie."""
    is_link = not effect.on_dof and not effect.site.startswith("storey")
    return "tie" if is_link else CLASS[FAMILY[effect.kind]]


def names(effect: Effect, step: Any) -> bool:
    """Whether a step is the effect, by site and class."""
    return at_site(effect, step) and of_class(effect, step)


def names_any(case: Case, step: Any) -> bool:
    """Whether a step is one of the case's effects."""
    return any(names(effect, step) for effect in case.effects)


def names_law(case: Case, step: Any) -> bool:
    """Whether a step is one of the case's effects, by site, class and law."""
    return any(
        names(effect, step) and step.law in SAME_LAWS[effect.kind]
        for effect in case.effects
    )


def claims(report: Any) -> list:
    """The effects that held-out data confirm."""
    return [step for step in report.steps if step.confirmed]


def judge(case: Case, report: Any) -> dict:
    """The verdict of one case: what is not confirmed is not claimed."""
    steps = [] if report is None else claims(report)
    if case.group in ("nothing", "sensors", "withheld"):
        return {"right": report is not None and not false_claims(case, steps)}
    if not case.effects:
        return {"right": not not_there(case, steps)}
    if len(case.effects) > 1:
        return judge_several(case.effects, steps)
    return judge_first(case.effects[0], steps)


def false_claims(case: Case, steps: list) -> list:
    """Claims that a case without findable effects must not raise."""
    if case.group == "sensors":
        return [step for step in steps if place(step.site).kind != "sensor"]
    if case.group == "withheld":
        return [step for step in steps if step.sure and not names_law(case, step)]
    return steps


def not_there(case: Case, steps: list) -> list:
    """Claims that are none of the case's effects."""
    unnamed = [step for step in steps if not names_any(case, step)]
    if case.group != "ordinary":
        return unnamed
    return [step for step in unnamed if not is_of_ordinary_tests(step)]


def is_of_ordinary_tests(step: Any) -> bool:
    """Whether a step is what every case of the group "ordinary" has beside its effect.

    Dashpots to the ground; and accelerometers are early, by the phase lead of their
    corner.
    """
    if step.site.startswith("ground"):
        return step.law in DASHPOTS
    is_early = step.law == "channel_delay" and step.parameters["tau"] < 0
    return is_early and step.site.startswith("sensor a")


def judge_several(effects: list[Effect], steps: list) -> dict:
    """Whether each effect is among the claims."""
    hits = 0
    errors: list[float] = []
    for effect in effects:
        named = [step for step in steps if names(effect, step)]
        if named:
            hits += 1
            errors += parameter_errors(effect, named[0])
    return {"right": hits == len(effects), "hits": hits, "parameter errors": errors}


def judge_first(effect: Effect, steps: list) -> dict:
    """Whether the first claim is the effect."""
    site = family = False
    errors: list[float] = []
    if steps:
        site, family = at_site(effect, steps[0]), of_class(effect, steps[0])
    if site and family:
        errors = parameter_errors(effect, steps[0])
    return {
        "right": site and family,
        "right site": site,
        "right class": family,
        "parameter errors": errors,
    }


# -- one case ------------------------------------------------------------------


def run_case(case: Case) -> dict:
    """Run the loop on one case and score it; one row of the battery's table."""
    return quietly(scored, case)


def scored(case: Case) -> dict:
    searched, unseen = records(case)
    heard = audibility(case, prepare(searched, unseen))
    row = described(case) | {
        "heard": min(heard, default=np.nan),
        "eligible": bool(heard) and min(heard) >= ELIGIBLE,
        "second record": unseen is not None,
    }
    start, cpu = time.perf_counter(), time.process_time()
    try:
        report = close_loop(searched, baseline(case), catalogue(case), heldout=unseen)
    except Exception as error:  # a crash is a failure of the case, shown in its row
        row["seconds"] = time.perf_counter() - start
        row["stopped"] = f"{type(error).__name__}: {error}"
        row["crash"] = traceback.format_exc(limit=-3)
        return row | judge(case, None)

    row["seconds"] = time.perf_counter() - start
    row["cpu"] = time.process_time() - cpu
    return row | reported(case, report) | judge(case, report)


def described(case: Case) -> dict:
    """What was drawn."""
    return {
        "case": case.name,
        "group": case.group,
        "seed": case.seed,
        "noise %": 100 * case.noise,
        "sensors": case.sensors,
        "n": case.structure.n,
        "degree": case.degree,
        "excitation": f"{'base ' if case.base else ''}{case.excitation}",
        "forced": where_forced(case),
        "effect": " + ".join(effect.kind for effect in case.effects) or "none",
        "site": " + ".join(effect.site for effect in case.effects),
        "share %": " + ".join(f"{100 * e.share:.0f}" for e in case.effects),
    }


def where_forced(case: Case) -> str:
    """Where the chain is excited."""
    if case.base:
        return "base"
    if len(case.forced) == case.structure.n:
        return "all"
    return f"dof {case.forced[0]}"


def reported(case: Case, report: Any) -> dict:
    """What the loop found."""
    steps, claimed = report.steps, claims(report)
    right = [step for step in claimed if names_law(case, step)]
    return {
        "steps": len(steps),
        "claims": len(claimed),
        "false": len(not_there(case, claimed)),
        "names right": len(right),
        "sure": sum(step.sure for step in claimed),
        "sure right": sum(step.sure for step in right),
        "found": " ; ".join(map(in_words, steps)),
        "error before": float(report.table["held-out"].iloc[0]),
        "error after": float(report.final["held-out"]),
        **first_step(steps),
        "mass error before": mass_error(report.models[0], case),
        "mass error after": mass_error(report.model, case),
        "stopped": report.stopped_because,
        "tied": ties(steps),
        "best rejected": rejected(report),
    }


def in_words(step: Any) -> str:
    """A step with its ties and what it is worth."""
    words = f"{step.law} at {step.site}"
    if step.alternatives:
        words += f" (or {', '.join(step.alternatives)})"
    if not step.sure:
        words += " [not sure]"
    if not step.confirmed:
        words += " [not confirmed]"
    return words


def first_step(steps: list) -> dict[str, float]:
    """What the first step gained, dB."""
    if not steps:
        columns = ("gain", "gain error", "gain least", "gain held-out")
        return dict.fromkeys(columns, np.nan)
    first = steps[0]
    return {
        "gain": first.reduction,
        "gain error": first.reduction_error,
        "gain least": first.reduction_least,
        "gain held-out": first.reduction_heldout,
    }


def ties(steps: list) -> str:
    """What would have explained the residual as well as the first step."""
    rivals = steps[0].rivals if steps else []
    return "; ".join(f"{law} at {site} {gain:.3g}" for law, site, gain in rivals)


def rejected(report: Any) -> str:
    """The best candidates that were not taken."""
    words = []
    for _, row in report.candidates.head(3).iterrows():
        words.append(f"{row['law']} at {row['site']} {row['reduction (dB)']:.3g}")
    return "; ".join(words)


def mass_error(model: Any, case: Case) -> float:
    """Largest error of a mass, percent."""
    return float(100 * np.max(np.abs(model.masses / case.structure.m - 1)))
