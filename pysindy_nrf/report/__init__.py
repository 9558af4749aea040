"""The page that an engineer shows to a colleague: one file, offline, with figures that
turn and tables that sort.
"""

from .write import available, write_html

__all__ = ["available", "write_html"]
