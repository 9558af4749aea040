"""Forces whose channel is not linear or not steady, and records that do not belong
together, by what a balance leaves.

A force that a channel distorts, F_true = F + sum_k c_k phi_k(F, t), leaves phi_k in its
balance. One such function is named where it explains more of what is left, on windows
held out, than all further laws of the sites there together.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..chain.layout import Block, LawLayout
from ..equations.accumulation import rows_of
from ..records.dataset import Dataset
from .bias import GAIN, ROWS_PER_COLUMN, left_over, solved
from .sample_windows import FOLDS, LASTING, SCALE_ROWS, Window

_SIZE = (
    0.01  # of the rms of the force, or of its gain, below which a fault does not matter
)
# times what a record leaves with its own coefficients, from which on those of the
# others do not fit it
_UNLIKE = 1.5
_LEAST = 0.03  # of the force of its balance, that the others must leave of a record
_ENOUGH = 4096  # samples, of 40 to 50 columns
_LOST = 1e-9  # of the square of a column, what rounding leaves of it
# times what its own coefficients leave: a gain of the force explains the difference
_ALIKE = 1.2


class ForceProbes:
    """Gram matrices of [own columns | further laws | constant, ramp | functions of the
    force | force], by fold.
    """

    def __init__(self, layout: LawLayout, data: Dataset) -> None:
        self.layout, self.names = layout, [seg.name for seg in data.segments]
        step = max(1, data.n_samples // SCALE_ROWS)
        forces = np.nan_to_num(
            np.vstack([seg.F[seg.valid][::step] for seg in data.segments]).astype(float)
        )
        self.rms, self.peak = (
            np.sqrt(np.mean(forces**2, axis=0)),
            np.abs(forces).max(axis=0),
        )
        self.widths: dict[int, tuple[int, int]] = {}
        self.n_rows = 0
        self._windows: dict[tuple[int, int], list[Window]] = {}

    def add(self, number: int, window: Window) -> None:
        """Take a window in."""
        window = window.enough()
        self.n_rows += window.n_samples
        self._windows.setdefault((window.record, number % FOLDS), []).append(window)

    def grams(self) -> dict[int, dict[tuple[int, int], np.ndarray]]:
        """Gram matrices by balance, then by record and fold; of balances without a
        force where records are compared.
        """
        none = dict.fromkeys(range(1, self.layout.n_dof + 1), 0.0)
        out: dict[int, dict[tuple[int, int], np.ndarray]] = {}
        some = slice(None, None, max(1, self.n_rows // _ENOUGH))
        for key, windows in self._windows.items():
            blocks = [w.block.take(some) for w in windows]
            lines: Any = (
                np.hstack([getattr(b, k) for b in blocks])
                for k in ("terms", "acceleration", "force")
            )
            block = Block(*lines)
            for j in range(1, self.layout.n_dof + 1):
                acts = self.rms[j - 1] > 0
                if (
                    not np.isfinite(block.force[j - 1]).all()
                    or not acts
                    and len(self.names) < 2
                ):
                    continue
                group = self.layout.group((j,))
                *own, force = rows_of(self.layout, group, block, none)
                if not acts:  # its inertia is what its laws have to explain
                    *own, force = own
                offered = np.stack(
                    [
                        np.hstack([w.offered[s][:, some] for w in windows])
                        for s in group.sites
                    ]
                )
                more = np.vstack(
                    [
                        offered[:, :-LASTING].reshape(-1, block.n_samples),
                        offered[0, -LASTING:],
                    ]
                )
                u = force / (self.rms[j - 1] or 1.0)
                # push and pull, soft saturation, dead band, drift of the gain
                probes = np.array([np.abs(u), u**3, np.sign(u), offered[0, -1] * u])
                rows = np.vstack([*own, more, probes, u])
                self.widths[j] = len(own), len(more)
                out.setdefault(j, {})[key] = rows @ rows.T
        return out

    def sentences(self) -> list[str]:
        """What is wrong with forces and records, in words."""
        out = []
        for j, held in self.grams().items():
            own, more = self.widths[j]
            if self.n_rows < ROWS_PER_COLUMN * (own + more):
                continue
            out += self._unlike(j, held, own) or (
                self._distorted(j, held, own, more) if self.rms[j - 1] else []
            )
        return out

    def _distorted(
        self, j: int, held: Mapping[tuple[int, int], np.ndarray], own: int, more: int
    ) -> list[str]:
        """The function of the force that explains most, if it explains more than all
        further laws.
        """
        if {fold for _, fold in held} != set(range(FOLDS)):
            return []
        raw, first = _sum(held.values()), own + more
        plain = np.r_[
            :own, first - LASTING : first
        ]  # a wrong zero or a drift is no fault of the force
        alike = (
            raw[first:-1, -1] / raw[-1, -1]
        )  # what a function shares with the force is a gain, which noise makes
        aside = np.eye(len(raw))
        aside[first:-1, -1] = -alike
        left = np.einsum("ij,jk,ik->i", aside, raw, aside)[first:-1]
        aside[first:-1][left <= _LOST * np.diag(raw)[first:-1]] = (
            0.0  # of a force of two values all is a gain
        )
        folds = np.array(
            [
                _sum(g for (_, fold), g in held.items() if fold == k)
                for k in range(FOLDS)
            ]
        )
        folds = aside @ folds @ aside.T
        scale = np.sqrt(
            np.maximum(np.einsum("kii->i", folds), 0.0)
        )  # columns of unit length
        scale[scale == 0] = 1.0
        folds = folds / scale[:, None] / scale
        total = folds.sum(axis=0)
        choices = [
            plain,
            np.arange(first),
            *(np.append(plain, first + k) for k in range(total.shape[-1] - first - 1)),
        ]
        unexplained = np.array(
            [left_over(folds, c, solved(total - folds, c)).sum() for c in choices]
        )
        gains = 100 * (1 - unexplained / max(unexplained[0], 1e-300))
        best = 2 + int(np.argmax(gains[2:]))
        if gains[best] < max(2 * GAIN, gains[1]):
            return []
        c = -float(solved(aside @ raw @ aside.T, choices[best])[-1])
        c /= 1 - c * alike[best - 2]
        peak = self.peak[j - 1] / self.rms[j - 1]
        size = [2 * c, c * peak**2, c, 2 * c][best - 2]
        if abs(size) < _SIZE:
            return []
        kinds = [
            f"its gain differs by {100 * abs(size):.2g} % between push and pull",
            (
                f"its peaks are {100 * abs(size):.2g} % too"
                f" {'small (saturation)' if size > 0 else 'large'}"
            ),
            (
                f"it {'lacks' if size > 0 else 'has'}"
                f" {abs(size) * self.rms[j - 1]:.3g} N "
                f"{'on either side of zero (a dead band)' if size > 0 else 'too much on either side of zero'}"
            ),
            f"its gain drifts by {100 * abs(size):.2g} % over the record",
        ]
        return [
            f"F{j}: {kinds[best - 2]}, which explains {gains[best]:.0f} % of what its"
            " balance leaves, and makes masses, stiffness and damping wrong. Check its"
            " amplifier and range. Or does the structure itself do so?"
        ]

    def _unlike(
        self, j: int, held: Mapping[tuple[int, int], np.ndarray], own: int
    ) -> list[str]:
        """Records that the coefficients of the others do not describe."""
        records = sorted({record for record, _ in held})
        if len(records) < 2:
            return []
        at = np.append(np.arange(own), -1)
        plain = {key: gram[np.ix_(at, at)] for key, gram in held.items()}
        columns = np.arange(own)
        out = []
        for r in records:
            mine = [g for (record, _), g in plain.items() if record == r]
            whole, others = _sum(mine), _sum(plain.values()) - _sum(mine)
            force = whole[-1, -1]
            theirs = solved(others, columns)
            apart = float(left_over(whole, columns, theirs))
            together = float(
                left_over(whole, columns, solved(whole + others, columns))
            )  # theirs may be ill determined
            kept = [
                float(left_over(g, columns, solved(whole - g, columns))) for g in mine
            ]
            alone = sum(kept) if len(kept) > 1 else np.inf
            if together < _UNLIKE**2 * alone or apart < _LEAST**2 * force:
                continue
            fit = (
                theirs
                @ whole[columns, -1]
                / max(theirs @ whole[np.ix_(columns, columns)] @ theirs, 1e-300)
            )
            scaled = float(left_over(whole, columns, fit * theirs))
            said = (
                f"is {np.sqrt(apart / force):.0%} off with the masses and laws that the"
                " others give, "
            )
            said += f"{np.sqrt(alone / force):.0%} with its own"
            if self.rms[j - 1] and scaled < _ALIKE**2 * alone:
                said += (
                    f"; with its F{j} divided by {fit:.3g} they agree: is the gain of"
                    f" F{j} another one there?"
                )
            else:
                said += (
                    ". Is it another structure, another amplitude of a law that is"
                    " missing, or another calibration?"
                )
            out.append(
                (
                    apart / force,
                    (
                        f"the balance of DOF {j} in record {r + 1} ({self.names[r]!r})"
                        f" {said}"
                    ),
                )
            )
        return [f"The records do not belong together: {max(out)[1]}"] if out else []


def _sum(grams: Any) -> Any:
    return np.sum(list(grams), axis=0)


def copies_of(data: Dataset) -> list[str]:
    """A sentence on records that hold the same samples; they narrow intervals that they
    say nothing new for.
    """
    if len(data.segments) < 2:
        return []
    seen: dict[bytes, str] = {}
    twice = []
    for seg in data.segments:
        mark = (
            np.ascontiguousarray(seg.a[seg.valid]).tobytes()[:4096]
            + np.nansum(seg.F[seg.valid], axis=0).tobytes()
        )
        if mark in seen:
            twice.append(f"{seg.name!r} and {seen[mark]!r}")
        seen.setdefault(mark, seg.name)
    if not twice:
        return []
    more = f" (and {len(twice) - 1} more)" if len(twice) > 1 else ""
    said = (
        "hold the same samples: intervals come out too narrow. Leave copies out; a test"
        " counts once."
    )
    return [f"Records {twice[0]}{more} {said}"]
