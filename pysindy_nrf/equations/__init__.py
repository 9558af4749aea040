"""The linear algebra of a chain: equations, their sums of products, and the solve.

``Equations`` is what a search asks of columns and right-hand sides;
``BalanceEquations`` are those of records in which every floor is measured.
``NormalEquations`` are their sums by block of samples: add, leave a block out, change
columns. ``chain_solve.solve`` is the general solve; ``many_solves.CompiledChainSolve``
is the same, compiled, for the many candidates of a search.
"""
