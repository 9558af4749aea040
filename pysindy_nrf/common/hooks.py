"""Methods of lower layers whose work is done by functions of upper layers."""

from __future__ import annotations

from enum import Enum
from pkgutil import resolve_name
from typing import Any


class Hook(Enum):
    """Functions of upper layers that objects of lower layers offer as methods.

    Users look for ``chain.plan()``, ``record.to_features()`` or ``model.to_html(path)`` on the object itself. Each such
    method calls one member of this enumeration, whose value names the function: ``package.module:function``. The module
    is imported at the first call, so that no layer imports one above it. A method of this kind that is added, or a
    function that moves, changes this table and nothing else.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.common.hooks import Hook
    >>> Hook.PLAN(Chain(2)).table["hit"].iloc[0]
    (1,)
    """

    PLAN = "pysindy_nrf.diagnostics.test_planning:plan"
    TO_FEATURES = "pysindy_nrf.signals.kinematics:to_features"
    SIMULATE = "pysindy_nrf.simulation:simulate"
    TO_SINDY = "pysindy_nrf.regression.state_space:to_sindy"
    FROM_SINDY = "pysindy_nrf.regression.state_space:from_sindy"
    ORDER_FIGURE = "pysindy_nrf.output.displays:OrderSelectionDisplay.from_selection"
    PAGE = "pysindy_nrf.output.report:write_html"
    RECORD_HTML = "pysindy_nrf.output.report.write:record_html"
    MODEL_HTML = "pysindy_nrf.output.report.write:model_html"
    LOOP_MARKDOWN = "pysindy_nrf.output.report.write:markdown"
    LOOP_HTML = "pysindy_nrf.output.report.write:loop_html"

    def __call__(self, *args: Any, **options: Any) -> Any:
        """What the function returns."""
        return resolve_name(self.value)(*args, **options)
