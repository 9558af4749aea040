"""Blind battery for close_loop: simulated chains with effects that it is not told."""
