"""Public measured sets as records in SI units, for examples, benchmarks and tests.

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
NO_LICENCE = "the set states no licence; ask its authors before you pass it on"
KIP = 4448.2216  # N
INCH = 0.0254  # m
CENTIMETRE = 0.01  # m


# -- the sets ------------------------------------------------------------------


@dataclass(frozen=True)
class MeasuredSet:
    """What was tested, and how to cite and get it.

    ``file`` is the name of the file in the sub-folder of the set.
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
        NO_LICENCE,
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
        NO_LICENCE,
        "nonlinearbenchmark.org",
    ),
    "nees_three_storey": MeasuredSet(
        "Three-storey steel frame on a shaking table",
        "nees_three_storey.npz",
        "A. Masroor, G. Mosqueda, report MCEER-13-0003, University at Buffalo, 2013",
        NO_LICENCE,
        "NEES project, University at Buffalo",
    ),
    "dry_friction_storey": MeasuredSet(
        "One-storey frame whose mass rubs on a frame fixed to the laboratory",
        "dry_friction_storey.npz",
        "C. Lathourakis, A. Cicirello, Nonlinear Dynamics, 2024, doi"
        " 10.1007/s11071-024-09652-2",
        NO_LICENCE,
        "doi 10.1007/s11071-024-09652-2",
    ),
    "mr_damper_white_noise": MeasuredSet(
        "MR damper under white-noise displacement and changing voltage",
        "mr_damper_white_noise.npz",
        "S. Dyke, NEES-2012-1158, doi 10.4231/D3V11VM6X",
        NO_LICENCE,
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
        NO_LICENCE,
        "NEES project, University at Buffalo",
    ),
    "dry_friction_storey_more": MeasuredSet(
        "One-storey frame whose mass rubs on a frame fixed to the laboratory, another"
        " frequency",
        "run_70_83.npz",
        "C. Lathourakis, A. Cicirello, Nonlinear Dynamics, 2024, doi"
        " 10.1007/s11071-024-09652-2",
        NO_LICENCE,
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
        NO_LICENCE,
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
        NO_LICENCE,
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
    """The file of a set, whose name ``parts`` complete.

    Raises
    ------
    NRFError
        If no folder is known, or the folder or the file does not exist.
    """
    root = data_folder(folder)
    measured_set = SETS[name]
    path = root / name / measured_set.file.format(*parts)
    if not path.is_file():
        raise FileFormatError(
            f"{root} does not hold {name}/{path.name}",
            f"Get it from {measured_set.source}.",
        )
    return path


def data_folder(folder: Any) -> Path:
    """The folder of all sets: the one given, or that of the environment variable."""
    if folder is None:
        folder = os.environ.get(VARIABLE)
    if not folder:
        raise NRFError(
            "No folder of measured data is known",
            f"Pass folder=, or set the environment variable {VARIABLE} to what holds"
            " emps/, nees_three_storey/, ...",
        )
    root = Path(folder)
    if not root.is_dir():
        raise NRFError(
            f"The folder of measured data {str(root)!r} does not exist",
            f"Correct folder= or {VARIABLE}.",
        )
    return root


def variables_of(name: str, *parts: str, folder: Any) -> dict[str, Any]:
    """Arrays in the file of a set, by their names there."""
    return read_table(data_file(name, *parts, folder=folder)).variables


# -- one mass ------------------------------------------------------------------


def load_emps(folder: Any = None) -> Record:
    """EMPS, a positioning stage: ``F1`` (N) and ``x1`` (m); 1000 Hz, 24.8 s.

    The force is the drive voltage times 35.1507 N/V; the loop was closed.

    The authors' least-squares model, band-limited to about 20 Hz: mass 95.1089 kg,
    viscous 203.5034 N s/m, Coulomb friction 20.3935 N, offset -3.1648 N. A model
    without friction leaves about 17 % of the force unexplained.
    """
    path = data_file("emps", folder=folder)
    mapping = {"t": "t", "x1": "qm", "F1": "vir*gtau"}
    return read_record(path, mapping=mapping, name="EMPS")


def load_silverbox(folder: Any = None) -> Record:
    """Silverbox: ``F1`` (input) and ``x1`` (output); 610.35 Hz, 131 072 samples.

    VOLTS stand for N and m, so mass and stiffness come out in the circuit's own units.
    A noise burst of growing level, then ten multisines.
    """
    variables = variables_of("silverbox", folder=folder)
    force = variables["V1"].ravel()
    displacement = variables["V2"].ravel()
    return Record(force=force, displacement=displacement, fs=610.35, name="Silverbox")


def load_silverbox_multisine(folder: Any = None) -> Record:
    """Silverbox under ten multisines: ``F1`` and ``x1``; 610.35 Hz, 86 000 samples.

    VOLTS stand for N and m.
    """
    path = data_file("silverbox_multisine", folder=folder)
    mapping = {"x1": "output_V", "F1": "input_V"}
    fs = float(read_table(path).variables["fs"])
    return read_record(path, mapping=mapping, fs=fs, name="Silverbox, multisines")


def load_bouc_wen_benchmark(
    excitation: str = "multisine", folder: Any = None
) -> Record:
    """Bouc-Wen benchmark: ``F1`` (N) and ``x1`` (m) in steady state; 750 Hz.

    ``excitation`` is ``"multisine"`` (8192 samples) or ``"sinesweep"``.

    The truth: m = 2 kg, c = 10 N s/m, k = 5e4 N/m, alpha = 5e4, beta = 1e3, gamma =
    0.8, delta = -1.1, nu = 1.
    """
    channels = {}
    for symbol in "uy":
        variables = variables_of(
            "bouc_wen_benchmark", symbol, excitation, folder=folder
        )
        channels[symbol] = variables[f"{symbol}val_{excitation}"]
    name = f"Bouc-Wen benchmark, {excitation}"
    return Record(force=channels["u"], displacement=channels["y"], fs=750.0, name=name)


def load_dry_friction_storey(folder: Any = None) -> Record:
    """One storey with dry friction: ``x1``, ``xg`` (absolute, m); 2000 Hz, 61 s.

    The displacements of mass and base have the lasers' stand-off as offset. The
    sampling rate is that of the sample count (the logged time is rounded to single
    precision). The friction acts on the ABSOLUTE velocity of the mass, not on the
    storey's. No force acts; a known mass scales the chain.
    """
    path = data_file("dry_friction_storey", folder=folder)
    return _dry_friction_run(path, "run_60_52", fs=2000.0)


def load_dry_friction_storey_more(folder: Any = None) -> Record:
    """As :func:`load_dry_friction_storey`, run 70.83; 500 Hz, 55 s."""
    path = data_file("dry_friction_storey_more", folder=folder)
    return _dry_friction_run(path, "run_70_83", fs=500.0)


def _dry_friction_run(path: Path, run: str, fs: float) -> Record:
    mapping = {"xg": f"{run}[:, 1] @ mm", "x1": f"{run}[:, 2] @ mm"}
    name = f"dry friction {run}"
    return read_record(path, mapping=mapping, fs=fs, name=name, coordinates="absolute")


# -- frames and buildings ------------------------------------------------------

# tests in the second file of the frame
MORE_NEES_TESTS = ("fbgm152s3", "fbgm152s4", "fpgm171s3")


def load_nees_three_storey(test: str = "fbgm162s5", folder: Any = None) -> Record:
    """A frame on a shaking table: ``x1`` to ``x3``, ``xg``, ``ag``; 256 Hz, 42 to 45 s.

    Displacements are absolute (m), ``ag`` is in m/s^2.

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
    for floor in (1, 2, 3):
        mapping[f"x{floor}"] = f"{test}[:, {floor + 2}] @ in"
    return _nees_test(test, mapping, folder)


def load_nees_isolated(test: str = "fpgm111s1", folder: Any = None) -> Record:
    """The frame on friction-pendulum bearings: ``x1`` to ``x4`` (absolute, m), ``ag``.

    fpgm111s1 or fpgm171s3. The isolated level is DOF 1, the floors are DOFs 2 to 4; of
    the table only the acceleration is measured.
    """
    mapping = {"t": f"{test}[:, 0]", "ag": f"{test}[:, 1] @ g"}
    for level in (1, 2, 3, 4):
        mapping[f"x{level}"] = f"{test}[:, {level + 1}] @ in"
    return _nees_test(test, mapping, folder)


def _nees_test(test: str, mapping: dict[str, str], folder: Any) -> Record:
    name = "nees_more" if test in MORE_NEES_TESTS else "nees_three_storey"
    path = data_file(name, folder=folder)
    return read_record(path, mapping=mapping, name=test, coordinates="absolute")


def load_six_storey_hotel(event: int = 1, folder: Any = None) -> Record:
    """A hotel in an earthquake: ``a``, ``v``, ``x`` of two floors, ``xg``; 50 Hz.

    Motions are absolute, in SI units; events 1 to 21. The zero-padded tail is cut off.
    The instrumented floors are not neighbours: "storey 2" spans several. No force acts;
    a known mass scales the chain.
    """
    variables = variables_of("six_storey_hotel", folder=folder)
    last_motions = []
    for name in ("disp", "acc"):
        moves = np.any(variables[name][event - 1] != 0, axis=-1)
        last_motions.append(np.flatnonzero(moves)[-1])
    n_samples = max(last_motions) + 1

    def channel(name: str) -> np.ndarray:
        values = variables[name][event - 1, :n_samples]
        return CENTIMETRE * values.astype(float)

    return Record(
        acceleration=channel("acc"),
        velocity=channel("vel"),
        displacement=channel("disp"),
        base_displacement=channel("ground_disp"),
        fs=float(variables["fs"]),
        coordinates="absolute",
        name=f"hotel, event {event}",
    )


def load_tower_with_mass_driver(folder: Any = None) -> Record:
    """A tower with a mass driver: ``a1`` to ``a5``, ``x1`` and ``F5``, all in VOLTS.

    The force is minus the acceleration of the driver. The rate of 100 Hz is assumed.
    The driver's calibration is not certain: nothing should be claimed from this record.
    """
    variables = variables_of("tower_with_mass_driver", folder=folder)
    table = variables["wn_01"].astype(float)
    force = np.zeros((len(table), 5))
    force[:, 4] = -table[:, 1]
    displacement = np.full((len(table), 5), np.nan)
    displacement[:, 0] = table[:, 7]
    return Record(
        force=force,
        acceleration=table[:, [4, 5, 6, 3, 2]],
        displacement=displacement,
        fs=100.0,
        name="tower",
    )


def load_three_storey_frf(folder: Any = None) -> FrequencyResponse:
    """Accelerance of floors 1 to 3, force on floor 1; 0.03125 Hz steps to 128 Hz.

    Useful from 4 to 32 Hz. Linear, three floors of equal mass, 5.201 kg by its
    metadata; the scale of the responses is not stated, so the masses are judged against
    each other.
    """
    return read_frf(data_file("three_storey_frf", folder=folder), excited=1)


# -- dampers and connections ---------------------------------------------------


def load_mr_damper_white_noise(folder: Any = None) -> Record:
    """An MR damper: ``x1`` (m), ``F1`` (N) and ``voltage`` (V); 3004.8 Hz, 24.6 s.

    The measured force IS the restoring force: a chain of one DOF without inertia,
    ``massless=True``. ``voltage`` is a covariate. The file's velocity was derived from
    its displacement (it loses 6 % at 80 Hz) and is left out; so is the actuator's
    acceleration, whose unit is not stated.
    """
    path = data_file("mr_damper_white_noise", folder=folder)
    mapping = {"x1": "displacement_cm @ cm", "F1": "force_N", "voltage": "voltage"}
    fs = float(read_table(path).variables["fs"])
    return read_record(path, mapping=mapping, fs=fs, name="MR damper, white noise")


def load_mr_damper_random_voltage(folder: Any = None) -> Record:
    """The same damper: ``x1`` (m), ``F1`` (N), ``voltage`` (V); 3004.8 Hz, 20 s.

    The load cell clips at 4545 N in the last second.
    """
    path = data_file("mr_damper_random_voltage", folder=folder)
    mapping = {"t": "none", "x1": "D @ cm", "F1": "F", "voltage": "Y"}
    name = "MR damper, random voltage"
    return read_record(path, mapping=mapping, fs=3004.8, name=name)


def mr_damper_cyclic_runs(folder: Any = None) -> tuple[str, ...]:
    """Names of the runs of :func:`load_mr_damper_cyclic`."""
    return tuple(variables_of("mr_damper_cyclic", folder=folder))


def load_mr_damper_cyclic(run: str = "ensaio.A.1", folder: Any = None) -> Record:
    """An MR damper in cycles: ``x1`` (m) and ``F1`` (N); 100 Hz, 7.5 to 30 s.

    Without inertia as :func:`load_mr_damper_white_noise`; the offset of the load cell
    is in the force and calls for a constant in the law.
    """
    path = data_file("mr_damper_cyclic", folder=folder)
    mapping = {"t": f"{run}[:, 0]", "x1": f"{run}[:, 1] @ mm", "F1": f"{run}[:, 2]"}
    return read_record(path, mapping=mapping, name=f"MR damper {run}")


def friction_damper_runs(folder: Any = None) -> tuple[str, ...]:
    """Names of the runs of :func:`load_friction_damper`."""
    return tuple(variables_of("friction_damper_with_backlash", folder=folder))


def load_friction_damper(
    run: str = "2Hz30lbtension0.5amplitude", folder: Any = None
) -> Record:
    """A friction damper with backlash: ``x1`` (m) and ``F1`` (N); 1024 Hz.

    By itself, without inertia; 3.5 to 27 s.
    """
    variables = variables_of("friction_damper_with_backlash", folder=folder)
    table = variables[run].astype(float)
    displacement = INCH * table[:, 1]
    force = KIP * table[:, 2]
    return Record(force=force, displacement=displacement, fs=1024.0, name=run)


def load_timber_connection(folder: Any = None) -> Record:
    """A connection in quasi-static cycles: ``x1`` (m), ``F1`` (N); 33 028 samples.

    Without inertia. The test has no clock.
    """
    path = data_file("timber_connection_cyclic", folder=folder)
    mapping = {"x1": "displacement_mm @ mm", "F1": "force_kN @ kN"}
    record = read_record(path, mapping=mapping, fs=1.0, name="timber connection")
    return Record(
        force=record.force, displacement=record.displacement, name=record.name
    )
