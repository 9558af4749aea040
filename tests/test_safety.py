"""Nothing in a file is written outside the chosen folder.

That nothing of it runs is checked by the rules S of ruff.
"""

import pytest

from pysindy_nrf import Record, datasets
from pysindy_nrf.cli import run

NAME = "..%2F..%2Fescaped.csv"


@pytest.mark.slow
def test_names_from_files_stay_in_the_chosen_folder(tmp_path, monkeypatch):
    """A record that calls itself ../../x writes nothing outside the output folder."""
    inner = tmp_path / "work" / "deep"
    inner.mkdir(parents=True)
    table = datasets.load_demo().to_frame().iloc[:2000]
    table.to_csv(inner / NAME)
    monkeypatch.chdir(inner)

    def files_outside():
        return {path for path in tmp_path.rglob("*") if inner not in path.parents}

    before = files_outside()
    assert run(["identify", NAME, "-o", "out", "--json"]) == 0
    assert files_outside() == before
    assert Record.from_frame(table, name="../../escaped").name == "../../escaped"
