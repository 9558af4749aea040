"""Downloads happen only when asked for, and what comes is what was meant; every set has its citation and terms."""

import functools
import hashlib
import http.server
import socket
import threading
import types

import numpy as np
import pytest
from scipy.io import savemat

from pysindy_nrf import datasets
from pysindy_nrf.exceptions import FileFormatError, NRFError
from pysindy_nrf.io import read_record
from pysindy_nrf.paper import cases


def test_every_set_has_a_loader_a_citation_and_terms(tmp_path):
    table = datasets.catalogue()
    loaders = {name for name in datasets.__all__ if name.startswith("load_")}
    assert loaders == set(table["loader"])
    assert table[["citation", "licence"]].map(len).to_numpy().min() > 5
    assert "Labcontrol" in str(datasets.about("load_mr_damper_cyclic"))
    with pytest.raises(NRFError, match="no data set 'emsp'.*emps"):
        datasets.about("emsp")


def test_the_licence_beside_the_data_is_read(tmp_path, monkeypatch):
    monkeypatch.delenv("PYSINDY_NRF_DATA", raising=False)
    about = datasets.about("mr_damper_cyclic")
    assert about.licence_text() == about.licence
    (tmp_path / "mr_damper_cyclic").mkdir()
    (tmp_path / "mr_damper_cyclic" / "LICENSE").write_text("MIT License\n\nCopyright")
    assert about.licence_text(tmp_path).startswith("MIT License\n")


def test_the_papers_cases_are_seeded():
    record = datasets.load_paper_two_dof("incomplete", 0.05, random_state=3)
    case = cases.two_dof("incomplete", 0.05, random_state=3)
    np.testing.assert_array_equal(record.acceleration, case.measured.acceleration)
    assert record.forced == (2,) and record.fs == cases.FS_TWO_DOF
    # 5 % of the rms of each channel is what stands between it and the exact record
    gap = np.std(record.acceleration - case.exact.acceleration, axis=0) / np.std(case.exact.acceleration, axis=0)
    np.testing.assert_allclose(gap, 0.05, rtol=0.03)


# -- by address -------------------------------------------------------------------------------


@pytest.fixture
def served(tmp_path):
    """A file on this machine's own loopback."""
    pytest.importorskip("pooch")
    content = b"t,x1\n0.0,1.0\n0.5,2.0\n"
    (tmp_path / "www").mkdir()
    (tmp_path / "www" / "test 1.csv").write_bytes(content)
    handler = functools.partial(_Quiet, directory=str(tmp_path / "www"))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/test%201.csv", hashlib.sha256(content).hexdigest(), content
    server.shutdown()
    server.server_close()


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *args):
        pass


def test_a_file_by_address_and_checksum(served, tmp_path, capsys):
    url, checksum, content = served
    path = datasets.fetch(url, checksum, tmp_path / "kept")
    assert path.read_bytes() == content and path.parent == tmp_path / "kept"
    assert datasets.fetch(url, checksum, tmp_path / "kept") == path
    with pytest.raises(NRFError, match="not the file that was meant"):
        datasets.fetch(url, "0" * 64, tmp_path / "other")
    assert not list((tmp_path / "other").glob("test*"))
    with pytest.raises(NRFError, match="cannot be had"):
        datasets.fetch(url.replace("test", "rest"), checksum, tmp_path / "other")
    assert capsys.readouterr().out == ""


def test_what_came_is_read_as_any_file(served, tmp_path):
    url, checksum, _ = served
    record = read_record(datasets.fetch(url, checksum, tmp_path / "kept"))
    assert record.fs == 2 and record.displacement.ravel().tolist() == [1.0, 2.0]


def test_a_kept_file_that_was_changed_is_fetched_again(served, tmp_path):
    """A checksum is of the file that is analysed, not of the one that once came."""
    url, checksum, content = served
    path = datasets.fetch(url, checksum, tmp_path / "kept")
    path.write_bytes(content.replace(b"2.0", b"9.9"))
    assert datasets.fetch(url, checksum, tmp_path / "kept").read_bytes() == content


class _CutOff(_Quiet):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "1000000")
        self.end_headers()
        self.wfile.write(b"t,x1\n0.0,1.0\n")


class _Failing(_Quiet):
    def do_GET(self):
        self.send_error(500)


@pytest.mark.parametrize("handler", [_CutOff, _Failing, None], ids=["cut off", "server error", "nobody answers"])
def test_a_download_that_fails_leaves_nothing(handler, tmp_path):
    pytest.importorskip("pooch")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler or _Quiet)
    url = f"http://127.0.0.1:{server.server_port}/test.csv"
    if handler is None:
        server.server_close()
    else:
        threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with pytest.raises(NRFError, match="cannot be had|not the file that was meant"):
            datasets.fetch(url, "0" * 64, tmp_path / "kept")
    finally:
        if handler is not None:
            server.shutdown()
            server.server_close()
    assert not list(tmp_path.rglob("*.csv"))


@pytest.mark.parametrize(
    ("url", "checksum", "words"),
    [
        ("file:///etc/passwd", "0" * 64, "no address on the web"),
        ("/etc/passwd", "0" * 64, "no address on the web"),
        ("https://example.org/a.csv", None, "no SHA-256"),
        ("https://example.org/a.csv", "abc", "no SHA-256"),
        ("https://example.org/..", "0" * 64, "names no file"),
    ],
)
def test_what_is_no_address_or_checksum(url, checksum, words):
    pytest.importorskip("pooch")
    with pytest.raises(NRFError, match=words):
        datasets.fetch(url, checksum)


# -- the public benchmarks --------------------------------------------------------------------


@pytest.fixture
def package(monkeypatch, tmp_path):
    """nonlinear_benchmarks as it answers, without the network: files appear in the folder it is given."""
    calls = []

    def emps(data_file_locations, dir_placement, force_download):
        calls.append(force_download)
        place = tmp_path / "got" / "EMPS"
        assert str(tmp_path / "got") == dir_placement
        place.mkdir(parents=True, exist_ok=True)
        print("downloading ...")
        if len(calls) > 1:  # the first attempt was cut off
            t = np.arange(100) / 1000
            savemat(place / "DATA_EMPS.mat", {"t": t[:, None], "qm": t[:, None], "vir": t[:, None], "gtau": 35.1507})
        return [str(place / "DATA_EMPS.mat"), str(place / "DATA_EMPS_PULSES.mat")]

    def silverbox(data_file_locations, dir_placement, force_download):
        savemat(tmp_path / "SNLS80mV.mat", {"V1": np.ones((1, 50)), "V2": np.zeros((1, 50))})
        return str(tmp_path / "Schroeder80mV.mat"), str(tmp_path / "SNLS80mV.mat")

    def nothing(**options):
        raise ConnectionError("no route to host")

    module = types.SimpleNamespace(EMPS=emps, Silverbox=silverbox)
    split = types.SimpleNamespace(BoucWen=nothing)
    from pysindy_nrf.datasets import download

    real = download.require
    fakes = {"nonlinear_benchmarks": module, "nonlinear_benchmarks.not_splitted_benchmarks": split}
    monkeypatch.setattr(download, "require", lambda name, *rest: fakes.get(name) or real(name, *rest))
    return calls


def test_emps_by_its_package(package, tmp_path, capsys):
    with pytest.warns(UserWarning, match="checksum differs"):
        rec = datasets.load_emps(tmp_path / "got", download=True)
    assert package == [False, True]  # repeated, since the first left no file
    np.testing.assert_allclose(rec.force[:, 0], 35.1507 * rec.time, atol=1e-12)
    assert capsys.readouterr().out == ""


def test_silverbox_by_its_package_and_from_a_folder(package, tmp_path):
    rec = datasets.load_silverbox(tmp_path, download=True)
    assert rec.fs == 610.35 and rec.n_samples == 50 and rec.forced == (1,)
    with pytest.raises(FileFormatError, match="does not hold silverbox/SNLS80mV.mat"):
        datasets.load_silverbox(tmp_path)


def test_no_network_is_a_sentence(package, tmp_path):
    with pytest.raises(NRFError, match="BoucWen cannot be had: no route to host.*nonlinearbenchmark.org"):
        datasets.load_bouc_wen_benchmark(folder=tmp_path, download=True)


def test_nothing_is_downloaded_unasked(monkeypatch, tmp_path):
    def refuse(*args, **options):
        raise AssertionError("a connection was opened")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    for load in (datasets.load_emps, datasets.load_silverbox):
        with pytest.raises(FileFormatError, match="does not hold"):
            load(tmp_path)
    with pytest.raises(FileFormatError, match="does not hold"):
        datasets.load_bouc_wen_benchmark(folder=tmp_path)
