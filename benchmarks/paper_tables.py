"""Every number the paper prints, beside ours.

    python benchmarks/paper_tables.py [--quick] [--out FOLDER]

``--quick`` takes fewer force levels, seeds and storeys; ``--out`` writes each table as
CSV too. Every table is a function that returns a DataFrame.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import search_path
import numpy as np
import pandas as pd
import paper_cases as cases
import paper_published as published
from harness import markdown, options_of, write_csv
from independent import independent_masses
from planarity import Location, locate_nonlinearity

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, laws
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import BiasWarning, DataQualityWarning
from pysindy_nrf.identification import dissipated_energy
from pysindy_nrf.monitoring import compare_tests

DAHL = [laws.PowerSeries(1), laws.Dahl()]  # sigma is estimated
CUBIC_SERIES = {"degree": 3}
HYSTERETIC = {
    1: {"degree": 1, "laws": {"storey 1": DAHL}},
    4: {"degree": 1, "laws": {"storey 4": DAHL}},
}
EXCITATIONS = ("complete", "incomplete")
EDGE = 3.0  # s, what the 1 Hz high-pass of the paper spoils at either end

Features = tuple[pd.DataFrame, pd.DataFrame]


# -- fits and errors -----------------------------------------------------------


def fit(X: Any, F: Any, **options: Any) -> tuple[NRFRegressor, bool]:
    """A regressor that solves as the paper does, and whether it warned of bias."""
    options = {"strategy": cases.paper_strategy(X, F)} | options
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("ignore", DataQualityWarning)
        warnings.simplefilter("always", BiasWarning)
        model = NRFRegressor(**options).fit(X, F)
    warned = [issubclass(warning.category, BiasWarning) for warning in raised]
    return model, any(warned)


def exact(case: cases.Case) -> Features:
    """Noise-free features of a case."""
    return case.exact.to_features(smooth=False)


def available(case: cases.Case) -> Features:
    """Fused features where a case is noisy."""
    return case.measured.to_features() if case.noise else exact(case)


def located(model: NRFRegressor, X: Any, F: Any, quick: bool) -> Location:
    """The storeys that are not planar."""
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        draws = 5 if quick else 20
        return locate_nonlinearity(model, X, F, draws=draws, random_state=0)


def work(force: np.ndarray, rate: Any, time: Any = None) -> float:
    """Energy that a force takes up, J (per sample without times)."""
    return float(np.trapezoid(force * rate, time))


def energy_error(
    model: NRFRegressor, X: pd.DataFrame, case: cases.Case, storey: int
) -> float:
    """Error of the energy that the damper dissipated, percent.

    The identified one is that along the motion X.
    """
    rate = exact(case)[0][f"v{storey}"]
    true = work(case.damper[:, storey - 1], rate, case.exact.time)
    energy = dissipated_energy(model, X, without=case.bare)
    return 100 * (energy[f"storey {storey}"].iloc[-1] / true - 1)


def mass_errors(model: Any, case: cases.Case) -> np.ndarray:
    """Percent of the true masses."""
    return 100 * (model.masses_ / case.truth.masses - 1)


def linear_terms(model: Any, storey: int) -> dict[str, float]:
    """k (N/m) and c (N s/m) of a storey of a regressor or a model."""
    model = getattr(model, "model_", model)
    return model.restoring_forces[storey].linear_part()


def numbered(symbol: str, values: Any) -> dict[str, float]:
    """Values by symbols such as m1, m2."""
    return {f"{symbol}{j}": value for j, value in enumerate(values, 1)}


def hit(floors: tuple[int, ...]) -> str:
    """Which floors are hit, in words."""
    return "all floors" if len(floors) == 4 else f"floor {floors[0]}"


def indexed(rows: dict, *names: str) -> pd.DataFrame:
    """A table of rows by their keys."""
    table = pd.DataFrame.from_dict(rows, orient="index")
    if names:
        table.index.names = list(names)
    return table


# -- the whole paper in one table ----------------------------------------------


@dataclass(frozen=True)
class Repeated:
    """A result of the paper, its test simulated, and fits by its method and at best.

    ``device`` is the storey of the damper, None where there is none.
    """

    result: published.Result
    case: cases.Case
    method: NRFRegressor
    best: NRFRegressor
    device: int | None

    def parameters(self) -> dict:
        """Masses, stiffnesses and dampings; a storey with a damper has no truth."""
        linear = {i: terms[:2] for i, terms in self.result.storeys.items()}
        paper = printed_parameters(self.result.masses, linear)
        method = parameters_of(self.method.model_)
        best = parameters_of(self.best.model_)
        truth = parameters_of(self.case.truth)
        rows = {}
        for key, value in paper.items():
            hidden = key in (f"k{self.device}", f"c{self.device}")
            rows[self.result.equations, key] = {
                "paper": value,
                "its method": method[key],
                "at best": best[key],
                "truth": np.nan if hidden else truth[key],
            }
        return rows

    def figures(self) -> dict:
        """Errors of what the paper draws and does not print."""
        if self.device is None:
            return {}
        edge = int(EDGE * self.case.exact.fs)
        motion = exact(self.case)[0].iloc[edge:-edge]
        damper = self.case.damper[edge:-edge, self.device - 1]
        errors: dict[str, Callable] = {
            "damper force": self.damper_errors,
            "dissipated energy": self.energy_errors,
            "surfaces": self.surface_errors,
        }
        rows = {}
        for number, content in self.result.figures.items():
            if content in errors:
                for key, values in errors[content](motion, damper).items():
                    pair = dict(zip(("its method", "at best"), values))
                    rows[f"Fig. {number}", key] = pair
        return rows

    def device_forces(self, motion: pd.DataFrame) -> list[np.ndarray]:
        """What either fit has more than the bare structure, N."""
        bare = self.case.bare.restoring_force(motion)
        fits = (self.method, self.best)
        return [model.restoring_force(motion) - bare for model in fits]

    def damper_errors(self, motion: pd.DataFrame, damper: np.ndarray) -> dict:
        errors, others = [], []
        for force in self.device_forces(motion):
            errors.append(nrmse(damper, force[:, self.device - 1]))
            rest = np.delete(force, self.device - 1, axis=1)
            others.append(np.sqrt((rest**2).mean(axis=0)).max())
        return {
            "damper force, error (%)": errors,
            "storeys without damper (N rms)": others,
        }

    def energy_errors(self, motion: pd.DataFrame, damper: np.ndarray) -> dict:
        rate = motion[f"v{self.device}"]
        true = work(damper, rate)
        errors = []
        for force in self.device_forces(motion):
            errors.append(100 * (work(force[:, self.device - 1], rate) / true - 1))
        return {"energy, error (%)": errors}

    def surface_errors(self, motion: pd.DataFrame, damper: np.ndarray) -> dict:
        i = self.device
        v, s = motion[f"v{i}"], motion[f"s{i}"]
        paper = published.force(self.result.storeys[i], v, s)
        errors = []
        for model in (self.method, self.best):
            errors.append(nrmse(model.restoring_force(motion)[:, i - 1], paper))
        return {"paper's surface, ours from it (%)": errors}


def printed_parameters(
    masses: dict[int, float], storeys: dict[int, tuple[float, float]]
) -> dict[str, float]:
    """Masses, stiffnesses and dampings by name."""
    parameters = {f"m{j}": masses[j] for j in sorted(masses)}
    for i in sorted(storeys):
        k, c = storeys[i]
        parameters |= {f"k{i}": k, f"c{i}": c}
    return parameters


def parameters_of(model: ChainModel) -> dict[str, float]:
    """The same of a model."""
    storeys = {}
    for i in range(1, model.n_dof + 1):
        linear = linear_terms(model, i)
        storeys[i] = (linear["k"], linear["c"])
    return printed_parameters(dict(enumerate(model.masses, 1)), storeys)


def repeat(result: published.Result) -> Repeated:
    """The test of a result of the paper, simulated and fitted."""
    every = "both" in result.title or "all floors" in result.title
    excitation = "complete" if every else "incomplete"
    if len(result.storeys) == 2:
        noise = 0.05 if "%" in result.title else 0.0
        case = cases.two_dof(excitation, noise)
        raw = case.measured.to_features(smooth=False)
        fused = case.measured.to_features(smooth=noise > 0)
        device = 1
    else:
        device = None if "without" in result.title else 4
        damper = None if device is None else cases.FRAME_DAMPER
        case = cases.damped_frame(excitation, 0.002, damper=damper)
        raw = paper_features(case)
        fused = case.measured.to_features()
    if device is None:
        method, _ = fit(*raw, degree=1)
        best, _ = fit(*fused, degree=1)
    else:
        method, _ = fit(*raw, **CUBIC_SERIES)
        best, _ = fit(*fused, **HYSTERETIC[device])
    return Repeated(result, case, method, best, device)


def headline(quick: bool = False) -> pd.DataFrame:
    """Every printed mass, stiffness, damping and figure, beside ours.

    Columns: the paper, ours by its method, at best, the ratio. Its method: least
    squares of the power series on the channels as they are (5 % of the rms where it
    says 5 %), in section 4 with its 1 Hz high-pass and integration at 0.2 % noise. At
    best: the Dahl law, channels fused. The truth is that of the simulation, in section
    4 not the paper's; a storey with a damper has none.
    """
    rows: dict = {}
    for result in published.RESULTS:
        repeated = repeat(result)
        rows |= repeated.parameters() | repeated.figures()
    table = indexed(rows)
    table["ratio"] = table["its method"] / table["paper"]
    table["nearest"] = nearest_to_truth(table)
    return table


def nearest_to_truth(table: pd.DataFrame) -> list[str]:
    """Who is nearest where the paper's simulation is repeated: with two DOFs."""
    values = table[["paper", "its method", "at best"]]
    gaps = values.sub(table["truth"], axis=0).abs().div(table["truth"], axis=0)
    # a thousandth apart is the same
    near = gaps.le(gaps.min(axis=1) + 1e-3, axis=0)
    small = [
        result.equations for result in published.RESULTS if len(result.storeys) == 2
    ]
    words = []
    for (where, _), row in near.iterrows():
        names = row.index[row] if where in small else []
        words.append(", ".join(names))
    return words


def as_markdown(table: pd.DataFrame) -> str:
    """The table for docs/paper.md."""
    shown = table.reset_index(names=["equation, figure", "what"])
    shown = shown.rename(
        columns={"its method": "by its method", "nearest": "nearest to it"}
    )
    for column in ("paper", "by its method", "at best", "truth"):
        shown[column] = [f"{x:.4g}" if np.isfinite(x) else "" for x in shown[column]]
    shown["ratio"] = [f"{x:.3f}" if np.isfinite(x) else "" for x in shown["ratio"]]
    order = ["paper", "by its method", "at best", "ratio", "truth", "nearest to it"]
    return markdown(shown[["equation, figure", "what", *order]])


# -- section 3: the 2-DOF frame ------------------------------------------------


def level_sweep(quick: bool = False) -> pd.DataFrame:
    """m_1 of the noise-free cubic over the force level.

    Beside it how far its polynomials are from (11b) and (16), percent.
    """
    levels = [50, 100, 150, cases.FORCE_LEVEL, 250, 345, 500, 800, 1600]
    if quick:
        levels = [100, cases.FORCE_LEVEL, 345]
    rows = {}
    for level in levels:
        incomplete = []
        for seed in range(1 if quick else 5):
            incomplete.append(cases.first_mass(level, "incomplete", seed))
        rows[level] = {
            "m1 complete": cases.first_mass(level, "complete", 0),
            "m1 incomplete": incomplete[0],
            "lowest seed": min(incomplete),
            "highest seed": max(incomplete),
            "gap to (11b) %": cases.polynomial_gap(level, "complete"),
            "gap to (16) %": cases.polynomial_gap(level, "incomplete"),
        }
    return indexed(rows).rename_axis("rms force (N)")


TWO_DOF_RESULTS = {
    ("complete", 0.0): published.TWO_DOF_COMPLETE,
    ("complete", 0.05): published.TWO_DOF_COMPLETE_NOISY,
    ("incomplete", 0.0): published.TWO_DOF_INCOMPLETE,
    ("incomplete", 0.05): published.TWO_DOF_INCOMPLETE_NOISY,
}


def two_dof(quick: bool = False) -> pd.DataFrame:
    """The four cases: masses, linear terms, force errors, energy, location.

    The paper's numbers beside ours.
    """
    columns = {}
    for (excitation, noise), paper in TWO_DOF_RESULTS.items():
        case = cases.two_dof(excitation, noise)
        columns[excitation, f"{noise:.0%}"] = two_dof_column(case, paper, quick)
    return pd.DataFrame(columns)


def two_dof_column(
    case: cases.Case, paper: published.Result, quick: bool
) -> dict[str, Any]:
    X_exact, _ = exact(case)
    X, F = available(case)
    model, warned = fit(X, F, **CUBIC_SERIES)
    location = located(model, X, F, quick)

    column: dict[str, Any] = {}
    for j in (1, 2):
        column[f"m{j}"] = model.masses_[j - 1]
        column[f"m{j} paper"] = paper.masses.get(j, np.nan)
    for i in (2, 1):
        ours = linear_terms(model, i)
        k, c = paper.storeys[i][:2]
        column |= {f"k{i}": ours["k"], f"k{i} paper": k}
        column |= {f"c{i}": ours["c"], f"c{i} paper": c}
    for name, motion in (("law", X_exact), ("force", X)):
        force = model.restoring_force(motion)
        for i in (1, 2):
            error = nrmse(case.force[:, i - 1], force[:, i - 1])
            column[f"{name} error R{i} (%)"] = error
    column["energy error (%)"] = energy_error(model, X, case, 1)
    for i in (1, 2):
        column[f"index {i} (%)"] = location.first["index"].iloc[i - 1]
    column["damper in"] = ", ".join(location.storeys)
    column["warned"] = warned
    return column


def two_dof_ways(quick: bool = False) -> pd.DataFrame:
    """The 2-DOF frame by the paper's raw least squares and by what the package offers.

    With the paper's noise and ours. Worst mass and stiffness error in percent of the
    truth, that of the law of storey 1 and of the damper's energy.
    """
    rows = {}
    for excitation in EXCITATIONS:
        for name, noise, noise_of in (
            ("none", 0.0, "rms"),
            ("5 % of the mean", 0.05, "mean"),
            ("5 % of the rms", 0.05, "rms"),
        ):
            case = cases.two_dof(excitation, noise, noise_of=noise_of)
            noisy = noise > 0 and noise_of == "rms"
            for way, model in fitted_ways(case, noisy).items():
                rows[excitation, name, way] = two_dof_errors(model, case)
    return indexed(rows, "forces", "noise", "way")


def fitted_ways(case: cases.Case, noisy: bool) -> dict[str, NRFRegressor]:
    """The fits of a case by way; channels without noise are not fused."""
    raw = case.measured.to_features(smooth=False)
    fused = case.measured.to_features(smooth=noisy)
    dahl = HYSTERETIC[1]
    ways = {"cubic, raw least squares (the paper)": fit(*raw, **CUBIC_SERIES)}
    if noisy:
        ways["cubic, fused"] = fit(*fused, **CUBIC_SERIES)
    ways["Dahl law, fused"] = fit(*fused, **dahl)
    if noisy:
        iv = fit(case.measured, None, **dahl, estimation="iv")
        ways["Dahl law, instrumental variables"] = iv
    return {way: model for way, (model, _) in ways.items()}


def two_dof_errors(model: NRFRegressor, case: cases.Case) -> dict[str, float]:
    X, _ = exact(case)
    k1 = linear_terms(model, 1)["k"]
    k2 = linear_terms(model, 2)["k"]
    return numbered("m", model.masses_) | {
        "k1": k1,
        "k2": k2,
        "worst m (%)": np.abs(mass_errors(model, case)).max(),
        "k2 (%)": 100 * (k2 / cases.STIFFNESS - 1),
        "law error R1 (%)": nrmse(case.force[:, 0], model.restoring_force(X)[:, 0]),
        "energy (%)": energy_error(model, X, case, 1),
    }


def second_storey_twice() -> pd.DataFrame:
    """R_2 from both balances (eqs. 10a, 10b), complete and noise-free."""
    X, F = exact(cases.two_dof("complete"))
    ours = cases.found_twice(fit(X, F, **CUBIC_SERIES)[0], X, F)["storey 2"]
    paper = published.TWO_DOF_COMPLETE
    terms = list(published.PRINTED_ORDER)
    ours["paper (10a)"] = pd.Series(paper.storeys[2], terms)
    ours["paper (10b)"] = pd.Series(paper.twins[2], terms)
    return ours


def polynomials(quick: bool = False) -> pd.DataFrame:
    """All coefficients of the 2-DOF cases and the frame, paper and ours."""
    four_storey = cases.four_storey
    linear_complete = four_storey(cases.COMPLETE_FRAME, 0.0)
    linear_incomplete = four_storey(cases.INCOMPLETE_LINEAR, 0.0)
    runs = [
        (published.TWO_DOF_COMPLETE, cases.two_dof("complete"), 3),
        (published.TWO_DOF_INCOMPLETE, cases.two_dof("incomplete"), 3),
        (published.LINEAR_COMPLETE, linear_complete, 1),
        (published.LINEAR_INCOMPLETE, linear_incomplete, 1),
    ]
    if not quick:
        noisy = cases.two_dof("complete", 0.05)
        noisy_incomplete = cases.two_dof("incomplete", 0.05)
        runs[2:2] = [
            (published.TWO_DOF_COMPLETE_NOISY, noisy, 3),
            (published.TWO_DOF_INCOMPLETE_NOISY, noisy_incomplete, 3),
        ]
        runs += [
            (published.FRAME_COMPLETE, four_storey(cases.COMPLETE_FRAME), 3),
            (published.FRAME_INCOMPLETE, four_storey(cases.INCOMPLETE_FRAME), 3),
        ]
    return pd.concat([coefficients(*run) for run in runs])


def coefficients(
    paper: published.Result, case: cases.Case, degree: int
) -> pd.DataFrame:
    """Coefficients of one result of the paper and of ours."""
    model, _ = fit(*available(case), degree=degree)
    tables = []
    for storey, printed in sorted(paper.storeys.items()):
        terms = published.PRINTED_ORDER[: len(printed)]
        ours = model.restoring_forces_[storey].coefficients.reindex(terms)
        table = pd.DataFrame({"paper": printed, "ours": ours})
        levels = [[paper.equations], [f"R{storey}"], table.index]
        tables.append(table.set_axis(pd.MultiIndex.from_product(levels)))
    return pd.concat(tables)


# -- section 4: the four-storey frame ------------------------------------------


def paper_features(case: cases.Case) -> Features:
    """Features by the paper's processing, without the ends that it spoils."""
    X, F = cases.paper_processing(case.measured).to_features(smooth=False)
    edge = int(EDGE * case.measured.fs)
    return X.iloc[edge:-edge], F.iloc[edge:-edge]


def linear_frame(quick: bool = False) -> pd.DataFrame:
    """The frame without its damper, all floors hit, and floor 2; errors in percent.

    Exact, from laboratory channels, and with noise.
    """
    truth = cases.frame_model()
    rows = {}
    for floors, paper in (
        (cases.COMPLETE_FRAME, published.LINEAR_COMPLETE),
        (cases.INCOMPLETE_LINEAR, published.LINEAR_INCOMPLETE),
    ):
        where = hit(floors)
        rows[where, "paper"] = frame_errors(paper.model(), truth)
        for noise in (0.0,) if quick else (0.0, 0.01):
            case = cases.four_storey(floors, 0.0, noise)
            for name, features in processed(case).items():
                model, _ = fit(*features, degree=1)
                rows[where, name] = frame_errors(model.model_, truth)
    return indexed(rows)


def processed(case: cases.Case) -> dict[str, Features]:
    """The data as they are, by the paper's processing and by fusion."""
    ways = {}
    prefix = ""
    if case.noise:
        prefix = f"{case.noise:.0%} noise, "
    else:
        ways["exact"] = exact(case)
    ways[f"{prefix}a, x; paper's velocity"] = paper_features(case)
    ways[f"{prefix}a, x; fused"] = case.measured.to_features()
    return ways


def frame_errors(model: ChainModel, truth: ChainModel) -> dict[str, float]:
    """Errors of masses and stiffnesses, percent."""
    errors = {}
    for j, ratio in enumerate(model.masses / truth.masses, 1):
        errors[f"m{j} (%)"] = 100 * (ratio - 1)
    for i in (1, 2, 3, 4):
        ratio = linear_terms(model, i)["k"] / linear_terms(truth, i)["k"]
        errors[f"k{i} (%)"] = 100 * (ratio - 1)
    return errors


def paper_frame(quick: bool = False) -> pd.DataFrame:
    """Section 4 on the calibrated stand-in: (18) and (22) by cubics and by the law.

    The device is the cubic less the linear model of the frame without it (eq. 21): its
    energy against the true one, and its rms in storeys 1 to 3, where there is none.
    """
    results = (published.FRAME_COMPLETE, published.FRAME_INCOMPLETE)
    rows = {}
    for excitation, paper in zip(EXCITATIONS, results):
        rows[excitation, "paper"] = printed_device(paper)
        for noise in (0.01,) if quick else (0.0, 0.002, 0.01):
            case = cases.damped_frame(excitation, noise)
            bare = cases.damped_frame(excitation, noise, damper=None, random_state=1)
            linear, _ = fit(*available(bare), degree=1)
            for way, options in (
                ("cubic", CUBIC_SERIES),
                ("Dahl law", HYSTERETIC[4]),
            ):
                model, _ = fit(*available(case), **options)
                row = device_row(model, linear, case)
                rows[excitation, f"{way}, {noise:.1%} noise"] = row
        rows[excitation, "truth"] = numbered("m", case.truth.masses)
    return indexed(rows)


def printed_device(paper: published.Result) -> dict[str, float]:
    """What the paper prints of the frame with its device."""
    k, c = paper.storeys[4][:2]
    row = {f"m{j}": paper.masses[j] for j in (1, 2, 3, 4)}
    return row | {"k4": k, "c4": c, "energy": 1.0, "worst rms 1-3": np.nan}


def device_row(
    model: NRFRegressor, linear: NRFRegressor, case: cases.Case
) -> dict[str, float]:
    """Masses, storey 4, and the device's energy and rms."""
    X, _ = exact(case)
    device = model.restoring_force(X) - linear.restoring_force(X)
    energy = work(device[:, 3], X["v4"], case.exact.time)
    true = work(case.damper[:, 3], X["v4"], case.exact.time)
    storey = linear_terms(model, 4)
    return numbered("m", model.masses_) | {
        "k4": storey["k"],
        "c4": storey["c"],
        "energy": energy / true,
        "worst rms 1-3": np.sqrt((device[:, :3] ** 2).mean(axis=0)).max(),
    }


def damped_frame(quick: bool = False) -> pd.DataFrame:
    """A damper of pure friction, noise-free: the cubic's bias and the hysteretic law.

    Mass errors in percent of the truth; "independent": how far the cubic's masses are
    from NumPy's least squares of the same balances, kg; the energy is that of the
    damper.
    """
    levels = cases.LEVELS[1:2] if quick else cases.LEVELS
    rows = {}
    for number, floors in enumerate((cases.COMPLETE_FRAME, cases.INCOMPLETE_FRAME)):
        frictions = cases.FRICTIONS
        if quick:
            frictions = cases.FRICTIONS[number : number + 1]
        for friction in frictions:
            for level in levels:
                key = (hit(floors), f"{friction:.0f} N", f"{level:.0f} N")
                case = cases.four_storey(floors, friction, level=level)
                rows[key] = damped_frame_row(case, quick)
    return indexed(rows, "hit", "damper", "blows")


def damped_frame_row(case: cases.Case, quick: bool) -> dict[str, Any]:
    X, F = exact(case)
    cubic, warned = fit(X, F, **CUBIC_SERIES)
    closed, still_warned = fit(X, F, **HYSTERETIC[4])
    location = located(cubic, X, F, quick)
    dahl = closed.model_.laws["storey 4"][1]
    independent = np.abs(cubic.masses_ - independent_masses(X, F)).max()
    return numbered("cubic m", mass_errors(cubic, case)) | {
        "independent": independent,
        "warned": warned,
        "cubic energy": energy_error(cubic, X, case, 4),
        "Dahl worst m": np.abs(mass_errors(closed, case)).max(),
        "Dahl energy": energy_error(closed, X, case, 4),
        "sigma": dahl.parameters["sigma"],
        "Fd": dahl.parameters["Fd"],
        "still warned": still_warned,
        "damper in": ", ".join(location.storeys),
    }


def damped_frame_lab(quick: bool = False) -> pd.DataFrame:
    """The Dahl law on what a laboratory measures: worst mass and energy error, %.

    These are accelerations and displacements.
    """
    levels = cases.LEVELS[1:2] if quick else cases.LEVELS
    noises = (0.002,) if quick else (0.0, 0.002, 0.01)
    rows = {}
    for floors in (cases.COMPLETE_FRAME, cases.INCOMPLETE_FRAME):
        for friction in cases.FRICTIONS:
            for level in levels:
                key = (hit(floors), f"{friction:.0f} N", f"{level:.0f} N")
                rows[key] = {}
                for noise in noises:
                    case = cases.four_storey(floors, friction, noise, level=level)
                    rows[key] |= lab_errors(case)
    return indexed(rows)


def lab_errors(case: cases.Case) -> dict[str, Any]:
    X, F = case.measured.to_features()
    model, warned = fit(X, F, **HYSTERETIC[4])
    name = f"{case.noise:.1%} noise"
    return {
        f"{name}: m": np.abs(mass_errors(model, case)).max(),
        f"{name}: energy": energy_error(model, X, case, 4),
        f"{name}: warned": warned,
    }


def agreement() -> pd.DataFrame:
    """Models found with all floors hit and with one, on the same motion, percent."""
    X, _ = exact(cases.four_storey(cases.COMPLETE_FRAME, level=500.0))
    cubics = (published.FRAME_COMPLETE, published.FRAME_INCOMPLETE)
    linear = (published.LINEAR_COMPLETE, published.LINEAR_INCOMPLETE)
    complete = exact(cases.four_storey(cases.COMPLETE_FRAME))
    incomplete = exact(cases.four_storey(cases.INCOMPLETE_FRAME))

    pairs = {
        "paper: cubics (18), (22)": [result.model() for result in cubics],
        "paper: linear (20), (23)": [result.model() for result in linear],
    }
    for name, options in (
        ("ours: cubic", CUBIC_SERIES),
        ("ours: Dahl", HYSTERETIC[4]),
    ):
        first, _ = fit(*complete, **options)
        second, _ = fit(*incomplete, **options)
        pairs[name] = [first, second]
    tables = {}
    for name, (first, second) in pairs.items():
        tables[name] = cases.model_agreement(first, second, X)
    return pd.concat(tables)


def masses() -> pd.DataFrame:
    """All printed masses and ours, their totals, and the weighed 51.41 kg."""
    models: dict[str, Any] = {}
    for result in published.RESULTS:
        if len(result.masses) == 4:
            models[f"paper {result.equations}"] = result.model()
    for floors in (cases.COMPLETE_FRAME, cases.INCOMPLETE_FRAME):
        X, F = exact(cases.four_storey(floors))
        test = f"{hit(floors)}, 1000 N, 20 N"
        models[f"cubic, {test}"] = fit(X, F, **CUBIC_SERIES)[0]
        models[f"Dahl law, {test}"] = fit(X, F, **HYSTERETIC[4])[0]
    models["simulated truth"] = cases.frame_model()
    return cases.total_mass(models, published.TOTAL_MASS)


# -- what it is good for -------------------------------------------------------

LOSS = 0.05  # share of a storey's stiffness


def damaged_frame(storey: int, law: laws.ForceLaw) -> ChainModel:
    """The frame with a further law in one storey."""
    frame = cases.frame_model()
    name = f"storey {storey}"
    return frame.with_laws({name: [*frame.laws[name], law]})


def stiffness(storey: int) -> float:
    """True stiffness of a storey, N/m."""
    return float(linear_terms(cases.frame_model(), storey)["k"])


def hammer_test(model: ChainModel | None, seed: int) -> cases.Case:
    """Floor 3 hit, 1 % noise."""
    return cases.four_storey(
        cases.INCOMPLETE_FRAME, 0.0, 0.01, model=model, random_state=seed
    )


def damage(quick: bool = False) -> pd.DataFrame:
    """5 % stiffness loss in one storey between two tests; 0 = nothing happened."""
    before = hammer_test(None, 1).measured
    rows = {}
    for storey in (0, 2) if quick else (0, 1, 2, 3, 4):
        model = None
        if storey:
            loss = laws.LinearElastic(-LOSS * stiffness(storey))
            model = damaged_frame(storey, loss)
        for seed in (2,) if quick else (2, 3):
            after = hammer_test(model, seed).measured
            report = compare_tests(NRFRegressor(degree=1), before, after)
            springs = report.table[report.table["term"] == "k"].set_index("storey")
            change = springs["change"].add_suffix(" (%)")
            rows[storey, seed] = {"found in": ", ".join(report.damaged), **change}
    return indexed(rows, "damaged storey", "seed")


def onset(quick: bool = False) -> pd.DataFrame:
    """5 % stiffness loss within one record; 0 = nothing happened."""
    rows = {}
    for storey in (0, 2) if quick else (0, 1, 2, 3, 4):
        for t0 in (20.7,) if quick else (9.3, 20.7):
            rows[storey, t0] = onset_row(storey, t0)
    return indexed(rows, "damaged storey", "true onset (s)")


def onset_row(storey: int, t0: float) -> dict[str, Any]:
    """What the loop confirms of a loss at a time, s."""
    model = None
    if storey:
        loss = laws.StiffnessStep(t0=t0, dk=-LOSS * stiffness(storey))
        model = damaged_frame(storey, loss)
    report = close_loop(hammer_test(model, 3).measured)
    steps = [step for step in report.steps if step.confirmed]
    effects = "; ".join(f"{step.law} at {step.site}" for step in steps)
    row: dict[str, Any] = {"effects": effects}
    if steps:
        parameters = steps[0].parameters
        low, high = steps[0].intervals.get("t0", (np.nan, np.nan))
        row |= {"onset (s)": parameters.get("t0"), "from": low, "to": high}
        if storey:
            row["change (%)"] = 100 * parameters.get("dk", np.nan) / stiffness(storey)
    return row


# -- all tables ----------------------------------------------------------------


def tables(quick: bool = False) -> dict[str, tuple[str, pd.DataFrame]]:
    """All tables by name, each with its title."""
    return {
        "headline": (
            "the paper, ours by its own method, ours at best",
            headline(quick),
        ),
        "level_sweep": (
            "m1 (kg) and gap to the paper's polynomials over the force level; the"
            " paper has 10.01 and 9.85 kg",
            level_sweep(quick),
        ),
        "two_dof": (f"2-DOF frame at {cases.FORCE_LEVEL:.0f} N rms", two_dof(quick)),
        "second_storey_twice": (
            "R_2 found twice, eqs. (10a) and (10b)",
            second_storey_twice(),
        ),
        "polynomials": (
            "all polynomials, noise-free where the paper's are",
            polynomials(quick),
        ),
        "two_dof_ways": ("2-DOF frame, what noise and what way", two_dof_ways(quick)),
        "paper_frame": ("section 4 on the calibrated stand-in", paper_frame(quick)),
        "linear_frame": (
            "four-storey frame without damper, errors in percent",
            linear_frame(quick),
        ),
        "damped_frame": (
            "four-storey frame with a damper of pure friction (closed-loop case),"
            " errors in percent",
            damped_frame(quick),
        ),
        "damped_frame_lab": (
            "the Dahl law on laboratory channels, fused",
            damped_frame_lab(quick),
        ),
        "masses": (
            "masses (kg) and their total; gap to the weighed 51.41 kg in percent",
            masses(),
        ),
        "agreement": (
            "models found with all floors hit and with one, differences in percent",
            agreement(),
        ),
        "damage": ("5 % stiffness loss between two tests", damage(quick)),
        "onset": ("5 % stiffness loss during a record", onset(quick)),
    }


def main(arguments: list[str] | None = None) -> int:
    """Print all tables."""
    parser = options_of(__doc__, quick="fewer levels, seeds and storeys")
    parser.add_argument("--out", type=Path, help="folder for CSV files")
    parser.add_argument(
        "--markdown",
        action="store_true",
        help="nothing but the table at the top of docs/paper.md",
    )
    options = parser.parse_args(arguments)
    if options.markdown:
        print(as_markdown(headline(options.quick)))
        return 0
    print(
        f'The paper\'s noise: "{published.NOISE_SENTENCE}". Ours: a share of each'
        " channel's rms.\n"
    )
    for name, (title, table) in tables(options.quick).items():
        text = table.to_string(float_format="{:.5g}".format)
        print(f"{title}\n{'-' * len(title)}\n{text}\n")
        write_csv(table, options.out, name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
