"""PySINDy: feature libraries, optimizers, and a comparison with plain SINDy."""

from ..common.lazy import public_names

_NAMES = {
    "ChainOptimizer": "optimizers",
    "ForceLawLibrary": "feature_library",
    "InterstoryPolynomialLibrary": "feature_library",
    "ShearSINDy": "shears",
    "StateSpaceChainOptimizer": "optimizers",
    "compare_with_sindy": "comparison",
    "from_sindy": "state_space",
    "storey_shears": "shears",
    "to_sindy": "state_space",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
