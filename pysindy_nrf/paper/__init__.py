"""The paper this package starts from: its published numbers, and its test cases generated anew.

"Data-based identification of nonlinear restoring force under spatially incomplete excitations with
power series polynomial model". :mod:`.published` holds what it prints, :mod:`.cases` what it tests.
"""

from . import cases, published

__all__ = ["cases", "published"]
