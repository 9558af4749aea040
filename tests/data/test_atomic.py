"""A file is whole or not there."""

import pytest

from pysindy_nrf.common.atomic import atomic_write


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_the_old_file_survives_a_failure(tmp_path, failure):
    path = tmp_path / "model.json"
    path.write_text("old")
    with pytest.raises(failure), atomic_write(path) as file:
        file.write("half of the new")
        raise failure
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def test_bytes_text_folder_and_permissions(tmp_path):
    path = tmp_path / "a" / "b" / "table.csv"
    with atomic_write(path) as file:
        file.write("größe\n")
    assert path.read_bytes() == "größe\n".encode()
    path.chmod(0o640)
    with atomic_write(path, "wb") as file:
        file.write(b"\x00\r\n")
    assert path.read_bytes() == b"\x00\r\n"
    assert path.stat().st_mode & 0o777 == 0o640
    plain = tmp_path / "plain"
    plain.touch()
    with atomic_write(tmp_path / "new") as file:
        file.write("")
    assert (tmp_path / "new").stat().st_mode == plain.stat().st_mode
