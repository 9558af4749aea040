"""Records to learn and to test with: one that is bundled, and loaders for public measured sets.

Nothing is downloaded unless you ask for it (``download=True``, or :func:`fetch` with a checksum). The measured sets are
read from a folder that you name, or that the environment variable ``PYSINDY_NRF_DATA`` names; ``print(about(name))``
says where a set comes from, how to cite it and under what terms it may be used.
"""

from .about import DataSet, about, catalogue
from .bouc_wen import load_bouc_wen_benchmark
from .demo import demo_truth, load_demo
from .download import fetch
from .dry_friction import load_dry_friction_storey
from .emps import load_emps
from .folder import data_folder
from .hotel import load_six_storey_hotel
from .mr_damper import load_mr_damper_cyclic, load_mr_damper_white_noise, mr_damper_cyclic_runs
from .nees import load_nees_three_storey
from .paper import load_paper_four_storey, load_paper_two_dof
from .silverbox import load_silverbox
from .three_storey_frf import load_three_storey_frf

__all__ = [
    "DataSet",
    "about",
    "catalogue",
    "data_folder",
    "demo_truth",
    "fetch",
    "load_bouc_wen_benchmark",
    "load_demo",
    "load_dry_friction_storey",
    "load_emps",
    "load_mr_damper_cyclic",
    "load_mr_damper_white_noise",
    "load_nees_three_storey",
    "load_paper_four_storey",
    "load_paper_two_dof",
    "load_silverbox",
    "load_six_storey_hotel",
    "load_three_storey_frf",
    "mr_damper_cyclic_runs",
]
