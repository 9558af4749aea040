"""Nothing in a file is written outside the chosen folder (that nothing of it runs, the
rules S of ruff check).
"""

import pytest


@pytest.mark.slow
def test_names_from_files_stay_in_the_chosen_folder(tmp_path, monkeypatch):
    """A record that calls itself ../../x writes nothing outside the output folder."""
    from pysindy_nrf import Record, datasets
    from pysindy_nrf.cli.group import run

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
