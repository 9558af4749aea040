"""PySINDy: feature libraries, optimizers, and a comparison with plain SINDy."""
