"""The page that an engineer shows to a colleague.

One file, offline, with figures that turn and tables that sort.
"""

from .page import available, write_html

__all__ = ["available", "write_html"]
