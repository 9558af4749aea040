"""Gram matrices by which force channels and records are judged.

A force that a channel distorts, F_true = F + sum_k c_k phi_k(F, t), leaves phi_k in its
equation of motion.
"""

from __future__ import annotations

import numpy as np

from ..chain.layout import Block, LawLayout
from ..equations.accumulation import rows_of
from ..records.dataset import Dataset
from .force_distortion import ForceGrams, distortions_of, force_functions
from .missing_terms import ROWS_PER_COLUMN
from .sample_windows import FOLDS, LASTING, SCALE_ROWS, Window
from .unlike_records import copies_of, unlike_records

__all__ = ["ForceProbes", "copies_of"]

# Samples that are enough for 40 to 50 columns.
ENOUGH_SAMPLES = 4096


class ForceProbes:
    """Windows of the equations of motion, and what is wrong with forces and records.

    Parameters
    ----------
    layout : LawLayout
    data : Dataset
    """

    def __init__(self, layout: LawLayout, data: Dataset) -> None:
        self.layout = layout
        self.names = [segment.name for segment in data.segments]
        self.n_rows = 0
        self._windows: dict[tuple[int, int], list[Window]] = {}

        step = max(1, data.n_samples // SCALE_ROWS)
        parts = [segment.F[segment.valid][::step] for segment in data.segments]
        forces = np.nan_to_num(np.vstack(parts).astype(float))
        self.rms = np.sqrt(np.mean(forces**2, axis=0))
        self.peak = np.abs(forces).max(axis=0)

    def add(self, number: int, window: Window) -> None:
        """Take a window in, which goes to a fold by its number."""
        window = window.thinned()
        self.n_rows += window.n_samples
        key = window.record, number % FOLDS
        self._windows.setdefault(key, []).append(window)

    def sentences(self) -> list[str]:
        """What is wrong with forces and records, in words."""
        sentences: list[str] = []
        for grams in self.grams().values():
            if self.n_rows < ROWS_PER_COLUMN * (grams.n_own + grams.n_further):
                continue
            unlike = unlike_records(grams, self.names)
            if unlike:
                sentences += unlike
            elif grams.rms:
                sentences += distortions_of(grams, self.layout.chain.units)
        return sentences

    def grams(self) -> dict[int, ForceGrams]:
        """Gram matrices by DOF; without a force only where records are compared."""
        thinning = slice(None, None, max(1, self.n_rows // ENOUGH_SAMPLES))
        matrices: dict[int, dict[tuple[int, int], np.ndarray]] = {}
        widths: dict[int, tuple[int, int]] = {}
        for key, windows in self._windows.items():
            block = _joined_block(windows, thinning)
            for dof in range(1, self.layout.n_dof + 1):
                is_known = np.isfinite(block.force[dof - 1]).all()
                is_judged = self.rms[dof - 1] > 0 or len(self.names) > 1
                if not is_known or not is_judged:
                    continue
                of_laws, further, functions = self._rows(dof, block, windows, thinning)
                rows = np.vstack([of_laws, further, functions])
                widths[dof] = len(of_laws), len(further)
                matrices.setdefault(dof, {})[key] = rows @ rows.T

        grams = {}
        for dof, (n_own, n_further) in widths.items():
            rms = float(self.rms[dof - 1])
            peak = float(self.peak[dof - 1])
            grams[dof] = ForceGrams(dof, n_own, n_further, rms, peak, matrices[dof])
        return grams

    def _rows(
        self, dof: int, block: Block, windows: list[Window], thinning: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of own columns, of further ones, and of functions of the force."""
        massless = dict.fromkeys(range(1, self.layout.n_dof + 1), 0.0)
        group = self.layout.group((dof,))
        rows = rows_of(self.layout, group, block, massless)
        own_rows = rows[:-1]
        force = rows[-1]
        if not self.rms[dof - 1]:
            # its inertia is what its laws have to explain
            own_rows = rows[:-2]
            force = rows[-2]

        offered = []
        for site in group.sites:
            parts = [window.offered[site][:, thinning] for window in windows]
            offered.append(np.hstack(parts))
        of_laws = [columns[:-LASTING] for columns in offered]
        further = np.vstack([*of_laws, offered[0][-LASTING:]])

        unit = force / (self.rms[dof - 1] or 1.0)
        ramp = offered[0][-1]
        return own_rows, further, np.vstack([force_functions(unit, ramp), unit])


def _joined_block(windows: list[Window], thinning: slice) -> Block:
    """Some samples of several windows as one block."""
    blocks = [window.block.take(thinning) for window in windows]
    return Block(
        np.hstack([block.terms for block in blocks]),
        np.hstack([block.acceleration for block in blocks]),
        np.hstack([block.force for block in blocks]),
    )
