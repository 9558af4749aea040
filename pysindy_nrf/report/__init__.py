"""The page that an engineer shows to a colleague, and its figures.

One file, offline, with figures that turn and tables that sort. Figures are defined
apart from how they are drawn: on matplotlib's axes (:class:`Drawing`) or by plotly
(:func:`as_plotly`).
"""

from ..common.lazy import public_names

_NAMES = {
    "Axis": ".drawing.figure",
    "Bars": ".drawing.figure",
    "Drawing": ".drawing.matplotlib_renderer",
    "Figure": ".drawing.figure",
    "FreeRunDisplay": "displays",
    "HysteresisDisplay": "displays",
    "IntervalsDisplay": "displays",
    "ModesDisplay": "displays",
    "ResidualDisplay": "displays",
    "RestoringForceDisplay": "displays",
    "StepsDisplay": "displays",
    "Line": ".drawing.figure",
    "as_html": "page",
    "as_plotly": "figures.plotly_renderer",
    "Summary": "summary",
    "available": "page",
    "content_of": "page",
    "identification_of": "model_content",
    "order_figure": "figures.motion",
    "write_html": "page",
    "write_workbook": "workbook",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
