"""What is fuzzed: each reader, with small good files to damage."""

# ruff: noqa: E501

from __future__ import annotations

import copy
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

N = 40
TIME = np.arange(N) / 100.0
WAVE = np.column_stack([np.sin(9 * TIME), np.cos(7 * TIME), 0.1 * TIME])


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


def _record() -> Any:
    from pysindy_nrf import Record

    return Record(
        WAVE[:, :2],
        -80 * WAVE[:, :2],
        None,
        WAVE[:, :2],
        fs=100.0,
        covariates={"volt": WAVE[:, 2]},
        name="a test",
    )


def _table() -> pd.DataFrame:
    return pd.DataFrame(
        {"t": TIME, "a1": WAVE[:, 0], "x1": WAVE[:, 1], "F1": WAVE[:, 2]}
    )


def _texts() -> list[bytes]:
    t = _table()
    german = t.set_axis(["t [ms]", "Acc 1 [g]", "x1 [mm]", "F1 [kN]"], axis=1).to_csv(
        index=False, sep=";", decimal=","
    )
    stamps = t.assign(t=pd.date_range("2024-05-01", periods=N, freq="10ms").astype(str))
    return [
        t.to_csv(index=False).encode(),
        ("# made by a logger\n# 40 Hz\n\n" + german).encode("utf-8-sig"),
        t.to_csv(index=False, sep="\t").encode("utf-16"),
        t.to_string(index=False).encode(),
        stamps.to_csv(index=False, sep="|").encode(),
        _written(".csv"),
    ]


def _written(suffix: str) -> bytes:
    import tempfile

    from pysindy_nrf.records.files import write_record

    with tempfile.TemporaryDirectory() as folder:
        return Path(write_record(_record(), Path(folder, "test" + suffix))).read_bytes()


def _saved(write: Callable[[Any], Any]) -> bytes:
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


def _numpy_archives() -> list[bytes]:
    return [
        _saved(lambda b: np.savez(b, t=TIME, a=WAVE, x1=WAVE[:, 0])),
        _saved(
            lambda b: np.savez_compressed(b, t=TIME, a1=WAVE[:, 0].astype(np.float32))
        ),
    ]


def _numpy_arrays() -> list[bytes]:
    return [
        _saved(lambda b: np.save(b, WAVE)),
        _saved(lambda b: np.save(b, WAVE.astype(np.int16))),
    ]


def _mats() -> list[bytes]:
    from scipy.io import savemat

    content = {
        "t": TIME,
        "a1": WAVE[:, 0],
        "rig": {"x1": WAVE[:, 1], "note": "on floor 2", "deep": {"k": 3.0}},
    }
    return [
        _saved(lambda b: savemat(b, content)),
        _saved(lambda b: savemat(b, content, do_compression=True)),
        _saved(lambda b: savemat(b, {"t": TIME, "a1": WAVE[:, 0]}, format="4")),
    ]


def _hdf5s() -> list[bytes]:
    import h5py

    def plain(b: Any) -> None:
        with h5py.File(b, "w") as file:
            file["t"], file["a1"], file["rig/x1"] = TIME, WAVE[:, 0], WAVE[:, 1]
            file["rig"].attrs["note"] = "on floor 2"

    def packed(b: Any) -> None:
        with h5py.File(b, "w") as file:
            file.create_dataset(
                "a", data=WAVE, chunks=(10, 3), compression="gzip", shuffle=True
            )
            file["t"] = TIME

    return [_saved(plain), _saved(packed)]


def _parquets() -> list[bytes]:
    return [_saved(lambda b: _table().to_parquet(b)), _written(".parquet")]


def _uffs() -> list[bytes]:
    import os
    import tempfile

    import pyuff

    handle, name = tempfile.mkstemp(suffix=".uff")
    os.close(handle)
    try:
        Path(name).unlink()
        data = {
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
        pyuff.UFF(name).write_sets(data)
        ascii_file = Path(name).read_bytes()
    finally:
        Path(name).unlink(missing_ok=True)
    return [ascii_file, _written(".uff")]


def _strong_motions() -> list[bytes]:
    lines = ["CORRECTED ACCELEROGRAM    CHAN  1: 90 DEG   STATION"] + [
        "A LINE OF TEXT"
    ] * 24
    lines += ["".join(f"{0:5d}" for _ in range(16))] * 7 + [
        "".join(f"{0.02:10.3f}" for _ in range(8))
    ] * 13
    for kind, unit in (("ACCEL", "CM/SEC/SEC"), ("VELOC", "CM/SEC"), ("DISPL", "CM")):
        lines.append(
            f"{N:8d} POINTS OF {kind} DATA EQUALLY SPACED AT  .020 SEC.  (UNITS:"
            f" {unit})"
        )
        lines += [
            "".join(f"{x:10.3f}" for x in WAVE[k : k + 8, 0]) for k in range(0, N, 8)
        ]
    return ["\n".join([*lines, "/&", ""]).encode()]


def _responses() -> list[bytes]:
    rows = "".join(f"{f};{0.1 * f}+0.01j;0.2-{0.01 * f}j\n" for f in range(1, 30))
    return [
        ("f;H1;H2\n" + rows).encode(),
        rows.replace(";", "\t").replace("j", "i").encode(),
    ]


def _models() -> list[bytes]:
    from pysindy_nrf import ChainModel, laws
    from pysindy_nrf.chain.visited_region import VisitedRegion

    storey = [laws.PowerSeries(3, np.arange(1.0, 10.0)), laws.Dahl(sigma=1e3, Fd=20.0)]
    region = VisitedRegion.of(WAVE[:, 0], WAVE[:, 1])
    held = {
        "storey 1": storey,
        "storey 2": laws.BoucWen(),
        "link 3-1": laws.LinearElastic(1e4),
    }
    held = {
        s: law if isinstance(law, list) or not law.free_shape else [_valued(law)]
        for s, law in held.items()
    }
    return [
        ChainModel(
            [10.0, 12.0, 9.0],
            held,
            visited={"storey 1": region},
            info={"band": [1, 40]},
        )
        .to_json()
        .encode()
    ]


def _valued(law: Any) -> Any:
    from pysindy_nrf.laws.contract import random_values

    return random_values(law, np.random.default_rng(0))


def _mappings() -> list[bytes]:
    text = (
        'name = "shaker"\nfs = 500.0\ncoordinates = "absolute"\n[channels]\nF2 ='
        ' "Shaker"\nx1 = "-laser[:, 2] * 0.5 @ mm"\n'
    )
    return [(text + '[units]\nF = "kN"\na = "g"\n').encode()]


def read_table(path: Path) -> Any:
    from pysindy_nrf.records.files import read_table as read

    return read(path, max_bytes=100_000_000)


def read_record(path: Path) -> Any:
    """The whole way, to features and back in words."""
    from pysindy_nrf.records.files import describe, inspect_record

    return describe(inspect_record(path, max_bytes=100_000_000))


def read_frf(path: Path) -> Any:
    from pysindy_nrf.records.files import read_frf as read

    return read(path, max_bytes=100_000_000)


def read_model(path: Path) -> Any:
    """Read, and use what was read."""
    from pysindy_nrf import ChainModel

    model = ChainModel.from_json(path)
    return str(model), model.to_json()


def read_mapping(path: Path) -> Any:
    from pysindy_nrf.records.files.mapping import read_mapping as read

    return read(path)


def read_words(path: Path) -> Any:
    """The small grammars: mappings, units, sites."""
    from pysindy_nrf import Site
    from pysindy_nrf.exceptions import NRFError
    from pysindy_nrf.records.files.mapping import line_of, parse
    from pysindy_nrf.records.files.table import Table
    from pysindy_nrf.records.files.units import factor, is_unit

    text = path.read_bytes().decode("utf-8", "replace")
    table = Table(path, "memory", {"a": WAVE, "x1": WAVE[:, 0], "gain": np.array(2.0)})
    for use in (
        lambda: line_of(parse(text, table, "x1"), table, "x1"),
        lambda: (is_unit(text), factor(text, "a1")),
        lambda: Site(text),
    ):
        try:
            use()
        except NRFError:
            continue
    return None


def _words() -> list[bytes]:
    said = [
        "-a[:, 2] * gain @ mm",
        '"x1" * 2e3',
        "x1 @ cm/s^2",
        "in/s**2",
        "link 4-2",
        "sensor a2",
        "a[3, :]",
        "kip*s^2/in",
    ]
    return [w.encode() for w in said]


TARGETS = {
    t.name: t
    for t in (
        Target("delimited text", ".csv", read_record, _texts, True),
        Target("NPZ", ".npz", read_record, _numpy_archives),
        Target("NPY", ".npy", read_table, _numpy_arrays),
        Target("MATLAB", ".mat", read_record, _mats),
        Target("HDF5", ".h5", read_table, _hdf5s),
        Target("Parquet", ".parquet", read_record, _parquets),
        Target("UFF", ".uff", read_record, _uffs, True),
        Target("strong motion", ".v2", read_table, _strong_motions, True),
        Target("frequency response", ".csv", read_frf, _responses, True),
        Target("model JSON", ".json", read_model, _models, True),
        Target("mapping file", ".toml", read_mapping, _mappings, True),
        Target("small grammars", ".txt", read_words, _words, True),
    )
}


def json_damage(seed: bytes, rng: np.random.Generator) -> bytes:
    """JSON whose values were exchanged: it stays JSON and says something else."""
    values = [
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
    data = json.loads(seed)
    for _ in range(int(rng.integers(1, 4))):
        node, steps = data, 0
        while isinstance(node, (dict, list)) and len(node) and steps < 8:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            key = keys[int(rng.integers(len(keys)))]
            child = node[key]
            if not isinstance(child, (dict, list)) or rng.random() < 0.25:
                if isinstance(node, dict) and rng.random() < 0.2:
                    del node[key]
                else:
                    node[key] = copy.deepcopy(values[int(rng.integers(len(values)))])
                break
            node, steps = child, steps + 1
    return json.dumps(data).encode()
