"""Public measured sets as records in SI units, for the examples, the benchmarks and the
tests.

The files are read from a folder with one sub-folder for each set: ``folder=``, or the
environment variable ``PYSINDY_NRF_DATA``. Nothing is downloaded.
``print(measured_sets.SETS["emps"])`` gives citation, terms and source; EMPS, Silverbox
and Bouc-Wen also come with ``pip install nonlinear-benchmarks``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pysindy_nrf import Record
from pysindy_nrf.exceptions import FileFormatError, NRFError
from pysindy_nrf.records.files import read_frf, read_record, read_table
from pysindy_nrf.records.files.frequency_response import FrequencyResponse

VARIABLE = "PYSINDY_NRF_DATA"
_NONE = "the set states no licence; ask its authors before you pass it on"


@dataclass(frozen=True)
class MeasuredSet:
    """What was tested, the file in the set's sub-folder, how to cite it, its terms and
    where to get it.
    """

    title: str
    file: str
    citation: str
    terms: str
    source: str

    def __str__(self) -> str:
        return (
            f"{self.title}\n  Cite: {self.citation}\n  Terms: {self.terms}\n  From:"
            f" {self.source}"
        )


SETS = {
    "emps": MeasuredSet(
        "Electro-mechanical positioning stage: one DOF, position and drive",
        "DATA_EMPS.mat",
        "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS,"
        " Workshop on Nonlinear System Identification Benchmarks, Eindhoven, 2019",
        _NONE,
        "nonlinearbenchmark.org",
    ),
    "silverbox": MeasuredSet(
        "Electronic Duffing oscillator",
        "SNLS80mV.mat",
        "T. Wigren, J. Schoukens, Three free data sets for development and benchmarking"
        " in nonlinear system identification, European Control Conference, 2013,"
        " 2933-2938",
        "published as a free data set; no licence is stated",
        "nonlinearbenchmark.org",
    ),
    "bouc_wen_benchmark": MeasuredSet(
        "One DOF with a Bouc-Wen hysteresis, simulated and noise-free",
        "{}val_{}.mat",
        "J. P. Noel, M. Schoukens, Hysteretic benchmark with a dynamic nonlinearity,"
        " Workshop on Nonlinear System Identification Benchmarks, Brussels, 2016",
        _NONE,
        "nonlinearbenchmark.org",
    ),
    "nees_three_storey": MeasuredSet(
        "Three-storey steel frame on a shaking table",
        "nees_three_storey.npz",
        "A. Masroor, G. Mosqueda, report MCEER-13-0003, University at Buffalo, 2013",
        _NONE,
        "NEES project, University at Buffalo",
    ),
    "dry_friction_storey": MeasuredSet(
        "One-storey frame whose mass rubs on a frame fixed to the laboratory",
        "dry_friction_storey.npz",
        "C. Lathourakis, A. Cicirello, Nonlinear Dynamics, 2024, doi"
        " 10.1007/s11071-024-09652-2",
        _NONE,
        "doi 10.1007/s11071-024-09652-2",
    ),
    "mr_damper_white_noise": MeasuredSet(
        "MR damper under white-noise displacement and changing voltage",
        "mr_damper_white_noise.npz",
        "S. Dyke, NEES-2012-1158, doi 10.4231/D3V11VM6X",
        _NONE,
        "doi 10.4231/D3V11VM6X",
    ),
    "mr_damper_cyclic": MeasuredSet(
        "MR damper under cyclic displacement, 82 runs",
        "labcontrol_mr_all_float32.npz",
        "A. N. Vargas, doi 10.5281/zenodo.4445334",
        "MIT licence, Copyright (c) 2021 Labcontrol",
        "doi 10.5281/zenodo.4445334",
    ),
    "six_storey_hotel": MeasuredSet(
        "Six-storey hotel in San Bernardino in 21 earthquakes",
        "san_bernardino_float32.npz",
        "R. Zhang, Y. Liu, H. Sun, Physics-guided convolutional neural network (PhyCNN)"
        " for data-driven seismic response modeling, Engineering Structures, 2020",
        "MIT licence",
        "github.com/zhry10/PhyCNN",
    ),
    "silverbox_multisine": MeasuredSet(
        "Electronic Duffing oscillator, ten random-phase multisines",
        "multisine.npz",
        "T. Wigren, J. Schoukens, Three free data sets for development and benchmarking"
        " in nonlinear system identification, European Control Conference, 2013,"
        " 2933-2938",
        "published as a free data set; no licence is stated",
        "nonlinearbenchmark.org",
    ),
    "nees_more": MeasuredSet(
        "Three-storey steel frame on a shaking table, other motions",
        "nees_more.npz",
        "A. Masroor, G. Mosqueda, report MCEER-13-0003, University at Buffalo, 2013",
        _NONE,
        "NEES project, University at Buffalo",
    ),
    "dry_friction_storey_more": MeasuredSet(
        "One-storey frame whose mass rubs on a frame fixed to the laboratory, another"
        " frequency",
        "run_70_83.npz",
        "C. Lathourakis, A. Cicirello, Nonlinear Dynamics, 2024, doi"
        " 10.1007/s11071-024-09652-2",
        _NONE,
        "doi 10.1007/s11071-024-09652-2",
    ),
    "friction_damper_with_backlash": MeasuredSet(
        "Banded rotary friction damper by itself: four sinusoidal tests and an"
        " earthquake",
        "brfd.npz",
        "ARTS-Laboratory, University of South Carolina, banded rotary friction damper",
        "CC BY-SA 4.0",
        "ARTS-Laboratory",
    ),
    "mr_damper_random_voltage": MeasuredSet(
        "MR damper under random displacement and random voltage",
        "ransim_u.npz",
        "S. Dyke, NEES-2012-1158, doi 10.4231/D3V11VM6X",
        _NONE,
        "doi 10.4231/D3V11VM6X",
    ),
    "timber_connection_cyclic": MeasuredSet(
        "Connection of cross-laminated timber, quasi-static cycles",
        "spc1.npz",
        "C. Slotboom, hysteresis (Python package)",
        "Apache 2.0",
        "pypi.org/project/hysteresis",
    ),
    "tower_with_mass_driver": MeasuredSet(
        "Five-storey tower under white noise from a hybrid mass driver",
        "wn_01.npz",
        "UNISON tower, 2008",
        _NONE,
        "the set states no source",
    ),
    "three_storey_frf": MeasuredSet(
        "Three-storey aluminium frame, shaker on floor 1: frequency responses",
        "cristallo_Experimental.csv",
        "University of Southampton, digital twin of a three-storey frame, 2020",
        "BSD 3-clause licence",
        "University of Southampton",
    ),
}


def data_file(name: str, *parts: str, folder: Any = None) -> Path:
    """The file of a set, whose name ``parts`` complete; NRFError if it is not there."""
    named = folder if folder is not None else os.environ.get(VARIABLE)
    if not named:
        raise NRFError(
            "No folder of measured data is known",
            f"Pass folder=, or set the environment variable {VARIABLE} to what holds"
            " emps/, nees_three_storey/, ...",
        )
    root, known = Path(named), SETS[name]
    if not root.is_dir():
        raise NRFError(
            f"The folder of measured data {str(root)!r} does not exist",
            f"Correct folder= or {VARIABLE}.",
        )
    path = root / name / known.file.format(*parts)
    if not path.is_file():
        raise FileFormatError(
            f"{root} does not hold {name}/{path.name}", f"Get it from {known.source}."
        )
    return path


def load_emps(folder: Any = None) -> Record:
    """EMPS: ``F1`` (N, drive voltage times 35.1507 N/V) and ``x1`` (m); 1000 Hz, 24.8
    s, measured in closed loop.

    The authors' least-squares model, band-limited to about 20 Hz: mass 95.1089 kg,
    viscous 203.5034 N s/m, Coulomb friction 20.3935 N, offset -3.1648 N. A model
    without friction leaves about 17 % of the force unexplained.
    """
    return read_record(
        data_file("emps", folder=folder),
        mapping={"t": "t", "x1": "qm", "F1": "vir*gtau"},
        name="EMPS",
    )


def load_silverbox(folder: Any = None) -> Record:
    """Silverbox: ``F1`` (input) and ``x1`` (output), VOLTS standing for N and m; 610.35
    Hz, 131 072 samples.

    A noise burst of growing level, then ten multisines. Mass and stiffness come out in
    the circuit's own units.
    """
    held = read_table(data_file("silverbox", folder=folder)).variables
    return Record(
        force=held["V1"].ravel(),
        displacement=held["V2"].ravel(),
        fs=610.35,
        name="Silverbox",
    )


def load_silverbox_multisine(folder: Any = None) -> Record:
    """Silverbox: ``F1`` and ``x1``, VOLTS standing for N and m, of ten multisines;
    610.35 Hz, 86 000 samples.
    """
    path = data_file("silverbox_multisine", folder=folder)
    fs = float(read_table(path).variables["fs"])
    return read_record(
        path,
        mapping={"x1": "output_V", "F1": "input_V"},
        fs=fs,
        name="Silverbox, multisines",
    )


def load_bouc_wen_benchmark(
    excitation: str = "multisine", folder: Any = None
) -> Record:
    """``F1`` (N) and ``x1`` (m) of a steady-state ``"multisine"`` (8192 samples) or a
    ``"sinesweep"``; 750 Hz.

    The truth: m = 2 kg, c = 10 N s/m, k = 5e4 N/m, alpha = 5e4, beta = 1e3, gamma =
    0.8, delta = -1.1, nu = 1.
    """
    force, displacement = (
        read_table(
            data_file("bouc_wen_benchmark", k, excitation, folder=folder)
        ).variables[f"{k}val_{excitation}"]
        for k in "uy"
    )
    return Record(
        force=force,
        displacement=displacement,
        fs=750.0,
        name=f"Bouc-Wen benchmark, {excitation}",
    )


def load_nees_three_storey(test: str = "fbgm162s5", folder: Any = None) -> Record:
    """``x1``..``x3``, ``xg`` (absolute, m) and ``ag`` (m/s^2) of a frame under base
    excitation; 256 Hz, 42 to 45 s.

    fbgm162s1, fbgm162s3, fbgm162s5: fixed base, one ground motion of rising intensity
    (the frame is close to linear in s1 and yields in s5). fbgm152s3, fbgm152s4: another
    motion. The publishers low-passed the channels at 25 Hz. The floors' masses are
    about equal (not stated); one known mass scales the chain.
    """
    mapping = {
        "t": f"{test}[:, 0]",
        "ag": f"{test}[:, 1] @ g",
        "xg": f"{test}[:, 2] @ in",
    }
    mapping |= {f"x{j}": f"{test}[:, {j + 2}] @ in" for j in (1, 2, 3)}
    return read_record(
        _nees_file(test, folder), mapping=mapping, name=test, coordinates="absolute"
    )


def load_nees_isolated(test: str = "fpgm111s1", folder: Any = None) -> Record:
    """The frame on friction-pendulum bearings: base level ``x1``, floors ``x2``..``x4``
    (absolute, m), table ``ag``.

    fpgm111s1 or fpgm171s3. The isolated level is DOF 1; of the table only the
    acceleration is measured.
    """
    mapping = {"t": f"{test}[:, 0]", "ag": f"{test}[:, 1] @ g"}
    mapping |= {f"x{j}": f"{test}[:, {j + 1}] @ in" for j in (1, 2, 3, 4)}
    return read_record(
        _nees_file(test, folder), mapping=mapping, name=test, coordinates="absolute"
    )


def _nees_file(test: str, folder: Any) -> Path:
    """The file that holds a test of the frame."""
    more = test in ("fbgm152s3", "fbgm152s4", "fpgm171s3")
    return data_file("nees_more" if more else "nees_three_storey", folder=folder)


def load_dry_friction_storey(folder: Any = None) -> Record:
    """``x1``, ``xg`` (absolute displacement of mass and base, m) with the lasers'
    stand-off as offset; 2000 Hz, 61 s.

    The sampling rate is that of the sample count (the logged time is rounded to single
    precision). The friction acts on the ABSOLUTE velocity of the mass, not on the
    storey's. No force acts; a known mass scales the chain.
    """
    return read_record(
        data_file("dry_friction_storey", folder=folder),
        mapping={"xg": "run_60_52[:, 1] @ mm", "x1": "run_60_52[:, 2] @ mm"},
        fs=2000.0,
        name="dry friction run_60_52",
        coordinates="absolute",
    )


def load_dry_friction_storey_more(folder: Any = None) -> Record:
    """As :func:`load_dry_friction_storey`, run 70.83; 500 Hz, 55 s."""
    run = "run_70_83"
    return read_record(
        data_file("dry_friction_storey_more", folder=folder),
        mapping={"xg": f"{run}[:, 1] @ mm", "x1": f"{run}[:, 2] @ mm"},
        fs=500.0,
        name=f"dry friction {run}",
        coordinates="absolute",
    )


def load_mr_damper_white_noise(folder: Any = None) -> Record:
    """``x1`` (m), ``F1`` (N) and the covariate ``voltage`` (V) of a damper by itself;
    3004.8 Hz, 24.6 s.

    The measured force IS the restoring force: a chain of one DOF without inertia,
    ``massless=True``. The file's velocity was derived from its displacement (it loses 6
    % at 80 Hz) and is left out; so is the actuator's acceleration, whose unit is not
    stated.
    """
    path = data_file("mr_damper_white_noise", folder=folder)
    mapping = {"x1": "displacement_cm @ cm", "F1": "force_N", "voltage": "voltage"}
    return read_record(
        path,
        mapping=mapping,
        fs=float(read_table(path).variables["fs"]),
        name="MR damper, white noise",
    )


def load_mr_damper_random_voltage(folder: Any = None) -> Record:
    """``x1`` (m), ``F1`` (N) and the covariate ``voltage`` (V) of the same damper;
    3004.8 Hz, 20 s.

    The load cell clips at 4545 N in the last second.
    """
    return read_record(
        data_file("mr_damper_random_voltage", folder=folder),
        mapping={"t": "none", "x1": "D @ cm", "F1": "F", "voltage": "Y"},
        fs=3004.8,
        name="MR damper, random voltage",
    )


def friction_damper_runs(folder: Any = None) -> tuple[str, ...]:
    """Names of the runs of :func:`load_friction_damper`."""
    return tuple(
        read_table(data_file("friction_damper_with_backlash", folder=folder)).variables
    )


def load_friction_damper(
    run: str = "2Hz30lbtension0.5amplitude", folder: Any = None
) -> Record:
    """``x1`` (m) and ``F1`` (N) of a friction damper with backlash by itself, without
    inertia; 1024 Hz, 3.5 to 27 s.
    """
    path = data_file("friction_damper_with_backlash", folder=folder)
    table = read_table(path).variables[run].astype(float)
    return Record(
        force=4448.2216 * table[:, 2],
        displacement=0.0254 * table[:, 1],
        fs=1024.0,
        name=run,
    )  # kip, in


def load_timber_connection(folder: Any = None) -> Record:
    """``x1`` (m) and ``F1`` (N) of a connection under quasi-static cycles, without
    inertia; 33 028 samples.

    The test has no clock.
    """
    mapping = {"x1": "displacement_mm @ mm", "F1": "force_kN @ kN"}
    path = data_file("timber_connection_cyclic", folder=folder)
    read = read_record(path, mapping=mapping, fs=1.0, name="timber connection")
    return Record(force=read.force, displacement=read.displacement, name=read.name)


def load_tower_with_mass_driver(folder: Any = None) -> Record:
    """``a1``..``a5`` and ``x1`` of a tower, as ``F5`` minus the driver's acceleration,
    all in VOLTS.

    The rate of 100 Hz is assumed. The driver's calibration is not certain: nothing
    should be claimed from this record.
    """
    table = (
        read_table(data_file("tower_with_mass_driver", folder=folder))
        .variables["wn_01"]
        .astype(float)
    )
    force, displacement = np.zeros((len(table), 5)), np.full((len(table), 5), np.nan)
    force[:, 4], displacement[:, 0] = -table[:, 1], table[:, 7]
    acceleration = table[:, [4, 5, 6, 3, 2]]
    return Record(
        force=force,
        acceleration=acceleration,
        displacement=displacement,
        fs=100.0,
        name="tower",
    )


def mr_damper_cyclic_runs(folder: Any = None) -> tuple[str, ...]:
    """Names of the runs of :func:`load_mr_damper_cyclic`."""
    return tuple(read_table(data_file("mr_damper_cyclic", folder=folder)).variables)


def load_mr_damper_cyclic(run: str = "ensaio.A.1", folder: Any = None) -> Record:
    """``x1`` (m) and ``F1`` (N, raw load cell with its offset) of a damper by itself;
    100 Hz, 7.5 to 30 s.

    Without inertia as :func:`load_mr_damper_white_noise`; the load cell's offset calls
    for a constant in the law.
    """
    mapping = {"t": f"{run}[:, 0]", "x1": f"{run}[:, 1] @ mm", "F1": f"{run}[:, 2]"}
    return read_record(
        data_file("mr_damper_cyclic", folder=folder),
        mapping=mapping,
        name=f"MR damper {run}",
    )


def load_six_storey_hotel(event: int = 1, folder: Any = None) -> Record:
    """``a``, ``v``, ``x`` of the two instrumented floors and ``xg`` of the ground,
    absolute, SI; 50 Hz; events 1 to 21.

    The zero-padded tail is cut off. The instrumented floors are not neighbours: "storey
    2" spans several. No force acts; a known mass scales the chain.
    """
    held = read_table(data_file("six_storey_hotel", folder=folder)).variables
    moving = [
        np.flatnonzero(np.any(held[k][event - 1] != 0, axis=-1))[-1]
        for k in ("disp", "acc")
    ]
    acceleration, velocity, displacement, ground = (
        0.01 * held[k][event - 1, : max(moving) + 1].astype(float)
        for k in ("acc", "vel", "disp", "ground_disp")
    )  # from cm
    return Record(
        acceleration=acceleration,
        velocity=velocity,
        displacement=displacement,
        base_displacement=ground,
        fs=float(held["fs"]),
        coordinates="absolute",
        name=f"hotel, event {event}",
    )


def load_three_storey_frf(folder: Any = None) -> FrequencyResponse:
    """Accelerance of floors 1 to 3, force on floor 1; 0.03125 Hz steps to 128 Hz,
    useful from 4 to 32 Hz.

    Linear, three floors of equal mass, 5.201 kg by its metadata; the scale of the
    responses is not stated, so the masses are judged against each other.
    """
    return read_frf(data_file("three_storey_frf", folder=folder), excited=1)
