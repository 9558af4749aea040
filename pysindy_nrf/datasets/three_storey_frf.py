"""Frequency responses of a three-storey aluminium frame."""

from __future__ import annotations

from typing import Any

from ..io import FrequencyResponse, read_frf
from .folder import data_file


def load_three_storey_frf(folder: Any = None) -> FrequencyResponse:
    r"""Three-storey aluminium frame with a shaker on floor 1 only: measured frequency responses.

    Parameters
    ----------
    folder : path-like, optional
        See :func:`data_folder`; the file is ``three_storey_frf/cristallo_Experimental.csv``.

    Returns
    -------
    FrequencyResponse
        Accelerance of floors 1 to 3, 0.03125 Hz steps to 128 Hz; useful from 4 to 32 Hz.

    Raises
    ------
    NRFError
        If the folder or the file is missing.

    Notes
    -----
    University of Southampton, BSD-3 licence. Linear, three storeys of equal mass, 5.201 kg by its
    metadata; the scale of the responses is not stated, so the masses are judged against each other.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "three_storey_frf")
    ...     place.mkdir()
    ...     lines = [f"{k / 32}+0j;0.1+0.2j;0.1-0.1j;0.05+0j" for k in range(1, 65)]
    ...     _ = (place / "cristallo_Experimental.csv").write_text("\n".join(lines))
    ...     response = datasets.load_three_storey_frf(folder)
    >>> response.n_dof, response.driven, float(response.f[-1])  # Hz
    (3, 1, 2.0)
    """
    return read_frf(data_file(folder, "three_storey_frf", "cristallo_Experimental.csv"), driven=1)
