"""Text files as other programs write them: the numbers that were measured, or a refusal that names the cell."""

import warnings

import numpy as np
import pytest

from pysindy_nrf.data.io import read_record
from pysindy_nrf.exceptions import ChannelError, FileFormatError

T = np.arange(200) / 200.0
X = 1.2e-3 * np.sin(20 * T)  # m
A = -400 * X  # m/s^2, of the same motion
F = 1500 * np.cos(20 * T) + 3  # N


def written(path, head, columns, sep=";", tail=""):
    rows = "\n".join(sep.join(cells) for cells in zip(*columns))
    path.write_text(f"{head}\n{rows}\n{tail}")
    return path


def point(values):
    return [f"{v:.9g}" for v in values]


def comma(values):
    return [text.replace(".", ",") for text in point(values)]


def test_a_point_of_thousands_beside_a_decimal_comma_is_no_decimal_point(tmp_path):
    thousands = [f"{v:,.0f}".replace(",", ".") for v in F]  # "1.503" is 1503 N
    path = written(tmp_path / "own.csv", "t;x1;F1", [comma(T), comma(X), thousands])
    with pytest.raises(
        FileFormatError, match=r"F1 .*'1\.503' in data row 1, in a file with a decimal comma.* thousands"
    ):
        read_record(path)
    x1 = read_record(path, mapping={"F1": "none"}).displacement[:, 0]  # other columns stay readable
    np.testing.assert_allclose(x1, X, atol=1e-11)


def test_the_same_holds_where_files_are_put_together(tmp_path):
    written(tmp_path / "a.csv", "t;x1", [comma(T), comma(X)])
    written(tmp_path / "b.csv", "t;volt;Shaker", [comma(T), comma(X), [f"{v:,.0f}".replace(",", ".") for v in F]])
    with pytest.raises(FileFormatError, match=r"F1 .*'1\.503'"):
        read_record([tmp_path / "a.csv", tmp_path / "b.csv"], mapping={"x1": "a.x1", "F1": "b.Shaker"})


@pytest.mark.parametrize("mark", [",", "'", "\u202f"])
def test_marks_of_thousands_are_named_with_the_cure(tmp_path, mark):
    grouped = [f"{v:,.3f}".replace(",", mark) for v in F]
    path = written(tmp_path / "own.csv", "t;x1;F1", [point(T), point(X), grouped])
    with pytest.raises(FileFormatError, match="F1 .*in data row 1.*without marks of thousands"):
        read_record(path)


@pytest.mark.parametrize(
    "head", ["t;x1;a1;F1\ns;mm;g;kN", "s;mm;g;kN\nt;x1;a1;F1", "Rig 7\n[s];[mm];[g];[kN]\nt;x1;a1;F1"]
)
def test_a_row_of_units_counts_below_and_above_the_names(tmp_path, head):
    path = written(tmp_path / "own.csv", head, [point(T), point(1e3 * X), point(A / 9.80665), point(F / 1e3)])
    record = read_record(path)
    np.testing.assert_allclose(record.displacement[:, 0], X, atol=1e-11)
    np.testing.assert_allclose(record.acceleration[:, 0], A, atol=1e-9)
    np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


def test_a_factor_beside_a_unit_in_the_header_asks_for_the_unit_of_the_product(tmp_path):
    path = written(tmp_path / "own.csv", "t;Laser [mm];Cell", [point(T), point(500 * X), point(F / 35)])
    with pytest.raises(ChannelError, match=r"x1 = 'Laser \* 2' .* in mm.*'Laser \* 2 @ mm' or 'Laser \* 2 @ m'"):
        read_record(path, mapping={"x1": "Laser * 2"})
    for text, size in (("Laser * 2 @ mm", 1.0), ("Laser * 0.002 @ m", 1.0), ("-Laser", -0.5)):
        record = read_record(path, mapping={"x1": text, "F1": "Cell * 35"})  # volts become newtons
        np.testing.assert_allclose(record.displacement[:, 0], size * X, atol=1e-11)
        np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


@pytest.mark.parametrize("tail", ["Max;1;2\n", "End of test\n", "% end\n"])
def test_a_footer_is_named_and_not_the_first_time(tmp_path, tail):
    path = written(tmp_path / "own.csv", "t;x1;F1", [point(T), point(X), point(F)], tail=tail)
    with pytest.raises(FileFormatError, match=rf"time holds the text '{tail.split(';')[0].strip()}' in data row 201"):
        read_record(path)


def test_times_of_day_are_a_clock_without_a_word_from_pandas(tmp_path):
    of_day = [f"12:00:{59 + t:06.3f}" if t < 1 else f"12:01:{t - 1:06.3f}" for t in T]
    path = written(tmp_path / "own.csv", "Time;x1;F1", [of_day, point(X), point(F)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_record(path).fs == pytest.approx(200.0, rel=1e-12)
