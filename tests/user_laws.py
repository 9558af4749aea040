"""Force laws as a user would write them, for tests of what is done with any law."""

from __future__ import annotations

from pysindy_nrf.laws.base import ForceLaw, Term


class Parametric(ForceLaw):
    """A spring that a channel sets, and a damper that grows with time."""

    name = "test_parametric"
    covariates = ("u",)
    uses_time = True

    def terms(self):
        return (Term("k", "u s", "N/m"), Term("b", "t v", "N/m"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0] * s
        out[1] = t * v
