"""Figures, each defined once, apart from how it is drawn.

matplotlib (extra ``plot``) draws them on a sheet, plotly (extra ``report``) on the page
of a report. Both are imported when something is drawn.
"""
