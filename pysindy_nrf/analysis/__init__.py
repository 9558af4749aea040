"""What one does with an identified chain: damper forces, energies, location and change of nonlinearity."""

from .agreement import found_twice, model_agreement, total_mass
from .bias import missing_terms, warn_of_bias
from .change import ChangeReport, compare_tests
from .damper_force import damper_force
from .energy import dissipated_energy, energy_shares, path_energy, power_energy
from .jumps import jump_bias_of
from .linear_twin import linear_part, linear_twin
from .load_cell import horizontal_component
from .moving_window import Onset, find_onset, track
from .planarity import Location, locate_nonlinearity, planarity

__all__ = [
    "linear_twin",
    "linear_part",
    "damper_force",
    "path_energy",
    "power_energy",
    "dissipated_energy",
    "energy_shares",
    "planarity",
    "locate_nonlinearity",
    "Location",
    "horizontal_component",
    "total_mass",
    "model_agreement",
    "found_twice",
    "compare_tests",
    "ChangeReport",
    "track",
    "find_onset",
    "Onset",
    "jump_bias_of",
    "missing_terms",
    "warn_of_bias",
]
