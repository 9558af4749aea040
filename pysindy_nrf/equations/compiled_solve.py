"""Compiled: the solve of many sums of products, step by step of a solve order."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

# Roles of a column in a step of the solve order: unknown coefficient, coefficient that
# was found before, unknown mass.
UNKNOWN, KNOWN, MASS = range(3)
# Share of a unit column, times one more than the number of columns, below which it
# depends on the columns before it: round-off of a Cholesky factor.
PIVOT = 9e-16


@cache
def compiled_solve() -> Callable[..., None]:
    """The compiled function.

    Its arguments are:

    - sums of products (n_fits, n_groups, p, p);
    - whether dependent columns give NaN, or zero for one of them;
    - the number of DOFs, and the row of a_1;
    - the three tables of a solve order;
    - masses (n_fits, n_dof), with known ones preset, and coefficients (n_fits, p), to
      which it writes.
    """
    from ..common.compiled import address_of, addresses, jit, subroutine

    # long, because a call inside compiled code is a place where the compiler stops
    def least_squares(gram, p, columns, width, target, values, work, strict):
        """Solve for columns scaled to unit length; False where they are dependent."""
        scale = address_of(work, p * p)
        for i in range(width):
            size = gram[columns[i] * (p + 1)]
            if not (size < np.inf and (size > 0.0 or not strict)):
                return False
            scale[i] = 1.0 / math.sqrt(size) if size > 0.0 else 0.0

        for i in range(width):
            row = address_of(work, i * p)
            products = address_of(gram, columns[i] * p)
            dot = 0.0
            for j in range(p):
                if target[j] != 0.0:
                    dot += products[j] * target[j]
            values[i] = dot * scale[i]

            # Cholesky factor, row by row, and forward substitution
            for j in range(i + 1):
                above = address_of(work, j * p)
                rest = products[columns[j]] * scale[i] * scale[j]
                for k in range(j):
                    rest -= row[k] * above[k]
                if i != j:
                    row[j] = rest / above[j]
                elif rest > PIVOT * (width + 1):
                    row[i] = math.sqrt(rest)
                elif not strict:
                    # its coefficient becomes zero
                    row[i] = np.inf
                else:
                    return False
            for k in range(i):
                values[i] -= row[k] * values[k]
            values[i] /= row[i]

        for i in range(width - 1, -1, -1):
            for k in range(i + 1, width):
                values[i] -= work[k * p + i] * values[k]
            values[i] /= work[i * p + i]
        for i in range(width):
            values[i] *= scale[i]
        return True

    solved = subroutine(least_squares)

    def chain(
        fit,
        strict,
        n,
        first_mass,
        steps,
        entries,
        dofs,
        masses,
        theta,
        scratch,
        columns,
    ):
        n_fits = fit.shape[0]
        n_groups = fit.shape[1]
        p = fit.shape[2]
        n_steps = steps.shape[0]
        fit, steps, entries, dofs, masses, theta, target, columns = addresses(
            (fit, steps, entries, dofs, masses, theta, scratch, columns)
        )
        values = address_of(target, p)
        work = address_of(target, 2 * p)

        for b in range(n_fits):
            coefficients = address_of(theta, b * p)
            weights = address_of(masses, b * n)
            for i in range(n_steps):
                step = address_of(steps, 6 * i)
                # right-hand side: forces less what is known of inertia and laws
                for k in range(p):
                    target[k] = 0.0
                for d in range(step[3], step[4]):
                    target[first_mass + n + dofs[d]] += 1.0
                    if not step[5]:
                        target[first_mass + dofs[d]] -= weights[dofs[d]]
                width = np.int64(0)
                for e in range(step[1], step[2]):
                    entry = address_of(entries, 4 * e)
                    if entry[2] == KNOWN:
                        target[entry[0]] -= entry[1] * coefficients[entry[0]]
                    else:
                        columns[width] = entry[0]
                        width += 1

                gram = address_of(fit, (b * n_groups + step[0]) * p * p)
                if not solved(gram, p, columns, width, target, values, work, strict):
                    for k in range(p):
                        coefficients[k] = np.nan
                    break

                width = np.int64(0)
                for e in range(step[1], step[2]):
                    entry = address_of(entries, 4 * e)
                    if entry[2] == UNKNOWN:
                        coefficients[entry[0]] = entry[1] * values[width]
                    elif entry[2] == MASS:
                        weights[entry[3]] = values[width]
                    if entry[2] != KNOWN:
                        width += 1

    compiled = jit(chain)

    def solve(
        fit: np.ndarray,
        strict: bool,
        n: int,
        first_mass: int,
        steps: np.ndarray,
        entries: np.ndarray,
        dofs: np.ndarray,
        masses: np.ndarray,
        theta: np.ndarray,
    ) -> None:
        p = fit.shape[2]
        scratch = np.empty(p * (p + 3))
        columns = np.empty(p, dtype=np.int64)
        compiled(
            fit,
            strict,
            n,
            first_mass,
            steps,
            entries,
            dofs,
            masses,
            theta,
            scratch,
            columns,
        )

    return solve
