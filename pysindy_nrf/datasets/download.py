"""Data sets from elsewhere, only when asked for: public benchmarks, or a URL with its checksum."""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
import warnings
from pathlib import Path
from typing import Any

from .._extras import require
from ..exceptions import DataQualityWarning, NRFError

# SHA-256 of the publishers' files that the loaders were written for.
KNOWN = {
    "DATA_EMPS.mat": "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
    "uval_multisine.mat": "3eb9abc0aef66b97beaf003fbcb45b43a4e28d7e82db5bf8abc1c931b92106ed",
    "yval_multisine.mat": "05e462f7c508c26c8e69549e2b80ff5acea2828b399175c8bdd3fa70eb9905bc",
    "uval_sinesweep.mat": "fefd6c08bbf3b27f13f61a15ea0dd8c63211c5924e99f6ca43760d1f25ce9ed3",
    "yval_sinesweep.mat": "52b49f7ff62487bf75efbed95bf759b06d8bad1127a8e63bc242e119d72bc57b",
}


def fetch(url: str, sha256: str, folder: Any = None) -> Path:
    """Download a file once, and check what came.

    Parameters
    ----------
    url : str
        ``https://``, ``http://`` or ``doi:``.
    sha256 : str
        Checksum of the file, 64 hexadecimal digits. There is no way around it: what you analyse is what you meant.
    folder : path-like, optional
        Where to keep it; the user's cache if None.

    Returns
    -------
    Path

    Raises
    ------
    NRFError
        If the checksum is no checksum or does not fit, or the file cannot be had.
    MissingExtraError
        Without pooch, which the extra ``datasets`` brings.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> datasets.fetch("https://example.org/frame.csv", sha256="unknown")
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.NRFError: sha256='unknown' is no SHA-256 checksum. Give the 64 hexadecimal digits
    of the file.
    """
    pooch = require("pooch", "datasets", "Downloading data")
    if not re.match(r"(https?://|doi:)", str(url)):
        raise NRFError(f"{url!r} is no address on the web", "Give https://..., or the path of a file to its loader.")
    if not re.fullmatch(r"[0-9a-fA-F]{64}", str(sha256)):
        raise NRFError(f"sha256={sha256!r} is no SHA-256 checksum", "Give the 64 hexadecimal digits of the file.")
    name = re.sub(r"[^\w.-]", "_", str(url).split("?")[0].rstrip("/").rsplit("/", 1)[-1])
    if not name.strip("._"):
        raise NRFError(f"{url!r} names no file", "Give the address of the file itself.")
    pooch.get_logger().setLevel("WARNING")
    try:
        found = pooch.retrieve(
            str(url), f"sha256:{sha256.lower()}", fname=name, path=folder if folder is not None else cache()
        )
    except ValueError as error:  # the checksum; pooch has deleted what came
        raise NRFError(f"{url} is not the file that was meant: {error}", "Check checksum and source.") from error
    except Exception as error:  # what requests and ftplib raise
        raise NRFError(f"{url} cannot be had: {error}", "Check the network, or get the file by hand.") from error
    return Path(found)


def cache() -> Path:
    """The user's folder for downloaded data."""
    return Path(require("pooch", "datasets", "Downloading data").os_cache("pysindy_nrf"))


def benchmark(name: str, folder: Any, wanted: str) -> Path:
    """A file of nonlinearbenchmark.org, downloaded by the package nonlinear-benchmarks if it is not there yet.

    Parameters
    ----------
    name : {"EMPS", "Silverbox", "BoucWen"}
    folder : path-like or None
        Where to keep it; the user's cache if None.
    wanted : str
        Name of the file.

    Returns
    -------
    Path
    """
    package = "nonlinear_benchmarks"
    module = f"{package}.not_splitted_benchmarks" if name == "BoucWen" else package
    get = getattr(require(module, "datasets", "Downloading benchmarks"), name)
    place = cache() if folder is None else Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    for again in (False, True):  # a download that was cut off is repeated
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                found = get(data_file_locations=True, dir_placement=str(place), force_download=again)
        except Exception as error:  # whatever the network, the archive or the package raises
            if again:
                raise NRFError(
                    f"The benchmark {name} cannot be had: {error}",
                    "Check the network, or get it from nonlinearbenchmark.org by hand and pass its folder.",
                ) from error
            continue
        paths = [Path(found, wanted)] if isinstance(found, str) else [Path(p) for p in found]
        hit = next((p for p in paths if p.name == wanted and p.is_file()), None)
        if hit is not None:
            _compare(hit)
            return hit
    raise NRFError(f"The benchmark {name} does not hold {wanted}", "Get it from nonlinearbenchmark.org by hand.")


def _compare(path: Path) -> None:
    known = KNOWN.get(path.name)
    if known is not None and hashlib.sha256(path.read_bytes()).hexdigest() != known:
        warnings.warn(
            f"{path} is not the file that this loader was written for (its checksum differs): check the record.",
            DataQualityWarning,
            stacklevel=4,
        )
