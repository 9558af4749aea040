"""The language of figures, and matplotlib's renderer of it.

A figure says what is drawn, apart from how. matplotlib (extra ``plot``) is imported
when something is drawn.
"""
