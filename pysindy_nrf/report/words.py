"""Words that the page, Markdown and the command line share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..diagnosis.effects import Effect
from ..laws.base import ForceLaw

Band = tuple[float | None, float | None] | None
# The setting of a loop that was given no band.
BAND_FOUND = "found from the data"


def listed(parts: Iterable[object]) -> str:
    """Words with commas between them."""
    return ", ".join(map(str, parts))


def joined(parts: Sequence[str]) -> str:
    """Words with commas and a last "and"."""
    if len(parts) == 1:
        return parts[0]
    return f"{listed(parts[:-1])} and {parts[-1]}"


def band_text(band: Band) -> str:
    """A band in words."""
    low, high = band if band is not None else (None, None)
    if high is None:
        return f"above {low:.4g} Hz" if low else "all frequencies"
    return f"{low or 0:.4g} to {high:.4g} Hz"


def band_source(band: Band, settings: Mapping[str, Mapping[str, object]]) -> str:
    """Where the band of a closed loop comes from, if its settings say so."""
    setting = settings.get("loop", {}).get("band")
    if setting is None or setting == BAND_FOUND:
        return BAND_FOUND if setting else ""
    if setting == band_text(band):
        return "as given"
    return f"found from the data within {setting}, which was given"


def standing(effect: Effect) -> str:
    """What held-out data say of an effect."""
    return "confirmed" if effect.confirmed else "NOT CONFIRMED"


def summary_of(law: type[ForceLaw]) -> str:
    """What a law describes: the first paragraph of its documentation."""
    paragraph = (law.__doc__ or "").strip().split("\n\n")[0]
    return " ".join(paragraph.split()).replace("``", "")
