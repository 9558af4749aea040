"""Every bad input gets an error that names the channel and the cure, or a warning; never a silent number."""

from __future__ import annotations

import re

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest

from pysindy_nrf import Chain, NRFRegressor, Record, laws
from pysindy_nrf.exceptions import BiasWarning, NRFError

CASE = chains.duffing(3, [2], seed=1, n_samples=1500)
X, F = CASE.X, CASE.F
NAMES = [f"{kind}{j}" for kind in "avs" for j in range(1, 4)]
TABLE = pd.DataFrame(X, columns=NAMES)
TIME = np.arange(1500) * 1e-3
MEMORY = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=1e3)]}


def changed(array, rows, column, value):
    out = np.array(array, dtype=float)
    out[rows, column] = value
    return out


def fit(X=X, F=F, params=None, **options):
    return lambda: NRFRegressor(**(params or {})).fit(X, F, **options)


SHUFFLED = np.random.default_rng(0).permutation(1500)

FIT = {
    # the columns
    "one column short": (fit(X[:, :8]), "8 columns, a multiple of 3 is needed", "a1, a2"),
    "columns for another chain": (fit(params={"chain": Chain(4)}), "9 columns, 12 are needed", "a4"),
    "no columns": (fit(X[:, :0]), "X has no samples|0 columns", ""),
    "no samples": (fit(X[:0], F[:0]), "no samples", "at least as many"),
    "one sample": (fit(X[:1], F[:1]), "1 samples are too few for the balance of DOF 2, which has 19 unknowns", "lower degree"),
    "fewer samples than unknowns": (fit(X[:19], F[:19]), "19 samples are too few", "lower degree"),
    "a single number": (fit(3.0), "0 dimensions", "one row per sample"),
    "a cube": (fit(X[None]), "3 dimensions", "one row per sample"),
    "text": (fit("data.csv"), "0 dimensions", ""),
    "nothing": (fit(None), "0 dimensions", ""),
    "complex": (fit(X + 0j), "Channel a1 .* is complex", ".real"),
    "words in a column": (fit(TABLE.assign(v2="high")), "Channel v2 .* does not hold numbers", "Convert it"),
    "decimal commas": (fit(TABLE.assign(s3=[f"0,{i}" for i in range(1500)])), "Channel s3 .* does not hold numbers", "decimal point"),
    "dates in a column": (fit(TABLE.assign(a1=pd.date_range("2024", periods=1500))), "Channel a1 .* does not hold numbers|unknown", ""),
    "unknown column": (fit(TABLE.assign(voltage=1.0)), "unknown column voltage", "covariates .* are passed beside X"),
    "missing column": (fit(TABLE.drop(columns="v2")), "lacks v2", "Name the columns a1.., v1.., s1.."),
    "absolute names for relative motion": (fit(TABLE.rename(columns={"s1": "x1", "s2": "x2", "s3": "x3"})), "lacks s1, s2, s3", "unknown column"),
    "column twice": (fit(TABLE.set_axis([*NAMES[:-1], "s2"], axis=1)), "'s2' is in X more than once", "Rename or drop"),
    "two-level columns": (fit(TABLE.set_axis(pd.MultiIndex.from_product([["x"], NAMES]), axis=1)), "lacks a1", "Name the columns"),
    "numbered columns": (fit(pd.DataFrame(X)), "lacks a1", "Name the columns"),
    # the samples
    "NaN inside": (fit(changed(X, [700, 701], 4, np.nan)), "Channel v2 is NaN in rows 700, 701", "Split the record there"),
    "infinity": (fit(changed(X, 700, 8, np.inf)), "Channel s3 is infinite in row 700", "Repair or cut"),
    "infinity at the edge": (fit(changed(X, 0, 0, -np.inf)), "Channel a1 is infinite in row 0", "Repair or cut"),
    "many NaN": (fit(changed(X, slice(300, 900, 2), 3, np.nan)), "Channel v1 is NaN in rows 300, 302, 304 and 297 more", "Split"),
    "dead from the middle": (fit(changed(X, slice(None), 5, np.nan)), "Channel v3 holds nothing but NaN", "Leave it out"),
    "masked samples": (fit(np.ma.masked_array(X, np.isclose(X, X[80, 7]))), "Channel s2 is NaN in row 80", "Split"),
    "nothing left between the edges": (
        fit(changed(changed(X, slice(0, 800), 0, np.nan), slice(700, 1500), 1, np.nan)), "no row is finite in every channel", "Check the edges",
    ),
    "constant displacement": (fit(changed(X, slice(None), 6, 1e-3)), "Channel s1 is constant", "dead sensor"),
    "constant velocity": (fit(changed(X, slice(None), 4, 0.0)), "Channel v2 is constant", "dead sensor"),
    "dead accelerometer": (fit(changed(X, slice(None), 2, 0.0)), "Channel a3 is constant", "dead sensor"),
    "a structure at rest": (fit(0 * X), "Channel a1 is constant", "not excited"),
    "beyond the range of a double": (fit(X, F * 1e180), "leave the range of a double", "units"),
    # the forces
    "all-zero force": (fit(F=0 * F), "No force is measured and no mass is known", "known_masses"),
    "no force": (fit(F=None), "No force is measured", "known_masses"),
    "force unknown everywhere": (fit(F=np.nan * F), "No force is measured", "known_masses"),
    "forces of another chain": (fit(F=F[:, :2]), "forces F have 2 columns, 3 are needed", "F1, F2, F3"),
    "one force for three floors": (fit(F=F[:, 1]), "forces F have 1 columns", "F1, F2, F3"),
    "unequal lengths": (fit(F=F[:-7]), "F has 1493 samples, X has 1500", "same clock"),
    "gap in the force": (fit(F=changed(F, 77, 1, np.nan)), "Channel F2 is NaN in row 77", "Split"),
    "infinite force": (fit(F=changed(F, 77, 1, np.inf)), "Channel F2 is infinite in row 77", "Repair"),
    "unknown force names": (fit(F=pd.DataFrame(F, columns=["hammer", "b", "c"])), "F has the columns hammer, b, c", "Name them F1, F2, F3"),
    "forces sorted otherwise": (fit(TABLE, pd.DataFrame(F, columns=["F1", "F2", "F3"]).iloc[::-1]), "same labels in another order", "Sort both"),
    "force as text": (fit(F="F.csv"), "0 dimensions", ""),
    # clock, records, further channels
    "time runs backwards": (fit(time=TIME[::-1]), "does not increase after row 0", "record= ids"),
    "time stands still": (fit(time=np.where(np.arange(1500) == 8, TIME[7], TIME)), "does not increase after row 7", "Sort|sort"),
    "stacked records without ids": (fit(np.vstack([X, X]), np.vstack([F, F]), time=np.tile(TIME, 2)), "does not increase after row 1499", "record= ids"),
    "time with NaN": (fit(time=changed(TIME[:, None], 5, 0, np.nan)[:, 0]), "time is not finite in row 5", "Repair"),
    "time too short": (fit(time=TIME[:-1]), "time has 1499 values", "one time for each"),
    "ids too few": (fit(record=[1, 2]), "record has 2 ids", "one id for each"),
    "ids with gaps": (fit(record=np.where(TIME > 1, np.nan, 1.0)), "record has no id in rows 1001", "one id for each"),
    "base acceleration too short": (fit(base_acceleration=np.zeros(3)), "base_acceleration has 3 samples", "same clock"),
    "base acceleration lost": (fit(base_acceleration=np.full(1500, np.nan)), "base_acceleration holds nothing but NaN", "Leave it out"),
    "covariate with NaN": (fit(covariates={"volt": np.where(TIME == TIME[9], np.nan, 1)}), "covariate volt is NaN in row 9", "Split|fill"),
    "covariate missing": (fit(params={"laws": {1: [laws.PowerSeries(1), laws.CovariateFriction("volt")]}}), "needs the covariate 'volt'", "covariates="),
    "shuffled rows, a law with memory": (fit(X[SHUFFLED], F[SHUFFLED], {"laws": MEMORY, "dt": 1e-3}), "s1 does not move the way its rate v1 points", "keep the samples"),
    "interleaved records, a law with memory": (fit(params={"laws": MEMORY, "dt": 1e-3}, record=np.arange(1500) % 2), "rows of a record do not follow", "never shuffle"),
    "a moving base without its motion": (
        fit(CASE.absolute, params={"coordinates": "absolute"}, base_acceleration=np.sin(TIME)), "needs the columns xdot0 and x0", "relative to the ground",
    ),
    "force beside records": (fit(Record(F, CASE.a, fs=1e3), F), "F was given beside records", "Leave F out"),
    "ids beside records": (fit(Record(F, CASE.a, fs=1e3), None, record=np.zeros(1500)), "record was given beside records", "Leave record out"),
    # parameters
    **{
        f"degree {degree!r}": (fit(params={"degree": degree}), "is not a whole number|is not a box", "Give")
        for degree in (2.5, -1, True, "3", None, (1, 2, 3), (1, -2), [3])
    },
    "degree 0 finds no storey": (fit(params={"degree": 0}), "m3 cannot be found", "hit floor 3"),
    "order of a storey that is not there": (fit(params={"orders": {"storey 7": 2}}), "'storey 7' does not exist", "storey 1, storey 2, storey 3"),
    "orders that are no mapping": (fit(params={"orders": "storey 2"}), "orders='storey 2' is not a mapping", "orders={"),
    "orders and laws at one storey": (fit(params={"orders": {1: 2}, "laws": MEMORY}), "storey 1 has an order and laws", "not in both"),
    "law that is none": (fit(params={"laws": {"storey 1": ["dahl"]}}), "'dahl', which is not a force law", "pysindy_nrf.laws"),
    "law as a class": (fit(params={"laws": {"storey 1": laws.Dahl}}), "not a force law", "pysindy_nrf.laws"),
    "laws that are no mapping": (fit(params={"laws": [laws.Dahl()]}), "is not a mapping", "laws={"),
    "the same term twice": (fit(params={"laws": {1: [laws.PowerSeries(3), laws.Duffing()]}}), "both hold the term 's'", "leave one out"),
    "law at a sensor": (fit(params={"laws": {"sensor a2": laws.LinearElastic()}}), "not a place for a force law", "storey"),
    "known mass of no DOF": (fit(params={"known_masses": {4: 1.0}}), "known_masses names DOF 4", "DOFs 1 to 3"),
    "known mass below zero": (fit(params={"known_masses": {1: -4.0}}), "is not a mass", "kg"),
    "known mass NaN": (fit(params={"known_masses": {1: np.nan}}), "is not a mass", "kg"),
    "known mass as text": (fit(params={"known_masses": {1: "ten"}}), "'ten' is not a mass", "kg"),
    "known masses as a list": (fit(params={"known_masses": [10, 12]}), "is not a mapping", "known_masses={"),
    "unknown strategy": (fit(params={"strategy": "parallel"}), "strategy='parallel'", "auto, complete, sequential, joint"),
    "complete without the forces": (fit(params={"strategy": "complete"}), "none is measured on DOF 1, 3", "sequential"),
    "unknown coordinates": (fit(params={"coordinates": "polar"}), "coordinates='polar'", "'relative' or 'absolute'"),
    "unknown estimation": (fit(params={"estimation": "magic"}), "estimation='magic'", "ls"),
    "chain that is none": (fit(params={"chain": 3}), "chain=3 is not a Chain", r"Chain\(3"),
    "optimizer that is none": (fit(params={"optimizer": "STLSQ"}), "'STLSQ' is not an optimizer", "instance"),
    "optimizer as a class": (fit(params={"optimizer": ps.STLSQ}), "is not an optimizer", "instance"),
    "band without a clock": (fit(params={"band": (1, 50)}), "band= needs the sampling step", "dt="),
    "band above Nyquist": (fit(params={"band": (1, 900), "dt": 1e-3}), "not below the Nyquist frequency 500 Hz", "Lower it"),
    "band upside down": (fit(params={"band": (50, 1), "dt": 1e-3}), "is empty", "lo < hi"),
    "band that is none": (fit(params={"band": 40, "dt": 1e-3}), "not a pair", r"\(lo, hi\)"),
    "band on an uneven clock": (fit(params={"band": (1, 50)}, time=TIME + (TIME > 0.6995)), "step changes after row 699", "Split"),
    **{f"dt {dt!r}": (fit(params={"dt": dt}), "is not a sampling step", "positive") for dt in (0, -1e-3, np.nan, np.inf, "1 ms", True)},
}  # fmt: skip


@pytest.mark.parametrize("kind", FIT)
def test_fit_names_the_channel_and_the_cure(kind):
    make, what, cure = FIT[kind]
    with pytest.raises(NRFError) as caught:
        make()
    message = str(caught.value)
    assert re.search(what, message), message
    assert re.search(cure, message), message


def rec(**channels):
    options = {"fs": 1e3} | channels
    return lambda: Record(**options)


a = CASE.a

RECORD = {
    "no motion": (rec(force=F), "has no motion", "acceleration, velocity or displacement"),
    "no clock": (rec(acceleration=a, fs=None), "has no clock", "fs="),
    **{f"fs {fs!r}": (rec(acceleration=a, fs=fs), "is not a sampling rate", "Hz") for fs in (0, -10, np.nan, "fast")},
    "fs and a time, fs wrong": (rec(acceleration=a, fs="fast", time=TIME), "is not a sampling rate", "Hz"),
    "fs contradicts the time": (rec(acceleration=a, fs=500.0, time=TIME), "contradicts the time, which has 1000 Hz", "Leave one out"),
    "unequal lengths": (rec(acceleration=a, force=F[:-1]), "acceleration 1500, force 1499", "one clock"),
    "unequal widths": (rec(acceleration=a, force=F[:, :2]), "acceleration has 3 columns, force has 2", "one column for each DOF"),
    "one sample": (rec(acceleration=a[:1]), "has 1 samples", "two"),
    "NaN inside": (rec(acceleration=changed(a, 9, 1, np.nan), name="run 4"), "a2 of record 'run 4' is NaN in row 9", "Split"),
    "infinity": (rec(acceleration=a, base_acceleration=np.where(TIME == TIME[3], np.inf, 0)), "ag .* is infinite in row 3", "Repair"),
    "time repeats": (rec(acceleration=a, fs=None, time=np.maximum(TIME, TIME[4])), "stands still after row 0", "drop repeated"),
    "time reversed": (rec(acceleration=a, fs=None, time=TIME[::-1]), "runs backwards after row 0", "Sort"),
    "gap in the time": (rec(acceleration=a, fs=None, time=TIME + (TIME > 0.5)), "clock is uneven, 1.001 s after row 500", "Split|resample"),
    "jitter": (rec(acceleration=a, fs=None, time=TIME + 4e-4 * np.random.default_rng(0).uniform(size=1500)), "clock is uneven", "resample"),
    "unknown coordinates": (rec(acceleration=a, coordinates="local"), "coordinates='local'", "relative"),
    "covariate of another length": (rec(acceleration=a, covariates={"volt": [1, 2]}), "covariate volt 2", "one clock"),
    "a table without motions": (lambda: Record.from_frame(pd.DataFrame({"t": TIME, "load": 0.0})), "No column of .* is a motion", "a1.."),
    "a table with a channel twice": (lambda: Record.from_frame(TABLE.set_axis([*NAMES[:-1], "v1"], axis=1), fs=1e3), "'v1' is in the table more than once", "Rename"),
    "two spellings of one channel": (
        lambda: Record.from_frame(pd.DataFrame({"a1": a[:, 0], "A_1": a[:, 1]}), fs=1e3), "both mean a1", "Rename or drop",
    ),
    "rows with a step": (lambda: rec(acceleration=a)().rows(slice(0, 100, 2)), "not a part", "consecutive"),
    "rows that are not there": (lambda: rec(acceleration=a)().rows(slice(9000, 9100)), "not a part", "consecutive"),
    "a window outside": (lambda: rec(acceleration=a)().window(50, 60), "no samples from 50 to 60 s", "lasts from 0 to 1.499 s"),
    "features without velocity": (lambda: rec(acceleration=a)().to_features(smooth=False), "lacks v1, x1", "smooth=True"),
}  # fmt: skip


@pytest.mark.parametrize("kind", RECORD)
def test_records_name_the_channel_and_the_cure(kind):
    make, what, cure = RECORD[kind]
    with pytest.raises(NRFError) as caught:
        make()
    message = str(caught.value)
    assert re.search(what, message), message
    assert re.search(cure, message), message


WARNED = {
    "force with the wrong sign": (fit(F=-F), "m2 = -.* is not positive"),
    "acceleration with the wrong sign": (fit(changed(X, slice(None), 1, -X[:, 1])), "m2|balance of DOF 2|Balance of DOF 2"),
    "two drifts swapped": (fit(X[:, [0, 1, 2, 3, 4, 5, 6, 8, 7]]), "likely biased"),
    "a channel copied from another": (fit(changed(X, slice(None), 2, X[:, 1])), "likely biased"),
    "displacement in mm, clipped": (fit(np.hstack([X[:, :6], np.clip(X[:, 6:], -2e-4, 2e-4)])), "likely biased"),
    "absolute given as relative": (fit(CASE.absolute), "likely biased"),
    "acceleration delayed by 3 ms": (fit(np.hstack([np.roll(X[:, :3], 3, axis=0), X[:, 3:]])), "likely biased"),
    "too low a degree": (fit(params={"degree": 1}), "likely biased"),
}


@pytest.mark.parametrize("kind", WARNED)
def test_what_can_still_be_computed_is_warned_of(kind):
    make, what = WARNED[kind]
    with pytest.warns(BiasWarning, match=what):
        make()


def test_wrong_input_to_predict(chain4):
    model = NRFRegressor(degree=3).fit(X, F)
    for bad, message in [(chain4.X, "12 columns, 9 are needed"), (changed(X, 70, 3, np.nan), "v1 is NaN in row 70"), (TABLE.drop(columns="s3"), "lacks s3")]:
        with pytest.raises(NRFError, match=message):
            model.predict(bad)
        with pytest.raises(NRFError, match=message):
            model.score(bad, F)
    with pytest.raises(NRFError, match="needs the sampling step of F"):
        model.simulate(F)


def test_an_unfitted_model_says_so():
    from sklearn.exceptions import NotFittedError

    for call in (lambda m: m.predict(X), lambda m: m.score(X, F), lambda m: m.modes(), lambda m: m.simulate(F, dt=1e-3)):
        with pytest.raises(NotFittedError):
            call(NRFRegressor())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: laws.PowerSeries(3, [1, 2]), "9 coefficients, 2 were given"),
        (lambda: laws.PowerSeries(1, {"c_9_9": 1.0}), "no coefficient 'c_9_9'"),
        (lambda: laws.Dahl(sigma=-1.0), "sigma=-1 is not positive"),
        (lambda: laws.Dahl(sigma=np.nan), "not a finite number"),
        (lambda: laws.Duffing(k="stiff"), "not a finite number"),
        (lambda: laws.Dahl().with_values(shape={"tau": 1.0}), "no shape parameter 'tau'"),
        (lambda: laws.from_dict({"law": "magic"}), "no law 'magic'"),
        (lambda: laws.from_dict({"law": "power_series", "options": {"order": 3}}), "cannot be built"),
        (lambda: laws.from_dict(3), "does not describe a law"),
        (lambda: laws.CovariateFriction(""), "not the name of a channel"),
    ],
)
def test_laws_refuse_in_words(make, message):
    with pytest.raises(NRFError, match=message):
        make()


def test_the_battery_is_large_enough():
    assert len(FIT) + len(RECORD) + len(WARNED) >= 100
