"""The paper's cases as records, generated and seeded; the truth behind them is in :mod:`pysindy_nrf.paper.cases`."""

from __future__ import annotations

from ..record import Record


def load_paper_two_dof(excitation: str = "incomplete", noise: float = 0.05, *, random_state: int = 0) -> Record:
    """The paper's 2-DOF frame with an MR damper in storey 1 (section 3).

    Parameters
    ----------
    excitation : {"complete", "incomplete"}
        Random forces on both floors, or on floor 2 only.
    noise : float
        Share of the rms of each channel, forces included.
    random_state : int

    Returns
    -------
    Record
        ``F``, ``a``, ``v``, ``x`` of both floors, SI units; 1000 Hz, 20 s.

    See Also
    --------
    pysindy_nrf.paper.cases.two_dof : The same with the truth: masses 10 kg, storey forces, damper force.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> datasets.load_paper_two_dof().name
    '2 DOF, incomplete, 5% noise'
    """
    from ..paper.cases import two_dof

    return two_dof(excitation, noise, random_state=random_state).measured


def load_paper_four_storey(
    floors: tuple[int, ...] = (1, 2, 3, 4), friction: float = 20.0, noise: float = 0.0, *, level: float = 1000.0,
    random_state: int = 0,
) -> Record:  # fmt: skip
    """The paper's four-storey frame under hammer blows, with a damper in storey 4 (section 4).

    Parameters
    ----------
    floors : tuple of int
        Floors that are hit.
    friction : float
        Of the dampers, N; 0 for the linear frame.
    noise : float
        Share of the rms of each channel.
    level : float
        Largest peak of the blows, N.
    random_state : int

    Returns
    -------
    Record
        ``F``, ``a``, ``x`` of the floors, SI units; 1024 Hz, 32 s.

    See Also
    --------
    pysindy_nrf.paper.cases.four_storey : The same with the truth.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> record = datasets.load_paper_four_storey(floors=(4,), friction=0.0)
    >>> record.n_dof, record.forced, record.fs, record.name
    (4, (4,), 1024.0, 'frame, floor 4 hit, 1000 N, damper 0 N, 0% noise')
    """
    from ..paper.cases import four_storey

    return four_storey(tuple(floors), friction, noise, level=level, random_state=random_state).measured
