"""The linear algebra of a chain: equations, their sums of products, and the solve.

``BalanceEquations`` are the equations of motion of records in which every floor is
measured. ``NormalEquations`` are their sums by block of samples: add, leave a block
out, change columns. ``chain_solve.solve`` is the general solve. A search solves many
sums at once (``ManySolver``): by ``CompiledChainSolve`` where every floor is measured,
by ``ChannelSolve`` where some have no sensor.
"""

from ..common.lazy import public_names

_NAMES = {
    "BalanceEquations": "balances",
    "ChannelSolve": "many_solves",
    "CompiledChainSolve": "many_solves",
    "ManySolver": "protocol",
    "NormalEquations": "normal_equations",
    "NotTogether": "least_squares",
    "ProductSums": "accumulation",
    "Regression": "ridge_regression",
    "balance_sizes": "errors",
    "blocks_of_segment": "balances",
    "free_run_by_either": "free_runs",
    "groups_of": "normal_equations",
    "in_blocks": "ridge_regression",
    "leave_one_out": "jackknife",
    "needs_samples": "inner_optimizer",
    "nrmse": "errors",
    "pieces_of": "accumulation",
    "share_of": "jackknife",
    "solve": "chain_solve",
    "solve_blocks": "chain_solve",
    "total_products": "accumulation",
    "variance": "jackknife",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
