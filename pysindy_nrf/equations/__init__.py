"""Columns, moments, the one chain solve, error measures and the PySINDy face."""
