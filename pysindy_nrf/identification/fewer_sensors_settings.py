"""Numbers by which a free run is fitted to fewer channels than floors."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FewerSensorsSettings:
    """Settings of the fit to records in which floors have no sensor.

    "Chosen" are numbers of which nothing was measured but the results of the entire
    method: 300 random chains a row in ``docs/fewer_sensors.md``.

    Attributes
    ----------
    max_steps : int
        Iterations of a fit at most. Chosen; narrow valleys take some fifty.
    law_steps : int
        Iterations of a fit of declared laws at most. Chosen; runs are integrated there.
    trial_steps : int
        Iterations of a trial, by which starts are ranked. Chosen.
    settled : float
        Standard errors; a fit ends when a full step is shorter. A longer one left one
        in twenty chains of four and five floors 39 to 65 % off.
    followed : int
        Best trials that are followed whatever others there are. Chosen.
    max_mass_ratio : float
        Largest mass over smallest from which on a chain is followed only if there is no
        other: one of its floors hardly moves. Chosen.
    max_cost_ratio : float
        Cost of a trial over the least, above which it is not followed. Chosen.
    noise_rounds : int
        Rounds of noise and estimate. The second changes weights by a few percent.
    min_window : int
        Samples of a window at least, in which declared laws are fitted first. Chosen.
    max_windows : int
        Windows at most. Chosen.
    first_shapes : tuple of float
        First values of shape parameters, as shares of the way between their bounds.
        Chosen.
    first_damping : float
        Damping ratio of the lowest mode of a chain that is known from drawings. Usual
        for steel frames.
    rival_level : float
        Level of the joint confidence region in which another chain explains the data as
        well. Convention; see ``docs/fewer_sensors.md``.
    rival_distance : float
        Difference of logarithms of masses from which on a chain is another one. Chosen.
    reported_error : float
        Standard error of a mass or stiffness, as a share of it, that is reported.
        Convention.
    refused_error : float
        Standard error, as a share, or error of the free run from which on an estimate
        is refused: a 95 % interval then holds zero. Convention.
    sure_sign : float
        Standard error, as a share, below which a sign is sure: three of them.
        Convention.
    contradicted : float
        Standard deviations from a prior that contradict it: p = 0.001. Convention.
    max_condition : float
        Condition of the sensitivities, each of length one, from which on parameters are
        not distinguished. Sensitivities are exact to nine digits.
    exact_spread : float
        Spread of an equation without spread, as a share of its terms: round-off of the
        sensitivities.
    level : float
        Of the intervals of motions. Convention.
    noise_margin : float
        Times the rms of a channel's white noise, up to which a gap is no error of the
        model. Chosen; the level of white noise is known to a factor of two.
    """

    max_steps: int = 100
    law_steps: int = 50
    trial_steps: int = 6
    settled: float = 0.02
    followed: int = 2
    max_mass_ratio: float = 100.0
    max_cost_ratio: float = 3.0
    noise_rounds: int = 2
    min_window: int = 150
    max_windows: int = 8
    first_shapes: tuple[float, ...] = (0.3, 0.5, 0.7)
    first_damping: float = 0.01
    rival_level: float = 0.999
    rival_distance: float = 0.2
    reported_error: float = 0.1
    refused_error: float = 0.5
    sure_sign: float = 0.33
    contradicted: float = 3.3
    max_condition: float = 1e9
    exact_spread: float = 1e-6
    level: float = 0.95
    noise_margin: float = 2.0


SETTINGS = FewerSensorsSettings()
