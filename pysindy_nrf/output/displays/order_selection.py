"""Held-out error over the order of the power series, and the order the rule chose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ._axes import BLACK, BLUE, ORANGE, RED, axes


class OrderSelectionDisplay:
    """Validation curve: held-out error with its standard error over the folds, by order.

    Parameters
    ----------
    table : DataFrame
        One row for each order, in the sequence of the abscissa: ``error`` and ``standard_error`` (percent NRMSE),
        ``chosen`` (bool), and ``free_run_error`` if it is known.
    folds : DataFrame, optional
        Error of every fold, percent NRMSE, same rows.
    ylabel : str

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.output.displays import OrderSelectionDisplay
    >>> table = pd.DataFrame({"error": [43.0, 5.1, 5.2], "standard_error": [2.0, 0.3, 0.3]}, index=["1", "3", "5"])
    >>> table["chosen"] = [False, True, False]
    >>> display = OrderSelectionDisplay(table).plot()
    >>> [label.get_text() for label in display.ax_.get_xticklabels()]
    ['1', '3', '5']
    """

    def __init__(
        self, table: pd.DataFrame, folds: pd.DataFrame | None = None, ylabel: str = "held-out balance error (% NRMSE)"
    ) -> None:
        self.table, self.folds, self.ylabel = table, folds, ylabel

    @classmethod
    def from_selection(cls, selection: Any) -> OrderSelectionDisplay:
        """From what :func:`pysindy_nrf.select_order` found.

        Parameters
        ----------
        selection : OrderSelection

        Returns
        -------
        OrderSelectionDisplay
        """
        return cls._from_scores(
            selection.fold_scores, selection.table["chosen"].to_numpy(), selection.scoring,
            selection.table.get("free_run_error"),
        )  # fmt: skip

    @classmethod
    def from_estimator(cls, search: Any, metric: str = "score") -> OrderSelectionDisplay:
        """From a fitted scikit-learn search over ``degree``.

        Parameters
        ----------
        search : fitted GridSearchCV
        metric : str
            Name of the score, if the search had several.

        Returns
        -------
        OrderSelectionDisplay
        """
        from ...selection.one_se_rule import fold_scores

        results = search.cv_results_
        scores = fold_scores(results, metric)
        labels = [", ".join(str(v) for v in params.values()) for params in results["params"]]
        frame = pd.DataFrame(scores, index=pd.Index(labels, name=", ".join(results["params"][0])))
        chosen = np.zeros(len(scores), dtype=bool)
        if hasattr(search, "best_index_"):
            chosen[search.best_index_] = True
        return cls._from_scores(frame, chosen, "acceleration" if np.nanmax(scores) > 0 else "balance")

    @classmethod
    def _from_scores(
        cls, scores: pd.DataFrame, chosen: np.ndarray, scoring: str, free_run: Any = None
    ) -> OrderSelectionDisplay:
        from ...selection.one_se_rule import errors_of, standard_error

        folds = pd.DataFrame(100.0 * errors_of(scores.to_numpy()), index=scores.index, columns=scores.columns)
        folds = folds.replace(np.inf, np.nan)
        table = pd.DataFrame({
            "error": folds.mean(axis=1, skipna=False),
            "standard_error": [standard_error(row) for row in folds.to_numpy()],
            "chosen": chosen,
        })  # fmt: skip
        if free_run is not None:
            table["free_run_error"] = free_run
        what = {"acceleration": "acceleration error", "free_run": "free-run error"}.get(scoring, "balance error")
        return cls(table, folds, f"held-out {what} (% NRMSE)")

    def plot(self, ax: Any = None) -> OrderSelectionDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        at = np.arange(len(self.table))
        if self.folds is not None:
            lines = ax.plot(at, self.folds.to_numpy(), color=BLUE, alpha=0.3, linewidth=0.8)
            lines[0].set_label("each fold")
        ax.errorbar(
            at, self.table["error"], self.table["standard_error"], color=BLUE, marker="o", capsize=3,
            label="mean and standard error",
        )  # fmt: skip
        if "free_run_error" in self.table:
            ax.plot(at, self.table["free_run_error"], color=ORANGE, marker="s", linestyle="--", label="free run")
        chosen = self.table["chosen"].to_numpy()
        ax.plot(
            at[chosen], self.table["error"][chosen], linestyle="", marker="o", markersize=12, markerfacecolor="none",
            markeredgecolor=RED, markeredgewidth=1.5, label="chosen",
        )  # fmt: skip
        low, high = np.nanmin(self.table["error"]), np.nanmax(self.table["error"])
        if low > 0 and high > 20 * low:
            ax.set_yscale("log")
        elif low >= 0:
            ax.set_ylim(bottom=0)
        ax.set_xticks(at, [str(label) for label in self.table.index])
        ax.set_xlabel("order of the power series: total degree, or box (k, q)")
        ax.set_ylabel(self.ylabel)
        ax.legend(frameon=False)
        ax.tick_params(colors=BLACK)
        self.ax_ = ax
        return self
