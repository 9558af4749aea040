"""Records to learn and to test with: one that is bundled, and loaders for public measured sets.

Nothing is ever downloaded. The measured sets are read from a folder that you name, or that the
environment variable ``PYSINDY_NRF_DATA`` names; each loader's docstring says where the set comes
from and under what terms.
"""

from .bouc_wen import load_bouc_wen_benchmark
from .demo import demo_truth, load_demo
from .dry_friction import load_dry_friction_storey
from .emps import load_emps
from .folder import data_folder
from .hotel import load_six_storey_hotel
from .mr_damper import load_mr_damper_cyclic, load_mr_damper_white_noise, mr_damper_cyclic_runs
from .nees import load_nees_three_storey
from .three_storey_frf import load_three_storey_frf

__all__ = [
    "data_folder",
    "demo_truth",
    "load_bouc_wen_benchmark",
    "load_demo",
    "load_dry_friction_storey",
    "load_emps",
    "load_mr_damper_cyclic",
    "load_mr_damper_white_noise",
    "load_nees_three_storey",
    "load_six_storey_hotel",
    "load_three_storey_frf",
    "mr_damper_cyclic_runs",
]
