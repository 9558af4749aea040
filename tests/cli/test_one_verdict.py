"""One file has one verdict: by a fit, by the loop, and by the command line."""

import json

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.cli import run
from pysindy_nrf.records.files import read_record
from pysindy_nrf.simulation import add_noise

FS = 250.0


def measured(unmeasured=0.0, gain=1.0):
    """A linear frame with a force that nobody measured, or a wrong accelerometer."""
    storey = [laws.LinearElastic(3e4), laws.LinearViscous(30.0)]
    model = ChainModel([10.0, 8.0], {1: storey, 2: storey})
    F = excitation.band_limited_random(
        2, 16.0, FS, excited=[1, 2], rms=100.0, band=(0.5, 30.0), random_state=3
    )
    t = np.arange(len(F)) / FS
    harmonic = unmeasured * np.sin(2 * np.pi * 6.5 * t)
    exact = simulate(model, F + np.outer(harmonic, [0, 1]), 1 / FS, hold="cubic")
    record = add_noise(exact.replace(force=F, velocity=None), 0.005, random_state=3)
    return record.replace(acceleration=record.acceleration * [1.0, gain])


def file_of(record, path):
    columns = {"t": np.arange(record.n_samples) / FS} | record.channels()
    pd.DataFrame(columns).to_csv(path, index=False)
    return str(path)


def verdict_of(command, file, folder, capsys):
    """The verdict of a command, as its JSON has it."""
    options = ["--degree", "1", "--json", "--no-figures", "-o", str(folder / command)]
    assert run([command, file, *options]) in (0, 4)
    return json.loads(capsys.readouterr().out)["verdict"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "state"),
    [({}, "green"), ({"gain": 1.15}, "amber"), ({"unmeasured": 60.0}, "amber")],
)
def test_a_file_has_one_verdict(fault, state, tmp_path, capsys):
    file = file_of(measured(**fault), tmp_path / "test.csv")
    record = read_record(file)
    fit = NRFRegressor(degree=1).fit(record).verdict()
    report = close_loop(record)
    assert verdict_of("identify", file, tmp_path, capsys)["reasons"] == list(
        fit.reasons
    )
    assert verdict_of("run", file, tmp_path, capsys)["reasons"] == list(
        report.verdict.reasons
    )

    assert fit.state == state
    if not report.steps:
        # the same model has the same reasons, whoever found it
        assert report.verdict.state == state
        places = {(ground.kind, ground.place) for ground in fit.grounds}
        of_loop = {(ground.kind, ground.place) for ground in report.verdict.grounds}
        assert places == of_loop
