"""The bundled demonstration record, and the frame it was simulated with."""

from .demo import demo_truth, load_demo

__all__ = ["demo_truth", "load_demo"]
