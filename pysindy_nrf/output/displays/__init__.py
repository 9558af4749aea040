"""Figures in scikit-learn's manner: data in ``__init__``, ``plot(ax=None)`` draws, ``from_report`` gets the data.

Each figure is defined once (``figures()``), apart from how it is drawn; matplotlib (extra ``plot``) draws it on a
sheet, plotly (extra ``report``) on the page of a report. Both are imported when something is drawn.
"""

from .evidence import BeforeAfterDisplay
from .models import ChangeMapDisplay

__all__ = ["BeforeAfterDisplay", "ChangeMapDisplay"]
