"""Nothing in a file can run, escape its folder or eat the memory."""

from __future__ import annotations

import ast
import json
import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import pysindy_nrf
from pysindy_nrf import ChainModel, laws
from pysindy_nrf.exceptions import FileFormatError, NRFError

PACKAGE = Path(pysindy_nrf.__file__).parent
# Calls that turn text or bytes from elsewhere into running code.
RUNS_CODE = {"eval", "exec", "compile", "__import__", "execfile"}
RUNS_CODE_OF = {
    ("pickle", "load"), ("pickle", "loads"), ("pickle", "Unpickler"), ("cPickle", "load"), ("dill", "load"), ("dill", "loads"),
    ("joblib", "load"), ("cloudpickle", "load"), ("cloudpickle", "loads"), ("marshal", "load"), ("marshal", "loads"),
    ("shelve", "open"), ("yaml", "load"), ("yaml", "unsafe_load"), ("yaml", "full_load"), ("pd", "read_pickle"),
    ("pd", "eval"), ("os", "system"), ("os", "popen"), ("subprocess", "run"), ("subprocess", "Popen"),
    ("subprocess", "call"), ("torch", "load"), ("numexpr", "evaluate"),
}  # fmt: skip


def calls():
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                yield path.relative_to(PACKAGE), node


def test_nothing_that_runs_code_is_called():
    wrong = []
    for where, node in calls():
        f = node.func
        name = f.id if isinstance(f, ast.Name) else ""
        of = (f.value.id, f.attr) if isinstance(f, ast.Attribute) and isinstance(f.value, ast.Name) else ("", "")
        if name in RUNS_CODE or of in RUNS_CODE_OF:
            wrong.append(f"{where}:{node.lineno} calls {name or '.'.join(of)}")
    assert not wrong, "\n".join(wrong)


def test_numpy_never_loads_pickles():
    loads = [
        (where, node)
        for where, node in calls()
        if isinstance(node.func, ast.Attribute) and ast.unparse(node.func) in ("np.load", "numpy.load")
    ]
    for where, node in loads:
        given = {k.arg: k.value for k in node.keywords}
        assert isinstance(given.get("allow_pickle"), ast.Constant) and given["allow_pickle"].value is False, where


def test_xml_and_yaml_are_not_read():
    """Formats whose readers expand entities or build objects."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            roots = {n.split(".")[0] for n in names}
            assert not roots & {"yaml", "xml", "shelve", "marshal", "dill"}, path


class Bomb:
    def __reduce__(self):
        return Path.touch, (Path("it_ran"),)


def test_a_pickle_in_a_numpy_file_is_refused(tmp_path, monkeypatch):
    from pysindy_nrf.data.io import read_record, read_table

    monkeypatch.chdir(tmp_path)
    for name, save in (("a.npy", np.save), ("a.npz", lambda f, x: np.savez(f, a1=x))):
        save(name, np.array([Bomb(), Bomb()], dtype=object))
        for read in (read_table, read_record):
            with pytest.raises(FileFormatError, match="pickled"):
                read(name)
    assert not Path("it_ran").exists()


@pytest.mark.parametrize(
    "text",
    ["__import__('os').system('touch it_ran')", "exec(open('x').read())", "().__class__", "a1*__import__('os').getpid()", "a1; import os", "lambda: 0"],
)
def test_expressions_are_never_evaluated(tmp_path, monkeypatch, text):
    from pysindy_nrf.data.io import read_record

    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("t,a1,F1\n" + "".join(f"{i / 100},{i % 7},{i % 3}\n" for i in range(50)))
    with pytest.raises(NRFError):
        read_record("a.csv", mapping={"x1": text})
    assert not Path("it_ran").exists()


def test_an_archive_that_unpacks_to_more_than_the_limit_is_refused_before_it_does(tmp_path):
    from pysindy_nrf.data.io import read_table

    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a1.npy", "w") as member:
        np.lib.format.write_array_header_1_0(
            member, {"descr": "<f8", "fortran_order": False, "shape": (25_000_000,)}
        )
        for _ in range(200):
            member.write(bytes(1_000_000))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(FileFormatError, match="more than the limit"):
        read_table(path, max_bytes=100_000_000)


LIMITED = """
import resource, sys
import numpy, h5py, scipy.io, pandas, pysindy_nrf.data.io
from pysindy_nrf.data.io import read_table
from pysindy_nrf.exceptions import NRFError
used = int(open("/proc/self/statm").read().split()[0]) * 4096
resource.setrlimit(resource.RLIMIT_AS, (used + 1_500_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
for name in sys.argv[1:]:
    try:
        read_table(name, max_bytes=200_000_000)
    except NRFError as error:
        print(type(error).__name__)
    else:
        print("read")
"""


def test_files_that_claim_to_be_huge_are_refused_within_a_fixed_memory(tmp_path):
    """Headers promise a terabyte: a NumPy array, an HDF5 set, a deflated HDF5 set, a MATLAB v5 matrix."""
    h5py = pytest.importorskip("h5py")
    names = [tmp_path / n for n in ("header.npy", "sparse.h5", "zeros.h5", "header.mat")]
    with open(names[0], "wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (2**37,)})
        file.write(bytes(64))
    with h5py.File(names[1], "w") as file:
        file.create_dataset("a1", shape=(2**37,), dtype="f8", chunks=(2**20,))
    with h5py.File(names[2], "w") as file:
        file.create_dataset("a1", data=np.zeros(40_000_000), compression="gzip", chunks=(10_000_000,))
    from scipy.io import savemat

    savemat(names[3], {"a1": np.arange(200.0)})
    raw = bytearray(names[3].read_bytes())
    at = raw.find((200 * 8).to_bytes(4, "little"))
    raw[at : at + 4] = (2**31 - 8).to_bytes(4, "little")
    names[3].write_bytes(bytes(raw))
    assert all(n.stat().st_size < 4_000_000 for n in names)
    run = subprocess.run(
        [sys.executable, "-c", LIMITED, *map(str, names)], capture_output=True, text=True, timeout=120
    )
    assert run.stdout.split() == ["FileFormatError"] * 4, run.stdout + run.stderr[-2000:]


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["laws"].update({"storey 1": [{"law": "power_series", "options": {"degree": 10**9}}]}),
        lambda d: d["laws"].update({"storey 1": [{"law": "power_series", "options": {"degree": [10**9, 10**9]}}]}),
        lambda d: d.update(masses=[1.0], chain={"n_dof": 10**9}),
        lambda d: d["chain"].update(links=["link 99999999999999999999-0"]),
        lambda d: d.update(laws={"storey 1": [{"law": "__class__"}]}),
        lambda d: d["visited"].update({"storey 1": {"low": [0, 0], "high": [1, 1], "cells": [[]]}}),
        lambda d: d["visited"].update({"storey 1": {"low": [0], "high": [1, 1], "cells": ["x"]}}),
    ],
)
def test_a_hostile_model_is_refused(change):
    data = ChainModel([10.0, 10.0], {1: laws.LinearElastic(1e5), 2: laws.LinearElastic(1e5)}).to_dict()
    data = json.loads(json.dumps(data))
    change(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError):
        ChainModel.from_json(json.dumps(data))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


def test_names_from_files_stay_in_the_chosen_folder(tmp_path, monkeypatch):
    """A record that calls itself ../../x writes nothing outside the output folder."""
    from pysindy_nrf import Record, datasets
    from pysindy_nrf.output.cli.group import run

    monkeypatch.chdir(tmp_path)
    table = datasets.load_demo().to_frame().iloc[:2000]
    inner = tmp_path / "work" / "deep"
    inner.mkdir(parents=True)
    table.to_csv(inner / "..%2F..%2Fescaped.csv")
    monkeypatch.chdir(inner)
    before = {p for p in tmp_path.rglob("*") if inner not in p.parents}
    assert run(["identify", "..%2F..%2Fescaped.csv", "-o", "out", "--json"]) == 0
    assert {p for p in tmp_path.rglob("*") if inner not in p.parents} == before
    assert Record.from_frame(table, name="../../escaped").name == "../../escaped"


EVIL = "<script>alert('x')</script>\"><img src=x onerror=alert(1)> & </style>"


@pytest.fixture(scope="module")
def evil_report():
    """A report of a record whose every name is markup."""
    from pysindy_nrf import close_loop, excitation, simulate

    linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    truth = ChainModel([10.0], {1: [*linear, laws.CoulombFriction(40.0)]})
    F = excitation.band_limited_random(1, 4.0, 500.0, dofs=1, rms=100.0, band=(1, 60), random_state=0)
    record = simulate(truth, F, 1 / 500.0, name=EVIL).replace(covariates={EVIL: np.sin(np.arange(len(F)) / 50.0)})
    return close_loop(record, catalogue=[laws.CoulombFriction()], n_surrogates=0, max_steps=1)


def test_the_report_escapes_everything(evil_report, tmp_path):
    from html.parser import HTMLParser

    path = tmp_path / "report.html"
    evil_report.to_html(path)
    html = path.read_text(encoding="utf-8")
    found = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag, attrs):
            names = dict(attrs)
            if any(k.startswith("on") for k in names) or (tag == "img" and names.get("src") == "x"):
                found.append((tag, attrs))

    Parser().feed(html)
    assert not found
    assert "alert('x')</script>" not in html and "onerror=alert(1)>" not in html


def test_markdown_holds_no_live_markup(evil_report):
    assert "<script>" not in evil_report.to_markdown()
