"""Builders that the tests of records and files share."""

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import Record


@pytest.fixture
def written(tmp_path):
    """Function that writes a text or bytes to a file and returns its path."""

    def write(content, name="own.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(
            content if isinstance(content, bytes) else content.encode(encoding)
        )
        return path

    return write


@pytest.fixture
def columns_file(written):
    """Function that writes a head line, columns of cells and a footer as text."""

    def write(head, columns, separator=";", tail="", name="own.csv"):
        rows = "\n".join(separator.join(cells) for cells in zip(*columns))
        return written(f"{head}\n{rows}\n{tail}", name)

    return write


@pytest.fixture(scope="session")
def frame():
    """Motions of two floors and a force on the upper one, 300 samples at 500 Hz."""
    w = 40.0
    t = np.arange(300) / 500.0
    table = pd.DataFrame({"t": t, "F1": 0 * t, "F2": 30 * np.cos(w * t)})
    for j, amplitude, phase in ((1, 1e-3, 0.0), (2, 1.7e-3, 0.3)):
        x = amplitude * np.sin(w * t + phase)
        table[f"a{j}"] = -(w**2) * x
        table[f"v{j}"] = amplitude * w * np.cos(w * t + phase)
        table[f"x{j}"] = x
    return table


@pytest.fixture
def small():
    """Function that gives a short record of one DOF."""
    t = np.arange(200) / 100.0

    def record(**more):
        lines = {"displacement": np.sin(t)[:, None], "force": np.cos(t)[:, None]}
        return Record(**lines | {"fs": 100.0, "name": "small"} | more)

    return record


@pytest.fixture
def uff(tmp_path):
    """Function that writes data sets by pyuff and returns the path of the file."""
    pyuff = pytest.importorskip("pyuff")

    def write(*sets):
        path = tmp_path / "lab.unv"
        path.unlink(missing_ok=True)
        pyuff.UFF(str(path)).write_sets(list(sets), mode="add")
        return path

    return write
