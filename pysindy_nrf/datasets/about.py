"""Where each data set comes from, how to cite it, and under what terms it may be used."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ..exceptions import NRFError


@dataclass(frozen=True)
class DataSet:
    """What is known about a data set.

    Attributes
    ----------
    name : str
    title : str
        What was tested.
    kind : {"measured", "simulated"}
    loader : str
        Function of :mod:`pysindy_nrf.datasets`.
    citation : str
        How to cite it.
    licence : str
        Terms as its publisher states them.
    source : str
        Where to get it; empty if it comes with the package.
    folder : str
        Sub-folder that the loader looks into.
    licence_file : str
        File of the sub-folder that holds the licence, if there is one.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> emps = datasets.about("emps")
    >>> emps.loader, emps.kind, emps.folder
    ('load_emps', 'measured', 'emps')
    """

    name: str
    title: str
    kind: str
    loader: str
    citation: str
    licence: str
    source: str = ""
    folder: str = ""
    licence_file: str = ""

    def licence_text(self, folder: Any = None) -> str:
        """The licence: its file if it lies beside the data, else what the publisher states.

        Parameters
        ----------
        folder : path-like, optional
            See :func:`data_folder`.

        Returns
        -------
        str
        """
        from .folder import data_folder

        if self.licence_file:
            try:
                path = Path(data_folder(folder), self.folder, self.licence_file)
            except NRFError:
                return self.licence
            if path.is_file():
                return path.read_text(encoding="utf-8", errors="replace")
        return self.licence

    def __str__(self) -> str:
        lines = [f"{self.name}: {self.title} ({self.kind}); datasets.{self.loader}", f"  Cite: {self.citation}"]
        lines.append(f"  Terms: {self.licence}")
        return "\n".join([*lines, f"  From: {self.source}"] if self.source else lines)


_NONE = "The set states no licence; ask its authors before you pass it on."
_OURS = "Made by this package, MIT licence."
_SITE = "nonlinearbenchmark.org"
_PAPER = (
    "Data-based identification of nonlinear restoring force under spatially incomplete excitations with power series "
    "polynomial model"
)

_SETS = (
    DataSet("demo", "three-storey frame, shaker on floor 2, ground storey hardens", "simulated", "load_demo",
            "pysindy_nrf, benchmarks/make_demo_record.py", _OURS),
    DataSet("paper_two_dof", "2-DOF frame with an MR damper", "simulated", "load_paper_two_dof",
            f"{_PAPER}, section 3; records generated anew", _OURS),
    DataSet("paper_four_storey", "four-storey frame hit by a hammer, damper in storey 4", "simulated",
            "load_paper_four_storey", f"{_PAPER}, section 4; records generated anew", _OURS),
    DataSet("emps", "electro-mechanical positioning stage", "measured", "load_emps",
            "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, Workshop on Nonlinear System "
            "Identification Benchmarks, Eindhoven, 2019", _NONE, _SITE, "emps"),
    DataSet("silverbox", "electronic Duffing oscillator", "measured", "load_silverbox",
            "T. Wigren, J. Schoukens, Three free data sets for development and benchmarking in nonlinear system "
            "identification, European Control Conference, 2013, 2933-2938",
            "Published as a free data set; no licence is stated.", _SITE, "silverbox"),
    DataSet("bouc_wen_benchmark", "one DOF with a Bouc-Wen hysteresis", "simulated", "load_bouc_wen_benchmark",
            "J. P. Noel, M. Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System "
            "Identification Benchmarks, Brussels, 2016", _NONE, _SITE, "bouc_wen_benchmark"),
    DataSet("nees_three_storey", "three-storey steel frame on a shaking table", "measured", "load_nees_three_storey",
            "A. Masroor, G. Mosqueda, report MCEER-13-0003, University at Buffalo, 2013", _NONE,
            "NEES project, University at Buffalo", "nees_three_storey"),
    DataSet("dry_friction_storey", "one-storey frame rubbing on the laboratory", "measured",
            "load_dry_friction_storey",
            "C. Lathourakis, A. Cicirello, Nonlinear Dynamics, 2024, doi 10.1007/s11071-024-09652-2", _NONE,
            "doi 10.1007/s11071-024-09652-2", "dry_friction_storey"),
    DataSet("mr_damper_white_noise", "MR damper under white-noise displacement", "measured",
            "load_mr_damper_white_noise", "S. Dyke, NEES-2012-1158, doi 10.4231/D3V11VM6X", _NONE,
            "doi 10.4231/D3V11VM6X", "mr_damper_white_noise"),
    DataSet("mr_damper_cyclic", "MR damper under cyclic displacement, 82 runs", "measured", "load_mr_damper_cyclic",
            "A. N. Vargas, doi 10.5281/zenodo.4445334", "MIT licence, Copyright (c) 2021 Labcontrol",
            "doi 10.5281/zenodo.4445334", "mr_damper_cyclic", "LICENSE"),
    DataSet("six_storey_hotel", "six-storey hotel in 21 earthquakes", "measured", "load_six_storey_hotel",
            "R. Zhang, Y. Liu, H. Sun, Physics-guided convolutional neural network (PhyCNN) for data-driven seismic "
            "response modeling, Engineering Structures, 2020", "MIT licence", "github.com/zhry10/PhyCNN",
            "six_storey_hotel"),
    DataSet("three_storey_frf", "three-storey aluminium frame, shaker on floor 1", "measured",
            "load_three_storey_frf", "University of Southampton, digital twin of a three-storey frame, 2020",
            "BSD 3-clause licence", "University of Southampton", "three_storey_frf"),
)  # fmt: skip


def about(name: str) -> DataSet:
    """Citation, terms and source of a data set.

    Parameters
    ----------
    name : str
        One of :func:`catalogue`'s index, or its loader's name.

    Returns
    -------
    DataSet
        ``print`` it.

    Raises
    ------
    NRFError
        If there is no such set.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> print(datasets.about("mr_damper_cyclic"))
    mr_damper_cyclic: MR damper under cyclic displacement, 82 runs (measured); datasets.load_mr_damper_cyclic
      Cite: A. N. Vargas, doi 10.5281/zenodo.4445334
      Terms: MIT licence, Copyright (c) 2021 Labcontrol
      From: doi 10.5281/zenodo.4445334
    """
    for one in _SETS:
        if name in (one.name, one.loader):
            return one
    raise NRFError(f"There is no data set {name!r}", f"Known are {', '.join(one.name for one in _SETS)}.")


def catalogue() -> pd.DataFrame:
    """All data sets.

    Returns
    -------
    DataFrame
        By name: ``title``, ``kind``, ``loader``, ``citation``, ``licence``, ``source``.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> table = datasets.catalogue()
    >>> table.loc["emps", "loader"], table.loc["demo", "kind"]
    ('load_emps', 'simulated')
    """
    table = pd.DataFrame([asdict(one) for one in _SETS]).set_index("name")
    return table[["title", "kind", "loader", "citation", "licence", "source"]]
