"""Blind battery for close_loop: simulated chains with an effect that the search is not
told of.
"""
