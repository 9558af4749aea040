"""The quick settings of the benchmarks run from end to end, and what they claim of
accuracy holds.
"""

import contextlib
import importlib
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path
from unittest.mock import patch

import measured
import numpy as np
import pandas as pd
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
import discrepancy_battery  # noqa: E402
import noise  # noqa: E402
from battery.generators import make_case  # noqa: E402

pytestmark = pytest.mark.examples


def run(script: str, *options: str) -> str:
    """Output of a benchmark, called in this process."""
    with (
        io.StringIO() as said,
        contextlib.redirect_stdout(said),
        patch.dict(os.environ),
        warnings.catch_warnings(),
    ):
        code = importlib.import_module(script).main(list(options))
        assert not isinstance(code, int) or code == 0, said.getvalue()[-2000:]
        return said.getvalue()


def run_alone(script: str, *options: str) -> str:
    """Output of a benchmark that measures time and memory of its process, on one
    core.
    """
    one_core = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / f"{script}.py"), *options],
        capture_output=True,
        text=True,
        env=one_core,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


def test_no_row_of_the_foundation_fails():
    lines = run("foundation", "--quick").splitlines()
    assert not [line for line in lines if line.endswith("| FAIL |")]
    assert sum(line.startswith("## ") for line in lines) == 9
    assert sum(line.endswith("| PASS |") for line in lines) >= 58


def test_the_speed_table_compares_all_and_loses_no_digit(tmp_path):
    table = tmp_path / "speed.csv"
    verdicts = [
        line
        for line in run_alone("speed", "--quick", "--out", str(table)).splitlines()
        if line.rstrip().endswith(("PASS |", "MISS |"))
    ]
    exact = [line for line in verdicts if "QR reference" in line or "memory" in line]
    assert len(exact) == 5 and not [line for line in exact if "MISS" in line], exact
    rows = table.read_text().splitlines()
    for by in (
        "pysindy_nrf",
        "lstsq per DOF",
        "LinearRegression",
        "SINDy, same terms",
        "SINDy, plain",
        "FROLS",
    ):
        assert sum(by in row for row in rows) == 2, by


@pytest.mark.slow
def test_a_pair_of_each_kind_is_judged_right():
    said = run("damage", "--quick").splitlines()
    found = {line.split()[0]: line.split()[-2:] for line in said[1:10]}
    assert found["changes"] == found["nothing"] == ["100.0", "100.0"]


def test_careless_measurements_are_named_and_clean_ones_left_in_peace():
    said = run("careless", "--quick", "--jobs", "1")
    assert (
        "2 clean records, 0 accused" in said
        and int(said.split(" faults, ")[1].split()[0]) <= 1
    )


def test_promises_are_printed_beside_what_was_measured():
    said = run(
        "promises", "--part", "intervals", "detection", "--runs", "1", "--jobs", "1"
    )
    assert "| 95 % intervals that hold the truth | all | 1 | 92 to 98 |" in said


def test_instruments_recover_masses_that_raw_channels_lose(capsys):
    for part in ("hammer", "intervals", "frequency response"):
        noise.main(
            [
                "--seconds",
                "4",
                "--seeds",
                "1",
                "--repetitions",
                "2",
                "--jobs",
                "1",
                "--only",
                part,
            ]
        )
    rows = {
        line.split("  ")[0]: line.split("  ")
        for line in capsys.readouterr().out.splitlines()
    }
    raw, iv = (
        float(next(x for x in rows[name][1:] if x).split()[0])
        for name in ("ls, raw channels", "iv")
    )
    assert iv < 3 < 20 < raw


def test_estimates_stay_above_the_cramer_rao_bound_and_near_it():
    """Weighted instruments for the masses: within three of the smallest standard
    deviations there can be.
    """
    found = np.array(
        [
            noise.quietly(noise.errors_of_test, "5 %, hammer", "iv", seed)
            for seed in range(2)
        ]
    )
    ratio = (
        np.sqrt(np.mean(found[:, : noise.N] ** 2))
        / noise.cramer_rao("5 %, hammer", 0)[: noise.N].mean()
    )
    assert 0.3 < ratio < 3.0


def test_measured_records_are_searched_without_a_band():
    """One effect of one damper and of two cyclic runs; what the checks find is for the
    reader, not for this test.
    """
    measured.folder("mr_damper_cyclic")
    said = run("measured_records", "--quick")
    assert "| no claim raises the held-out error | none does | PASS |" in said
    assert "## mr_cyclic, 2 runs" in said and "refused" not in said


def test_half_of_a_record_holds_the_effect_of_the_whole():
    measured.folder("friction_damper_with_backlash")
    assert "Kept: 1 of 1" in run("robustness", "--quick")


def test_garbage_in_held_out_records_changes_nothing_of_the_search():
    said = run("heldout_garbage", "--quick")
    assert "| nothing | PASS |" in said and "FAIL" not in said


def test_the_battery_says_what_sure_names_are_worth():
    """What is not confirmed is no claim; groups of three effects and of accelerations
    alone are drawn as asked.
    """
    table = pd.DataFrame(
        {
            "steps": [2, 1, 0],
            "claims": [1, 1, 0],
            "names right": [1, 0, 0],
            "sure": [1, 0, 0],
            "sure right": [1, 0, 0],
        }
    )
    right, sure, unconfirmed = discrepancy_battery.certainty(table)
    assert (
        "100.0 % of 1" in right
        and "100.0 % of 1" in sure
        and unconfirmed.endswith("1 of 3")
    )
    three, alone = (
        discrepancy_battery.specifications(g, 2, 1)[1]
        for g in ("three", "acceleration")
    )
    assert len(set(three["kinds"])) == 3 and three["noise"] == 0.01
    case = make_case(**alone, n_samples=2048, most=3)
    assert (
        set(case.seen[0]) == {"fs", "acceleration", "force"}
        and len(case.forced) == 1
        and case.noise == 0.005
    )


def test_a_filter_that_is_told_first_values_finds_the_masses():
    (line,) = [
        line
        for line in run("filter_comparison", "--quick").splitlines()
        if line.startswith("| cubic")
    ]
    assert all(float(part.split(",")[0]) < 1 for part in line.split("|")[3:5])


def test_masses_and_terms_beside_pysindy_are_printed():
    assert run("pysindy_table", "--quick").count("| roof | 2 % |") == 7


def test_a_sensor_on_top_tells_a_linear_chain():
    """Without noise to 1e-6, at half a percent of it to two percent (worst
    parameter).
    """
    lines = [
        line
        for line in run("fewer_sensors", "--quick", "--runs", "1").splitlines()
        if line.startswith("linear")
    ]
    worst = {
        line.split("%")[0].split()[-1]: float(line.split("median")[1].split()[0])
        for line in lines
    }
    assert len(lines) == 4 and worst["0"] < 1e-4 and worst["0.5"] < 2
    assert all("no interval, 0 of" in line for line in lines)
