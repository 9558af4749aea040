"""Nothing in a file can run, write outside the chosen folder, or become live markup in a report."""

from __future__ import annotations

import ast

import pytest
from sources import trees

# Calls that turn text or bytes from elsewhere into running code.
RUNS_CODE = {"eval", "exec", "compile", "__import__", "execfile"}
RUNS_CODE_OF = {
    ("pickle", "load"), ("pickle", "loads"), ("pickle", "Unpickler"), ("cPickle", "load"), ("dill", "load"), ("dill", "loads"),
    ("joblib", "load"), ("cloudpickle", "load"), ("cloudpickle", "loads"), ("marshal", "load"), ("marshal", "loads"),
    ("shelve", "open"), ("yaml", "load"), ("yaml", "unsafe_load"), ("yaml", "full_load"), ("pd", "read_pickle"),
    ("pd", "eval"), ("os", "system"), ("os", "popen"), ("subprocess", "run"), ("subprocess", "Popen"),
    ("subprocess", "call"), ("torch", "load"), ("numexpr", "evaluate"),
}  # fmt: skip


# The reader of MATLAB files starts a process that may crash, and reads what this very process sends back.
ALLOWED = {("data/io/arrays.py", "subprocess.run"), ("data/io/arrays.py", "pickle.loads")}


def calls():
    return [(where, node) for where, tree in trees() for node in ast.walk(tree) if isinstance(node, ast.Call)]


def test_nothing_that_runs_code_is_called():
    wrong = []
    for where, node in calls():
        f = node.func
        name = f.id if isinstance(f, ast.Name) else ""
        of = (f.value.id, f.attr) if isinstance(f, ast.Attribute) and isinstance(f.value, ast.Name) else ("", "")
        if (name in RUNS_CODE or of in RUNS_CODE_OF) and (where, ".".join(of)) not in ALLOWED:
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
    for where, tree in trees():
        for node in ast.walk(tree):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            roots = {n.split(".")[0] for n in names}
            assert not roots & {"yaml", "xml", "shelve", "marshal", "dill"}, where


@pytest.mark.slow
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
