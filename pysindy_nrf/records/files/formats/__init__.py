"""Formats of files. A new one is a module with its reader and an entry here."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ....exceptions import FileFormatError
from ..table import Table
from .delimited import read_delimited
from .excel import read_excel
from .ground_motion import is_smc, read_knet, read_peer, read_smc
from .hdf5 import HDF5_SIGNATURE, read_hdf5
from .lvm import read_lvm
from .matlab import read_mat
from .numpy_files import read_npy, read_npz
from .parquet import read_parquet
from .strong_motion import is_strong_motion, read_strong_motion
from .tdms import read_tdms
from .uff import read_uff

HEAD_BYTES = 400  # in which a format shows


@dataclass(frozen=True)
class FileFormat:
    """One kind of file.

    Parameters
    ----------
    name : str
    suffixes : tuple of str
        In small letters with their point, the usual one first.
    read : callable
        ``read(path, max_bytes)`` gives a :class:`Table`, and refuses a content of more
        bytes.
    signatures : tuple of bytes
        The first bytes of such a file, where they are always the same.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, int], Table]
    signatures: tuple[bytes, ...] = ()


DELIMITED_TEXT = FileFormat(
    "delimited text", (".csv", ".txt", ".tsv", ".dat", ".asc"), read_delimited
)
PARQUET = FileFormat("Parquet", (".parquet", ".pq"), read_parquet, (b"PAR1",))
HDF5 = FileFormat("HDF5", (".h5", ".hdf5"), read_hdf5, (HDF5_SIGNATURE,))
MATLAB = FileFormat(
    "MATLAB", (".mat",), read_mat, (b"MATLAB 5.0", b"MATLAB 7.3", HDF5_SIGNATURE)
)
NUMPY_ARCHIVE = FileFormat("NPZ", (".npz",), read_npz, (b"PK\x03\x04",))
NUMPY_ARRAY = FileFormat("NumPy", (".npy",), read_npy, (b"\x93NUMPY",))
UFF = FileFormat("UFF", (".uff", ".unv"), read_uff)
EXCEL = FileFormat("Excel", (".xlsx", ".xlsm"), read_excel, (b"PK\x03\x04",))
TDMS = FileFormat("TDMS", (".tdms",), read_tdms, (b"TDSm",))
STRONG_MOTION = FileFormat(
    "strong motion", (".v2", ".v2c", ".v1", ".v1c", ".v0c"), read_strong_motion
)
LVM = FileFormat("LabVIEW measurement", (".lvm",), read_lvm, (b"LabVIEW Measurement",))
PEER = FileFormat("PEER", (".at2", ".vt2", ".dt2"), read_peer)
KNET_SUFFIXES = tuple(
    f".{direction}{place}"
    for place in ("", "1", "2")
    for direction in ("ew", "ns", "ud")
)
KNET = FileFormat("K-NET", KNET_SUFFIXES, read_knet)
SMC = FileFormat("SMC", (".smc",), read_smc)

FORMATS = (
    DELIMITED_TEXT,
    PARQUET,
    HDF5,
    MATLAB,
    EXCEL,
    NUMPY_ARCHIVE,
    NUMPY_ARRAY,
    TDMS,
    UFF,
    STRONG_MOTION,
    LVM,
    PEER,
    KNET,
    SMC,
)


def format_called(path: Path) -> FileFormat | None:
    """The format that the suffix of a file's name stands for, None if it is unknown."""
    suffix = path.suffix.lower()
    for file_format in FORMATS:
        if suffix in file_format.suffixes:
            return file_format
    return None


def format_of(path: Path) -> FileFormat:
    """The format of a file that exists.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, or the file begins as one of another format.
    """
    called = format_called(path)
    if called is None:
        raise _unknown_type(path)

    with open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
    begins_as = [f for f in FORMATS if head.startswith(f.signatures)]
    if begins_as and called not in begins_as:
        raise _wrong_suffix(path, begins_as)

    if called is DELIMITED_TEXT:
        return _archive_in_text(head.decode("latin-1")) or called
    return called


def _archive_in_text(head: str) -> FileFormat | None:
    """The format of an archive that is called a text; None for any other text."""
    if is_smc(head):
        return SMC
    if is_strong_motion(head):
        return STRONG_MOTION
    first = head.lstrip().upper()
    if first.startswith("PEER "):
        return PEER
    if first.startswith("ORIGIN TIME") and "STATION CODE" in first:
        return KNET
    return None


def _unknown_type(path: Path) -> FileFormatError:
    suffixes: list[str] = []
    for file_format in FORMATS:
        suffixes += file_format.suffixes
    return FileFormatError(
        f"{path} has the type {path.suffix.lower() or '(none)'}, which is not read",
        f"Supported types are {' '.join(suffixes)}.",
    )


def _wrong_suffix(path: Path, begins_as: list[FileFormat]) -> FileFormatError:
    suffix = path.suffix.lower()
    names = " or ".join(f.name for f in begins_as)
    right_suffixes = " or ".join(f.suffixes[0] for f in begins_as)
    return FileFormatError(
        f"{path} is called {suffix} but holds {names}",
        f"Rename it to {right_suffixes}, or export it as {suffix}.",
    )
