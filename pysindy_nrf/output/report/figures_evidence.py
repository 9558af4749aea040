"""Figures of the loop's story: what was left, where it acts, what it depends on, before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...discrepancy.detection import TEST_WORDS
from ...discrepancy.evidence import Evidence
from .figures import (  # fmt: skip
    BLUE,
    INK,
    MUTED,
    ORANGE,
    RED,
    SERIES,
    SKY,
    Figure,
    axis,
    bar_layout,
    bars,
    layout,
    plain,
    rounded,
    unit_of,
)
from .tables import rows_table, table

_SITES = 8
_VARIABLES = {"s": ("drift s", "m"), "v": ("rate v", "m/s")}


def of_evidence(evidence: Evidence) -> list[Figure]:
    """Everything that can be drawn of one scene of the loop."""
    made = (_residual(evidence), _correlation(evidence), _localisation(evidence), _dependence(evidence))
    return [figure for figure in made if figure is not None] + _curves(evidence)


def before_after(errors: pd.DataFrame) -> Figure:
    """Held-out errors of the baseline and after each step, by balance."""
    columns = [c for c in errors.columns if c == "held-out" or c.startswith("held-out dof")]
    names = ["all balances" if c == "held-out" else c.replace("held-out dof", "DOF") for c in columns]
    words = [str(n).replace("_", " ") for n in errors.index]
    words = [words[0], *(f"+ {w}" for w in words[1:])]
    data = [
        {
            "type": "bar", "name": plain(word), "x": [plain(n) for n in names],
            "y": rounded(row.to_numpy(dtype=float)), "marker": {"color": SERIES[k % len(SERIES)]},
            "hovertemplate": "%{x}: %{y:.3g} %<extra></extra>",
        }
        for k, (word, (_, row)) in enumerate(zip(words, errors[columns].iterrows()))
    ]  # fmt: skip
    first, last = errors["held-out"].iloc[0], errors["held-out"].iloc[-1]
    frame = errors[columns].set_axis(names, axis=1).set_axis(words, axis=0)
    return Figure(
        "Held-out balance error before and after",
        f"Bars by balance: the pooled held-out error goes from {first:.3g} to {last:.3g} percent.",
        data,
        layout(axis(""), axis("error (% NRMSE)", rangemode="tozero"), 360, barmode="group", bargap=0.25),
        table("Held-out balance error, percent NRMSE", frame, index="model"),
        "Data that neither the search nor any fit has seen.",
        wide=True,
    )


def _residual(evidence: Evidence) -> Figure | None:
    sizes = evidence.sizes
    if not len(sizes) or not np.isfinite(sizes["percent"]).any():
        return None
    sizes = sizes[np.isfinite(sizes["percent"])]
    names = [str(n).replace("dof", "DOF") for n in sizes.index]
    colors = [SKY if n.startswith("DOF") else BLUE for n in names]
    floor = _floor(evidence, sizes)
    top = 1.15 * float(np.nanmax([sizes["percent"].max(), np.nanmax(floor) if np.isfinite(floor).any() else 0.0]))
    data = [bars(names, sizes["percent"], colors, name="residual")]
    if np.isfinite(floor).any():
        data.append(
            {"type": "scatter", "mode": "markers", "name": "noise alone", "x": rounded(floor), "y": names,
             "marker": {"symbol": "line-ns-open", "size": 15, "color": RED, "line": {"width": 2.5, "color": RED}},
             "hovertemplate": "noise alone: %{x:.3g} %<extra></extra>"}
        )  # fmt: skip
    worst = sizes["percent"].idxmax()
    shown = sizes[["rms", "percent", "of"]].assign(noise=floor).set_axis(names, axis=0)
    head = {"rms": "residual rms (N)", "percent": "residual (%)", "of": "percent of", "noise": "noise alone (%)"}
    return Figure(
        "Residual: how much is left",
        f"Residual of each balance and storey in percent; the largest is {sizes['percent'].max():.3g} in {worst}.",
        data,
        bar_layout("residual (% of its reference)", len(names), top or 1.0, showlegend=len(data) > 1),
        table("Residual on the search data", shown, head, index="where"),
        "DOF: error of its force balance. Storey: the force that is missing across it. The red mark is what noise "
        "alone would leave."
        if len(data) > 1
        else "DOF: error of its force balance. Storey: the force that is missing across it.",
    )


def _floor(evidence: Evidence, sizes: pd.DataFrame) -> np.ndarray:
    if evidence.floor is None:
        return np.full(len(sizes), np.nan)
    level = np.array([evidence.floor.at(str(where)) for where in sizes.index])
    reference = sizes["reference"].to_numpy()
    return 100 * np.divide(level, reference, out=np.full(len(sizes), np.nan), where=reference > 0)


def _correlation(evidence: Evidence) -> Figure | None:
    best = evidence.strongest
    if evidence.detection is None or best is None:
        return None
    tests = evidence.detection.tests.assign(over=lambda t: t["peak"].abs() / t["band"])
    lag, phi, band = evidence.detection.curves[best["where"], best["test"], best["signal"]]
    words = TEST_WORDS[best["test"]].format(x=best["signal"])
    factor, unit = unit_of(lag, "s") if best["test"] != "phi_ee" else (1.0, "samples, whitened")
    x = factor * np.asarray(lag, dtype=float)
    ends = rounded([x[0], x[-1], x[-1], x[0]])
    data: list[dict[str, Any]] = [
        {"type": "scatter", "mode": "lines", "x": ends, "y": rounded([band, band, -band, -band]), "fill": "toself",
         "fillcolor": MUTED, "opacity": 0.3, "line": {"width": 0}, "name": "noise stays within", "hoverinfo": "skip"},
        {"type": "scatter", "mode": "lines", "x": rounded(x), "y": rounded(phi), "name": "correlation",
         "line": {"color": BLUE, "width": 1.6}},
    ]  # fmt: skip
    listed = tests.sort_values("over", ascending=False).head(12)
    rows = [
        [r["where"].replace("dof", "DOF"), TEST_WORDS[r["test"]].format(x=r["signal"]), r["peak"], r["band"], r["p"]]
        for _, r in listed.iterrows()
    ]
    where = str(best["where"]).replace("dof", "DOF")
    return Figure(
        f"Detection: the strongest correlation, {where}",
        f"Correlation of {words} in {where}: peak {best['peak']:.2f}, noise stays within {best['band']:.2f}.",
        data,
        layout(axis(f"lag ({unit})"), axis("correlation (−1 to 1)"), 320),
        rows_table(
            "The strongest correlation tests", ["where", "correlation of", "peak", "noise within", "p if noise"], rows
        ),
        f"{words[0].upper()}{words[1:]}; the grey band holds noise.",
    )


def _localisation(evidence: Evidence) -> Figure | None:
    found = evidence.localisation
    if found is None or not found["share"].notna().any():
        return None
    found = found[found["share"].notna()]
    groups = found.groupby(found["share"].round(6), sort=False)
    heads = pd.DataFrame([
        {"name": _together(list(g.index)), "share": g["share"].iloc[0], "low": g["low"].iloc[0],
         "high": g["high"].iloc[0], "mine": evidence.chosen in list(g.index)}
        for _, g in groups
    ])  # fmt: skip
    heads = heads[(heads.index < _SITES - 1) | heads["mine"] | ((heads.index < _SITES) & ~heads["mine"][_SITES:].any())]
    if len(heads) < 2:  # one balance: the signs say nothing
        return None
    colors = [ORANGE if mine else (BLUE if k == 0 else SKY) for k, mine in enumerate(heads["mine"])]
    shown = found.head(20)[["share", "low", "high", "own", "balances"]]
    head = {
        "share": "explains (%)", "low": "from (%)", "high": "to (%)", "own": "follows its own motion (%)",
        "balances": "signs in the balances",
    }  # fmt: skip
    chosen = " Orange: the site the loop chose." if heads["mine"].any() else ""
    return Figure(
        "Localisation: where the missing force acts",
        f"A force at {evidence.site} would explain {heads['share'].iloc[0]:.0f} percent of the residual.",
        [bars(heads["name"], heads["share"], colors, low=heads["low"], high=heads["high"], name="share")],
        bar_layout("residual explained by a force there (%)", len(heads), showlegend=False),
        table("Sites by the share of the residual that a force there would explain", shown, head, index="site"),
        f"By the pattern of signs across the balances (Newton's third law); lines are about 95 %.{chosen}",
    )


def _together(sites: list[str]) -> str:
    return sites[0] if len(sites) == 1 else f"{sites[0]} (or {sites[1]}{', …' if len(sites) > 2 else ''})"


def _dependence(evidence: Evidence) -> Figure | None:
    found = evidence.characterisation
    if found is None:
        return None
    shares = found.shares
    names = [_WORDS.get(str(n), str(n)) for n in shares.index]
    colors = [BLUE if chosen else SKY for chosen in shares["chosen"]]
    low, high = shares["low"].clip(0, 100), shares["high"].clip(0, 100)
    shown = shares[["share", "low", "high", "gain"]].set_axis(names, axis=0)
    head = {"share": "explains (%)", "low": "from (%)", "high": "to (%)", "gain": "more than linear (points)"}
    return Figure(
        f"Characterisation: what the force at {evidence.site} depends on",
        found.sentence,
        [bars(names, shares["share"].clip(lower=0), colors, low=low, high=high, name="share")],
        bar_layout("explained on data left out (%)", len(names), showlegend=False),
        table("Share of the missing force that is a function of", shown, head, index="of"),
        "Without any formula. Highlighted: the simplest that explains nearly as much as the best.",
    )


_WORDS = {
    "constant": "nothing (constant)", "linear": "s, v, a linearly", "line": "a spectral line", "delay": "a delay",
    "s alone": "s alone", "v alone": "v alone", "s and v": "s and v", "path": "the path (memory)",
    "time": "time", "amplitude": "amplitude",
}  # fmt: skip


def _curves(evidence: Evidence) -> list[Figure]:
    found = evidence.characterisation
    out = []
    for name, (word, base) in _VARIABLES.items():
        if found is None or name not in found.curves:
            continue
        curve = found.curves[name]
        x, y = curve["centre"].to_numpy(), curve["mean"].to_numpy()
        (fx, ux), (fy, uy) = unit_of(x, base), unit_of(y, "N")
        data = [
            {"type": "scatter", "mode": "lines+markers", "x": rounded(fx * x), "y": rounded(fy * y),
             "error_y": {"type": "data", "array": rounded(2 * fy * curve["error"]), "thickness": 1, "width": 2,
                         "color": INK},
             "line": {"color": BLUE, "width": 1.6}, "marker": {"size": 5, "color": BLUE}, "name": "mean"},
        ]  # fmt: skip
        shown = curve[["centre", "mean", "error", "count"]].assign(count=curve["count"].astype(int))
        head = {"centre": f"{word} ({base})", "mean": "mean force (N)", "error": "its error (N)", "count": "samples"}
        out.append(
            Figure(
                f"The missing force at {evidence.site} against its {word.split()[0]}",
                f"Mean missing force from {y[0]:.3g} N at the lowest {word} to {y[-1]:.3g} N at the highest.",
                data,
                layout(axis(f"{word} ({ux})"), axis(f"mean missing force ({uy})", zeroline=True), 280, False),
                table(f"Mean missing force at {evidence.site}", shown, head),
                "Mean in bins of equal count, with twice its error.",
            )
        )
    return out


def residual_bars(sizes: pd.DataFrame) -> Figure | None:
    """Residual of each balance and storey of a single model."""
    return _residual(Evidence("model", sizes))
