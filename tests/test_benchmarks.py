"""The quick settings of the benchmarks run, and what they claim of accuracy holds."""

import contextlib
import importlib
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path
from unittest.mock import patch

import discrepancy_battery
import measured
import noise
import numpy as np
import pandas as pd
import pytest
from battery.generators import make_case

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
pytestmark = pytest.mark.examples


def run(script: str, *options: str) -> str:
    """Output of a benchmark, called in this process."""
    with (
        io.StringIO() as printed,
        contextlib.redirect_stdout(printed),
        patch.dict(os.environ),
        warnings.catch_warnings(),
    ):
        code = importlib.import_module(script).main(list(options))
        text = printed.getvalue()
    failed = isinstance(code, int) and code != 0
    assert not failed, text[-2000:]
    return text


def run_alone(script: str, *options: str) -> str:
    """Output of a benchmark that measures its process, on one core."""
    one_core = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / f"{script}.py"), *options],
        capture_output=True,
        text=True,
        env={**os.environ, **one_core},
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout


def lines_with(text: str, words: str) -> list[str]:
    return [line for line in text.splitlines() if words in line]


def test_free_runs_of_other_forces_are_close_or_said():
    printed = run("free_runs", "--quick")
    (linear,) = lines_with(printed, "| linear |")
    assert float(linear.split("|")[3]) < 1.0
    (far_off,) = lines_with(printed, "chain ")
    assert far_off.startswith("chain 36, cubic") and far_off.endswith(", said")


@pytest.mark.slow
def test_no_row_of_the_foundation_fails():
    printed = run("foundation", "--quick")
    assert not lines_with(printed, "| FAIL |")
    assert len(lines_with(printed, "| PASS |")) >= 58
    assert printed.count("\n## ") + printed.startswith("## ") == 9


METHODS = (
    "pysindy_nrf",
    "lstsq per DOF",
    "LinearRegression",
    "SINDy, same terms",
    "SINDy, plain",
    "FROLS",
)


@pytest.fixture(scope="module")
def speed(tmp_path_factory):
    """Printed text and written table of the benchmark of speed."""
    table = tmp_path_factory.mktemp("speed") / "speed.csv"
    printed = run_alone("speed", "--quick", "--out", str(table))
    return printed, table.read_text()


@pytest.mark.slow
def test_the_speed_table_compares_all(speed):
    _, table = speed
    for method in METHODS:
        assert len(lines_with(table, method)) == 2, method


@pytest.mark.slow
def test_speed_loses_no_digit_and_no_memory(speed):
    printed, _ = speed
    exact = lines_with(printed, "QR reference") + lines_with(printed, "memory")
    verdicts = [line.split("|")[-2].strip() for line in exact if line.count("|") > 2]
    assert verdicts.count("PASS") == 5
    assert "MISS" not in verdicts


@pytest.mark.slow
def test_a_pair_of_each_kind_is_judged_right():
    rows = [line.split() for line in run("damage", "--quick").splitlines()[1:10]]
    shares = {row[0]: row[-2:] for row in rows}
    assert shares["changes"] == ["100.0", "100.0"]
    assert shares["nothing"] == ["100.0", "100.0"]


@pytest.mark.slow
def test_careless_measurements_are_named_and_clean_ones_are_not():
    printed = run("careless", "--quick", "--jobs", "1")
    assert "2 clean records, 0 accused" in printed
    missed = int(printed.split(" faults, ")[1].split()[0])
    assert missed <= 1


@pytest.mark.slow
def test_no_ordinary_mistake_is_silent_and_no_clean_test_is_accused():
    printed = run("verdicts", "--quick")
    (silent,) = lines_with(printed, "green, off and not named")
    (accused,) = lines_with(printed, "| accused, of 5 clean tests")
    assert silent.endswith("| 0.0% | PASS |")
    assert accused.endswith("| 0.0% | PASS |")
    for kind in ("missing brace", "Newmark data", "Rayleigh damping", "clean, base"):
        assert len(lines_with(printed, f"| {kind} |")) == 1, kind


@pytest.mark.slow
def test_the_loop_claims_no_mistake_that_is_not_there():
    printed = run("loop_on_mistakes", "--quick")
    (gain,) = lines_with(printed, "| gain of a floor |")
    assert gain.split("|")[3].strip() == "1"
    assert printed.rstrip().endswith("Another claim, or green and off:")


def test_unusual_loads_accuse_nothing_and_hide_nothing():
    printed = run("unusual_loads", "--quick")
    (counts,) = lines_with(printed, "| all |")
    assert counts == "| all | 2 | 0 | 0 | 0 | 2 |"


def test_a_case_of_the_verdicts_runs_again():
    printed = run("verdicts", "--case", "reversed sign", "1")
    assert printed.startswith('--case "reversed sign" 1: red')
    assert "RED: " in printed


@pytest.mark.slow
def test_intervals_under_narrow_excitation_hold_the_truth():
    chosen = ("--chains", "first mode only", "--estimations", "auto")
    printed = run("interval_coverage", "--quick", "--jobs", "1", *chosen)
    (row,) = lines_with(printed, "| 3 DOFs")
    mass = float(row.split("|")[4].split()[0])
    assert mass > 80


def test_promises_are_printed_beside_what_was_measured():
    parts = ("intervals", "detection")
    printed = run("promises", "--part", *parts, "--runs", "1", "--jobs", "1")
    assert "| all | 1 | 92 to 98 |" in printed


def worst_mass_error(printed: str, method: str) -> float:
    """First number of a method's row, in percent."""
    (row,) = [x for x in printed.splitlines() if x.split("  ")[0] == method]
    columns = [column for column in row.split("  ")[1:] if column]
    return float(columns[0].split()[0])


@pytest.mark.slow
def test_instruments_recover_masses_that_raw_channels_lose(capsys):
    options = "--seconds 4 --seeds 1 --repetitions 2 --jobs 1 --only".split()
    for title in ("hammer", "intervals", "frequency response"):
        noise.main([*options, title])
    printed = capsys.readouterr().out
    assert worst_mass_error(printed, "ls, raw channels") > 20
    assert worst_mass_error(printed, "iv") < 3


def test_estimates_stay_above_the_cramer_rao_bound_and_near_it():
    """Weighted instruments: within three of the smallest standard deviations."""
    errors = [
        noise.quietly(noise.errors_of_test, "5 %, hammer", "iv", seed)
        for seed in range(2)
    ]
    of_masses = np.array(errors)[:, : noise.N]
    bound = noise.cramer_rao("5 %, hammer", 0)[: noise.N].mean()
    assert 0.3 < np.sqrt(np.mean(of_masses**2)) / bound < 3.0


@pytest.mark.slow
def test_measured_records_are_searched_without_a_band():
    """One effect of one damper and of two cyclic runs."""
    measured.folder("mr_damper_cyclic")
    printed = run("measured_records", "--quick")
    rows = lines_with(printed, "no claim raises the held-out error")
    assert rows
    assert all(row.endswith("| PASS |") for row in rows)
    assert "## mr_cyclic, 2 runs" in printed
    assert "refused" not in printed


@pytest.mark.slow
def test_public_records_by_defaults_stand_beside_published_numbers():
    """Silverbox within 1 % of its output, the mass of EMPS within 1 % of 95.11 kg."""
    for name in ("silverbox_multisine", "emps"):
        measured.folder(name)
    printed = run("published", "--quick", "silverbox", "emps")
    silverbox = lines_with(printed, "| Silverbox |")[0].split("|")
    assert float(silverbox[5]) < 1.0
    mass = printed.partition("EMPS, trained on all")[2].partition("m1")[2].split()[0]
    assert abs(float(mass) / 95.1089 - 1) < 0.01


def test_the_effect_of_a_damper_test_makes_all_others_better():
    measured.folder("friction_damper_with_backlash")
    printed = run("other_tests", "--quick")
    assert "first effects: 1, better on other tests 1" in printed
    assert "further effects: 0" in printed


@pytest.mark.slow
def test_half_of_a_record_shows_the_effect_of_the_whole():
    measured.folder("friction_damper_with_backlash")
    assert "Kept: 1 of 1" in run("robustness", "--quick")


def test_the_battery_counts_only_confirmed_claims():
    table = pd.DataFrame(
        {
            "steps": [2, 1, 0],
            "claims": [1, 1, 0],
            "names right": [1, 0, 0],
            "sure": [1, 0, 0],
            "sure right": [1, 0, 0],
            "false": [0, 1, 0],
            "second record": [True, True, False],
        }
    )
    right, sure, unconfirmed, false = discrepancy_battery.certainty(table)
    assert "100.0 % of 1" in right
    assert "100.0 % of 1" in sure
    assert unconfirmed.endswith("1 of 3")
    assert false.endswith("1 of 2 (in 1 of 3 cases)")


def test_the_battery_draws_the_groups_that_are_asked_for():
    three = discrepancy_battery.specifications("three", 2, 1)[1]
    assert len(set(three["kinds"])) == 3
    assert three["noise"] == 0.01

    alone = discrepancy_battery.specifications("acceleration", 2, 1)[1]
    case = make_case(**alone, n_samples=2048, largest=3)
    assert set(case.searched[0]) == {"fs", "acceleration", "force"}
    assert len(case.forced) == 1
    assert case.noise == 0.005


def test_a_filter_with_known_first_values_finds_the_masses():
    (row,) = lines_with(run("filter_comparison", "--quick"), "| cubic")
    for column in row.split("|")[3:5]:
        assert float(column.split(",")[0]) < 1


@pytest.mark.slow
def test_masses_and_terms_beside_pysindy_are_printed():
    assert run("pysindy_table", "--quick").count("| roof | 2 % |") == 7


@pytest.mark.slow
def test_a_sensor_on_top_identifies_a_linear_chain():
    """Without noise to 1e-6, with half a percent of it to two percent."""
    printed = run("fewer_sensors", "--quick", "--runs", "1")
    rows = [line for line in printed.splitlines() if line.startswith("linear")]
    assert len(rows) == 4
    worst = {}
    for row in rows:
        level = row.split("%")[0].split()[-1]
        worst[level] = float(row.split("median")[1].split()[0])
        assert "no interval, 0 of" in row
    assert worst["0"] < 1e-4
    assert worst["0.5"] < 2


@pytest.mark.slow
def test_changes_in_time_are_followed_where_they_are_and_only_there():
    rows = {}
    for line in run("time_varying", "--quick").splitlines():
        for what in ("right storey", "instants within", "constant called", "amplitude"):
            if line.strip().startswith(what):
                rows[what] = float(line.split(")")[1].split()[0])
    assert rows["right storey"] == 100
    assert rows["instants within"] == 100
    assert rows["constant called"] == 0
    assert rows["amplitude"] == 100
