"""Files that are almost right: what is wrong is named, with row, column or size; what is right comes out exactly."""

import json
import struct

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pysindy_nrf import NRFRegressor, Record
from pysindy_nrf.common.atomic import atomic_write
from pysindy_nrf.data.io import (
    describe,
    frequency_response,
    frf_to_features,
    from_sep005,
    inspect_record,
    read_excitation,
    read_frf,
    read_record,
    read_table,
    to_sep005,
    write_forces,
    write_record,
)
from pysindy_nrf.data.io.attributes import Attributes
from pysindy_nrf.data.io.summary import contents
from pysindy_nrf.data.io.units import factor
from pysindy_nrf.exceptions import ChannelError, FileFormatError, NRFError
from pysindy_nrf.signals.plausibility import doubts

T = np.arange(200) / 100.0


def receptance(f):
    """Displacement of both masses over the force on mass 2: (K - w^2 M + i w C)^-1."""
    w = 2 * np.pi * f[:, None, None]
    K, C = np.array([[7e4, -3e4], [-3e4, 3e4]]), np.array([[7.0, -3.0], [-3.0, 3.0]])
    return np.linalg.inv(K - w**2 * np.diag([6.0, 4.0]) + 1j * w * C)[:, :, 1]


F_HZ = np.linspace(2.0, 25.0, 120)
H = -((2 * np.pi * F_HZ[:, None]) ** 2) * receptance(F_HZ)

# -- frequency responses ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(f=F_HZ + 1j), "the frequencies are complex"),
        (dict(f=F_HZ[:-1]), r"\(119,\) frequencies for responses of shape \(120, 2\)"),
        (dict(kind="inertance"), "kind='inertance' is unknown. .*receptance"),
        (dict(f=F_HZ - 5.0), "the frequency in row 0 is -3"),
        (dict(f=np.where(F_HZ > 20, np.nan, F_HZ)), "the frequency in row 94 is nan"),
    ],
)
def test_a_response_that_cannot_be_one(change, words):
    with pytest.raises(ChannelError, match=words):
        frequency_response(**(dict(f=F_HZ, H=H, driven=2) | change))


def test_weights_leave_an_exact_response_exact_and_are_checked():
    """Rows of a balance that close exactly close under any weight; a line of weight zero is no line."""
    spoilt = H.copy()
    spoilt[30] *= 3.0
    X, F = frf_to_features(F_HZ, spoilt, 2, weight=np.where(np.arange(120) == 30, 0.0, 1.0 / F_HZ))
    np.testing.assert_allclose(NRFRegressor(degree=1).fit(X, F).masses_, [6.0, 4.0], rtol=1e-8)
    for weight in (np.ones(119), -np.ones(120), np.full(120, np.nan)):
        with pytest.raises(ChannelError, match="for 120 lines, or is not positive and finite"):
            frf_to_features(F_HZ, H, 2, weight=weight)


def test_response_files_of_other_shapes(tmp_path):
    np.savez(tmp_path / "one_by_one.npz", freq=F_HZ, H1=H[:, 0], H2=H[:, 1])
    np.testing.assert_array_equal(read_frf(tmp_path / "one_by_one.npz", driven=2).H, H)
    np.savez(tmp_path / "uneven.npz", freq=F_HZ, H1=H[:, 0], H2=H[:-1, 1])
    np.savez(tmp_path / "real.npz", f=F_HZ, H=np.abs(H))
    for name in ("uneven.npz", "real.npz"):
        with pytest.raises(FileFormatError, match="no frequencies 'f' and complex responses 'H'"):
            read_frf(tmp_path / name)
    for text, words in {"# only words\n% and more\n\n": "holds no rows", "f;H1\n": "no rows of numbers"}.items():
        (tmp_path / "H.csv").write_text(text)
        with pytest.raises(FileFormatError, match=words):
            read_frf(tmp_path / "H.csv")
    (tmp_path / "H.csv").write_bytes("f;H1 [m/s²/N]\n1;0.1j\n".encode("latin-1"))
    with pytest.raises(FileFormatError, match="H.csv"):
        read_frf(tmp_path / "H.csv")


# -- MATLAB -----------------------------------------------------------------------------------

HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def element(kind, data=b""):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def flags(kind):
    return element(6, struct.pack("<II", kind, 0))


def shape(*n):
    return element(5, struct.pack(f"<{len(n)}i", *n))


NAME, ONE = element(1, b"x1"), element(9, struct.pack("<d", 1.0))
NUMBER = element(14, flags(6) + shape(1, 1) + NAME + ONE)


def nested(depth):
    inner = NUMBER
    for _ in range(depth):
        inner = element(14, flags(1) + shape(1, 1) + NAME + inner)
    return inner


@pytest.mark.parametrize(
    "body",
    [
        element(9, bytes(16)),
        nested(5000),
        element(14, struct.pack("<HH", 6, 5) + bytes(12)),
        element(14, struct.pack("<II", 6, 800)),
        element(14, shape(1, 1) + NAME + ONE),
        element(14, flags(6) + NAME),
        element(14, flags(6) + shape(-1, 1) + NAME + ONE),
        element(14, flags(6) + shape(1, 1) + NAME + element(250, bytes(8))),
        element(14, flags(6) + shape(1, 1) + NAME + element(14, bytes(8))),
        element(14, flags(17) + NAME),
    ],
    ids=range(10),
)
def test_a_damaged_matlab_file_is_refused_and_the_process_lives(tmp_path, body):
    """Format: MAT-File Format, The MathWorks, level 5: tag, flags, dimensions, name, content."""
    path = tmp_path / "damaged.mat"
    path.write_bytes(HEAD + body)
    with pytest.raises(FileFormatError, match="damaged.mat"):
        read_table(path)


def test_structures_beside_channels_do_not_keep_them_from_being_read(tmp_path):
    savemat(tmp_path / "s.mat", {"run": {"x1": T, "about": np.array([("a", 1)], dtype=[("who", "O"), ("n", "O")])}})
    np.testing.assert_array_equal(read_table(tmp_path / "s.mat").variables["run.x1"], T)


# -- a record's own file ----------------------------------------------------------------------


def small_record(**more):
    return Record(displacement=np.sin(T)[:, None], force=np.cos(T)[:, None], fs=100.0, name="small", **more)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"version": 1', '"version": true', "its version is True"),
        ('"name": "small"', '"name": 7', "a name is no text"),
        ('"coordinates": "relative"', '"coordinates": "polar"', "its coordinates are 'polar'"),
        ('"fs": 100.0', '"fs": -100.0', "its clock is no number"),
        ('"float32": []', '"float32": ["a9"]', "names columns that it does not have"),
    ],
)
def test_attributes_that_were_edited_by_hand(tmp_path, old, new, words):
    path = write_record(small_record(), tmp_path / "small.csv")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=words):
        read_record(path)


def test_attributes_of_another_program():
    text = json.dumps({"schema": "other.record", "version": 1})
    with pytest.raises(FileFormatError, match="attributes of the record in lab.parquet are damaged: it is of another"):
        Attributes.from_json(text, "lab.parquet")


def test_a_record_file_that_lost_a_column(tmp_path):
    path = write_record(small_record(), tmp_path / "small.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(line.rpartition(",")[0] for line in lines[1:])]) + "\n")
    with pytest.raises(FileFormatError, match="2 columns where 3 are announced"):
        read_record(path)
    path = write_record(small_record(), tmp_path / "small.parquet")
    import pyarrow as pa
    import pyarrow.parquet as pq

    whole = pq.read_table(path)
    pq.write_table(whole.drop_columns(["F1"]), path)
    with pytest.raises(FileFormatError, match="lacks the column 'F1' of 'small'"):
        read_record(path)
    words = whole.set_column(whole.column_names.index("F1"), "F1", pa.array(["one"] * 200))
    pq.write_table(words, path)
    with pytest.raises(FileFormatError, match="column 'F1' of record 'small' holds no numbers"):
        read_record(path)


# -- tables -----------------------------------------------------------------------------------


def test_files_of_one_test_share_names_clock_and_rate(tmp_path):
    frame = pd.DataFrame({"t": T, "x1": np.sin(T)})
    (tmp_path / "b").mkdir()
    frame.to_csv(tmp_path / "one.csv", index=False)
    frame.to_csv(tmp_path / "b" / "one.csv", index=False)
    frame.assign(t=T + 0.003).to_csv(tmp_path / "late.csv", index=False)
    with pytest.raises(FileFormatError, match="No file was given"):
        read_table([])
    with pytest.raises(FileFormatError, match="Two files are called 'one'"):
        read_table([tmp_path / "one.csv", tmp_path / "b" / "one.csv"])
    with pytest.raises(FileFormatError, match="'one' and 'late' have times of their own"):
        read_table([tmp_path / "one.csv", tmp_path / "late.csv"])
    slow = Record(displacement=np.sin(T)[:, None], fs=50.0, name="slow")
    paths = [write_record(small_record(), tmp_path / "fast.csv"), write_record(slow, tmp_path / "slow.csv")]
    with pytest.raises(FileFormatError, match="sampled differently: fast.csv 100 Hz, slow.csv 50 Hz"):
        read_table(paths)


def test_columns_by_matrix_name_twice_or_with_fields(tmp_path):
    """A matrix ``a`` is a1, a2; two names of one channel are refused; a structured array is its fields."""
    np.savez(tmp_path / "m.npz", t=T, a=np.column_stack([np.sin(T), np.cos(T)]))
    np.testing.assert_array_equal(read_record(tmp_path / "m.npz").acceleration[:, 1], np.cos(T))
    np.savez(tmp_path / "twice.npz", t=T, x1=T, X1=T)
    with pytest.raises(FileFormatError, match="two columns that are channel x1"):
        read_record(tmp_path / "twice.npz")
    fields = np.zeros(200, dtype=[("t", float), ("x1", float)])
    fields["t"], fields["x1"] = T, np.sin(T)
    np.save(tmp_path / "log.npy", fields)
    np.testing.assert_array_equal(read_table(tmp_path / "log.npy").variables["log.x1"], np.sin(T))
    np.save(tmp_path / "plain.npy", np.sin(T))
    np.testing.assert_array_equal(read_table(tmp_path / "plain.npy").variables["plain"], np.sin(T))


def test_a_covariate_of_a_record_stays_one_under_a_mapping(tmp_path):
    path = write_record(small_record(covariates={"temperature": 20 + T}), tmp_path / "small.csv")
    again = read_record(path, mapping={"v1": "x1"}, units={"v1": "m/s"})
    np.testing.assert_array_equal(again.covariates["temperature"], 20 + T)
    with pytest.raises(ChannelError, match="'temperature' is a covariate and keeps its unit, 'K' cannot be converted"):
        factor("K", "temperature")
    with pytest.raises(ChannelError, match="coordinates='polar' is unknown"):
        read_record(path, coordinates="polar")


def test_columns_with_one_name(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_arrays([pa.array(T), pa.array(T)], names=["x1", "x1"]), tmp_path / "a.parquet")
    with pytest.raises(FileFormatError, match="two columns named 'x1'"):
        read_table(tmp_path / "a.parquet")


def test_what_is_no_channel_in_an_hdf5_file_is_left_out(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x1"], file["t"] = np.sin(T), T
        file["who"] = "the lab"
        file.create_dataset("nothing", data=h5py.Empty("f8"))
    assert sorted(read_table(tmp_path / "a.h5").variables) == ["t", "x1"]


def test_summary_of_what_holds_no_numbers(tmp_path):
    """What a user is shown who must map the columns: sizes without a range where there are no numbers."""
    frame = pd.DataFrame({"t": T, "x1": np.sin(T), "F1": np.cos(T), "spare": np.nan, "stamp": "noon"})
    frame.to_csv(tmp_path / "a.csv", index=False)
    shown = {line.split()[0]: line.split()[1:] for line in contents(read_table(tmp_path / "a.csv")).splitlines()[1:]}
    assert shown["spare"] == ["200", "values"] and shown["stamp"] == ["200", "values,", "no", "numbers"]
    said = describe(inspect_record(tmp_path / "a.csv", mapping={"F1": "unknown"}))
    assert "force unknown: DOF 1" in said


def test_an_unknown_force_cannot_drive_a_simulation(tmp_path):
    pd.DataFrame({"t": T, "F1": np.cos(T)}).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(ChannelError, match="F1 is unknown"):
        read_excitation(tmp_path / "a.csv", 1, mapping={"F1": "unknown", "F2": "F1"} | {"F2": "none"})


def test_a_displacement_in_kilometres_is_suspected():
    """x that is 1000 times too small for its acceleration: the reference is in mm, or x in another unit."""
    rng = np.random.default_rng(0)
    f = np.fft.rfftfreq(4000, 1e-3)
    line = np.where((f > 5) & (f < 60), rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size), 0)
    x = np.fft.irfft(line, 4000)
    a = np.fft.irfft(-((2 * np.pi * f) ** 2) * line, 4000)
    a, x = a / np.abs(a).max(), x / np.abs(a).max()
    rec = Record(acceleration=a[:, None], displacement=1e-3 * x[:, None], fs=1000.0, name="r")
    assert any("mm?" in text for text in doubts(rec))
    assert doubts(Record(acceleration=a[:, None], displacement=x[:, None], fs=1000.0, name="r")) == []


# -- UFF, SEP005, strong motion -----------------------------------------------------------------


def uff_channel(data, **more):
    return {
        "type": 58, "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "data": data,
        "x": T[: len(data)], "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "id1": "NONE",
        "ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "NONE", "orddenom_spec_data_type": 0, **more,
    }  # fmt: skip


def uff(path, *sets):
    pyuff = pytest.importorskip("pyuff")
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(list(sets), mode="add")
    return path


def test_uneven_clocks_in_a_uff_file(tmp_path):
    """abscissa_spacing 0: every sample has its time; all channels must share it."""
    even = T[:64]
    jitter = even + 1e-5 * np.sin(np.arange(64))
    one, two = uff_channel(even, x=jitter, abscissa_spacing=0), uff_channel(even, rsp_node=2, x=jitter, abscissa_spacing=0)
    table = read_table(uff(tmp_path / "a.unv", one, two))
    np.testing.assert_allclose(table.variables["t"], jitter, atol=1e-6)
    late = uff_channel(even, rsp_node=2, x=jitter + 0.002, abscissa_spacing=0)
    with pytest.raises(FileFormatError, match="clocks of their own"):
        read_table(uff(tmp_path / "a.unv", one, late))


def test_a_units_code_that_nobody_knows_is_said(tmp_path):
    units = {"type": 164, "units_code": 9, "units_description": "own", "temp_mode": 1, "length": 1.0, "force": 1.0,
             "temp": 1.0, "temp_offset": 273.15}  # fmt: skip
    table = read_table(uff(tmp_path / "a.unv", units, uff_channel(np.sin(T))))
    assert any("units code 9 is not known here; give units" in note for note in table.notes)
    assert table.units == {}


def test_sep005_channels_with_times_of_their_own_or_taken_out():
    rec = small_record()
    channels = to_sep005(rec)
    moved = next(one for one in channels if one["name"] == "x1")
    np.testing.assert_array_equal(from_sep005(moved).displacement, rec.displacement)  # one need not be a list
    fewer = from_sep005([one for one in channels if one["name"] != "F1"])
    np.testing.assert_array_equal(fewer.displacement, rec.displacement)
    assert not fewer.forced
    timed = [{"name": "x1", "data": T, "unit_str": "m", "time": T}, {"name": "a1", "data": T, "unit_str": "m/s^2", "time": T + 0.001}]
    with pytest.raises(ChannelError, match="times of their own"):
        from_sep005(timed)
    known = from_sep005([timed[0] | {"fs": 100.0}, timed[1] | {"fs": 100.0, "time": None}])
    assert known.fs == 100.0


def test_strong_motion_text_that_contradicts_itself(tmp_path):
    def csmip(step, values, kind="ACCEL"):
        rows = ["".join(f"{v:10.3f}" for v in values[i : i + 8]) for i in range(0, len(values), 8)]
        head = f" {len(values):4d} POINTS OF {kind} DATA EQUALLY SPACED AT  {step} SEC, IN CM/SEC/SEC. (UNITS: CM/SEC/SEC)"
        return [head, *rows]

    y = 100 * np.sin(T[:16])
    path = tmp_path / "a.v2"
    path.write_text("\n".join(["CHAN  1: 360 DEG", *csmip(".020", y), "CHAN  2: 90 DEG", *csmip(".010", y)]) + "\n")
    with pytest.raises(FileFormatError, match="sampled every 0.01, 0.02 s"):
        read_table(path)
    path.write_text("\n".join(["CHAN  1: 360 DEG", *csmip(".020", y), *csmip(".020", y)]) + "\n")
    with pytest.raises(FileFormatError, match="acceleration of channel 1 twice"):
        read_table(path)
    rows = csmip(".020", y)
    path.write_text("\n".join(["CHAN  1: 360 DEG", rows[0], rows[1].replace("0.000", "0.0x0", 1), *rows[2:]]) + "\n")
    with pytest.raises(FileFormatError, match="not made of numbers 10 characters wide"):
        read_table(path)
    path.write_text("   16 acceleration pts, approx  0 secs, units=cm/sec2 (04), Format=(8f10.3)\n" + "\n".join(rows[1:]) + "\n")
    with pytest.raises(FileFormatError, match="no real header with the sampling interval"):
        read_table(path)


# -- out --------------------------------------------------------------------------------------


def test_what_is_written_is_one_record_in_a_known_mode(tmp_path, chain2):
    model = NRFRegressor().fit(chain2.X, chain2.F)
    ids = np.repeat([0, 1], [900, 1100])
    with pytest.raises(FileFormatError, match="one record at a time"):
        write_forces(model, chain2.X, tmp_path / "R.csv", record=ids, dt=1e-3)
    with pytest.raises(NRFError, match="mode='a' is unknown"), atomic_write(tmp_path / "x", "a"):
        pass
    assert not (tmp_path / "x").exists()
