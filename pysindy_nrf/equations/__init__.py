"""The linear algebra of a chain: equations, their sums of products, and the solve.

``Equations`` is what a search asks of columns and right-hand sides;
``BalanceEquations`` are those of records in which every floor is measured.
``NormalEquations`` are their sums by block of samples: add, leave a block out, change
columns. ``chain_solve.solve`` is the general solve; ``many_solves.CompiledChainSolve``
is the same, compiled, for the many candidates of a search.
"""

from ..common.lazy import public_names

_NAMES = {
    "BalanceEquations": "balances",
    "Equations": "protocol",
    "NormalEquations": "normal_equations",
    "groups_of": "chain_solve",
    "nrmse": "errors",
    "solve": "chain_solve",
    "total_gram": "accumulation",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
