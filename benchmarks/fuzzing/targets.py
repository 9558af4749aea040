"""What is fuzzed: each reader, with small good files to damage."""

from __future__ import annotations

import copy
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

N = 40
TIME = np.arange(N) / 100.0
WAVE = np.column_stack([np.sin(9 * TIME), np.cos(7 * TIME), 0.1 * TIME])
MAX_BYTES = 100_000_000


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes
    ----------
    name : str
    suffix : str
        Of the files it is given.
    read : callable
        Path -> anything; only typed errors may leave it.
    seeds : callable
        () -> list of bytes: good files, written when asked for.
    text : bool
        Whether the damage is done to text.
    """

    name: str
    suffix: str
    read: Callable[[Path], Any]
    seeds: Callable[[], list[bytes]]
    text: bool = False


# -- good files ----------------------------------------------------------------


def record() -> Any:
    from pysindy_nrf import Record

    motion = WAVE[:, :2]
    return Record(
        motion,
        -80 * motion,
        None,
        motion,
        fs=100.0,
        covariates={"volt": WAVE[:, 2]},
        name="a test",
    )


def table() -> pd.DataFrame:
    columns = {"t": TIME, "a1": WAVE[:, 0], "x1": WAVE[:, 1], "F1": WAVE[:, 2]}
    return pd.DataFrame(columns)


def written(suffix: str) -> bytes:
    """The record as the package writes it."""
    from pysindy_nrf.records.files import write_record

    with tempfile.TemporaryDirectory() as folder:
        path = write_record(record(), Path(folder, f"test{suffix}"))
        return Path(path).read_bytes()


def saved(write: Callable, *arguments: Any, **options: Any) -> bytes:
    """What a function writes to a file, its first argument."""
    buffer = io.BytesIO()
    write(buffer, *arguments, **options)
    return buffer.getvalue()


def delimited_texts() -> list[bytes]:
    channels = table()
    german = channels.set_axis(["t [ms]", "Acc 1 [g]", "x1 [mm]", "F1 [kN]"], axis=1)
    german_text = german.to_csv(index=False, sep=";", decimal=",")
    logged = f"# made by a logger\n# 40 Hz\n\n{german_text}"
    stamps = pd.date_range("2024-05-01", periods=N, freq="10ms").astype(str)
    stamped = channels.assign(t=stamps)
    return [
        channels.to_csv(index=False).encode(),
        logged.encode("utf-8-sig"),
        channels.to_csv(index=False, sep="\t").encode("utf-16"),
        channels.to_string(index=False).encode(),
        stamped.to_csv(index=False, sep="|").encode(),
        written(".csv"),
    ]


def numpy_archives() -> list[bytes]:
    single = WAVE[:, 0].astype(np.float32)
    return [
        saved(np.savez, t=TIME, a=WAVE, x1=WAVE[:, 0]),
        saved(np.savez_compressed, t=TIME, a1=single),
    ]


def numpy_arrays() -> list[bytes]:
    return [saved(np.save, WAVE), saved(np.save, WAVE.astype(np.int16))]


def matlab_files() -> list[bytes]:
    from scipy.io import savemat

    channels = {"t": TIME, "a1": WAVE[:, 0]}
    rig = {"x1": WAVE[:, 1], "note": "on floor 2", "deep": {"k": 3.0}}
    nested = channels | {"rig": rig}
    return [
        saved(savemat, nested),
        saved(savemat, nested, do_compression=True),
        saved(savemat, channels, format="4"),
    ]


def hdf5_files() -> list[bytes]:
    return [saved(write_plain_hdf5), saved(write_packed_hdf5)]


def write_plain_hdf5(buffer: io.BytesIO) -> None:
    import h5py

    with h5py.File(buffer, "w") as file:
        file["t"] = TIME
        file["a1"] = WAVE[:, 0]
        file["rig/x1"] = WAVE[:, 1]
        file["rig"].attrs["note"] = "on floor 2"


def write_packed_hdf5(buffer: io.BytesIO) -> None:
    import h5py

    packing = {"chunks": (10, 3), "compression": "gzip", "shuffle": True}
    with h5py.File(buffer, "w") as file:
        file.create_dataset("a", data=WAVE, **packing)
        file["t"] = TIME


def parquet_files() -> list[bytes]:
    return [saved(lambda buffer: table().to_parquet(buffer)), written(".parquet")]


def universal_files() -> list[bytes]:
    import pyuff

    channel = {
        "type": 58,
        "binary": 0,
        "func_type": 1,
        "rsp_node": 1,
        "rsp_dir": 1,
        "ref_dir": 1,
        "ref_node": 1,
        "data": WAVE[:, 0],
        "x": TIME,
        "id1": "a1",
        "rsp_ent_name": "NONE",
        "ref_ent_name": "NONE",
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 0,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "test.uff")
        pyuff.UFF(str(path)).write_sets(channel)
        return [path.read_bytes(), written(".uff")]


def strong_motions() -> list[bytes]:
    lines = ["CORRECTED ACCELEROGRAM    CHAN  1: 90 DEG   STATION"]
    lines += ["A LINE OF TEXT"] * 24
    lines += [f"{0:5d}" * 16] * 7
    lines += [f"{0.02:10.3f}" * 8] * 13
    for kind, unit in (("ACCEL", "CM/SEC/SEC"), ("VELOC", "CM/SEC"), ("DISPL", "CM")):
        lines.append(
            f"{N:8d} POINTS OF {kind} DATA EQUALLY SPACED AT  .020 SEC.  (UNITS:"
            f" {unit})"
        )
        for values in WAVE[:, 0].reshape(-1, 8):
            lines.append("".join(f"{x:10.3f}" for x in values))
    return ["\n".join([*lines, "/&", ""]).encode()]


def frequency_responses() -> list[bytes]:
    rows = "".join(f"{f};{0.1 * f}+0.01j;0.2-{0.01 * f}j\n" for f in range(1, 30))
    other_unit = rows.replace(";", "\t").replace("j", "i")
    return [f"f;H1;H2\n{rows}".encode(), other_unit.encode()]


def models() -> list[bytes]:
    from pysindy_nrf import ChainModel, laws
    from pysindy_nrf.chain.visited_region import VisitedRegion
    from pysindy_nrf.laws.contract import random_values

    hysteresis = random_values(laws.BoucWen(), np.random.default_rng(0))
    storeys = {
        "storey 1": [
            laws.PowerSeries(3, np.arange(1.0, 10.0)),
            laws.Dahl(sigma=1e3, Fd=20.0),
        ],
        "storey 2": [hysteresis],
        "link 3-1": laws.LinearElastic(1e4),
    }
    region = VisitedRegion.of(WAVE[:, 0], WAVE[:, 1])
    model = ChainModel(
        [10.0, 12.0, 9.0],
        storeys,
        visited={"storey 1": region},
        info={"band": [1, 40]},
    )
    return [model.to_json().encode()]


def mappings() -> list[bytes]:
    text = (
        'name = "shaker"\nfs = 500.0\ncoordinates = "absolute"\n[channels]\nF2 ='
        ' "Shaker"\nx1 = "-laser[:, 2] * 0.5 @ mm"\n[units]\nF = "kN"\na = "g"\n'
    )
    return [text.encode()]


def words() -> list[bytes]:
    return [
        b"-a[:, 2] * gain @ mm",
        b'"x1" * 2e3',
        b"x1 @ cm/s^2",
        b"in/s**2",
        b"link 4-2",
        b"sensor a2",
        b"a[3, :]",
        b"kip*s^2/in",
    ]


# -- readers -------------------------------------------------------------------


def read_table(path: Path) -> Any:
    from pysindy_nrf.records.files import read_table as read

    return read(path, max_bytes=MAX_BYTES)


def read_record(path: Path) -> Any:
    """To features and back in words."""
    from pysindy_nrf.records.files import describe, inspect_record

    return describe(inspect_record(path, max_bytes=MAX_BYTES))


def read_frf(path: Path) -> Any:
    from pysindy_nrf.records.files import read_frf as read

    return read(path, max_bytes=MAX_BYTES)


def read_model(path: Path) -> Any:
    """Read, and use what was read."""
    from pysindy_nrf import ChainModel

    model = ChainModel.from_json(path)
    return str(model), model.to_json()


def read_mapping(path: Path) -> Any:
    from pysindy_nrf.records.files.mapping import read_mapping as read

    return read(path)


def read_words(path: Path) -> None:
    """The small grammars: mappings, units, sites."""
    from pysindy_nrf.exceptions import NRFError

    text = path.read_bytes().decode("utf-8", "replace")
    for grammar in (read_expression, read_unit, read_site):
        try:
            grammar(path, text)
        except NRFError:
            continue


def read_expression(path: Path, text: str) -> None:
    from pysindy_nrf.records.files.mapping import line_of, parse
    from pysindy_nrf.records.files.table import Table

    variables = {"a": WAVE, "x1": WAVE[:, 0], "gain": np.array(2.0)}
    columns = Table(path, "memory", variables)
    line_of(parse(text, columns, "x1"), columns, "x1")


def read_unit(path: Path, text: str) -> None:
    from pysindy_nrf.records.files.units import is_unit, si_factor

    is_unit(text)
    si_factor(text, "a1")


def read_site(path: Path, text: str) -> None:
    from pysindy_nrf import Site

    Site(text)


READERS = (
    Target("delimited text", ".csv", read_record, delimited_texts, True),
    Target("NPZ", ".npz", read_record, numpy_archives),
    Target("NPY", ".npy", read_table, numpy_arrays),
    Target("MATLAB", ".mat", read_record, matlab_files),
    Target("HDF5", ".h5", read_table, hdf5_files),
    Target("Parquet", ".parquet", read_record, parquet_files),
    Target("UFF", ".uff", read_record, universal_files, True),
    Target("strong motion", ".v2", read_table, strong_motions, True),
    Target("frequency response", ".csv", read_frf, frequency_responses, True),
    Target("model JSON", ".json", read_model, models, True),
    Target("mapping file", ".toml", read_mapping, mappings, True),
    Target("small grammars", ".txt", read_words, words, True),
)
TARGETS = {target.name: target for target in READERS}


# -- damage to JSON ------------------------------------------------------------

ODD_VALUES: list[Any] = [
    None,
    True,
    -1,
    10**9,
    1e308,
    "",
    "storey 9",
    [],
    {},
    [[1]],
    float("nan"),
    "x" * 50,
    0,
    10**40,
]
MAX_DEPTH = 8


def json_damage(seed: bytes, rng: np.random.Generator) -> bytes:
    """JSON whose values were exchanged: it stays JSON with another meaning."""
    data = json.loads(seed)
    for _ in range(int(rng.integers(1, 4))):
        change_a_value(data, rng)
    return json.dumps(data).encode()


def change_a_value(data: Any, rng: np.random.Generator) -> None:
    """Walk down at random, and exchange or delete what is there."""
    node = data
    for _ in range(MAX_DEPTH):
        if not isinstance(node, (dict, list)) or not node:
            return
        keys = list(node) if isinstance(node, dict) else range(len(node))
        key = keys[int(rng.integers(len(keys)))]
        is_leaf = not isinstance(node[key], (dict, list))
        if is_leaf or rng.random() < 0.25:
            exchange(node, key, rng)
            return
        node = node[key]


def exchange(node: Any, key: Any, rng: np.random.Generator) -> None:
    if isinstance(node, dict) and rng.random() < 0.2:
        del node[key]
    else:
        node[key] = copy.deepcopy(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
