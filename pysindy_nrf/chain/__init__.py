"""The chain: DOFs, storeys, links, and the balances that an excitation can identify."""

from ..common.lazy import public_names

_NAMES = {
    "Chain": "structure",
    "ChainModel": "model",
    "LawLayout": "layout",
    "Layout": "layout",
    "Site": "sites",
    "VisitedRegion": "visited_region",
    "blocks_of": "layout",
    "plan_solve_order": "identifiability",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
