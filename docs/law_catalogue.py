"""Writes the page of all force laws, each with a small picture: its force against the
drift.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.laws import Motion, registry

HEAD = """# Catalogue of force laws

{count} laws, by family. The pictures show force against drift under a slow cycle that
grows to a fixed size, with shape parameters in the middle of their range and terms of
comparable size; covariates are switched on half way. Errors of sensors have no such
picture. `pysindy-nrf laws WORDS` lists the same on the command line;
[add your own](../add_your_own_law.md).
"""


def of_the_package() -> dict[str, type]:
    """Laws by name, without those that a script has added to the registry."""
    return {
        name: kind
        for name, kind in sorted(registry().items())
        if kind.__module__.startswith("pysindy_nrf.")
    }


def motion() -> Motion:
    """Three cycles of 1 m and 1 rad/s, the first ones smaller."""
    t = np.linspace(0, 6 * np.pi, 1500)
    size = np.minimum(1.0, 0.4 + t / 15)
    s = size * np.sin(t)
    v = np.gradient(s, t)
    return Motion(s, v, np.gradient(v, t), t, {})


def force_of(kind: type) -> np.ndarray | None:
    """Force along the motion, None for what is no force or needs more than one site."""
    drive = motion()
    middle = {}
    for shape in kind.shapes:
        low, high = shape.bounds(0.7, 0.7, float(drive.t[-1]))
        middle[shape.name] = (
            float(np.sqrt(low * high)) if shape.log and low > 0 else 0.5 * (low + high)
        )
    try:
        law = kind(**middle)
        later = np.where(drive.t > drive.t[-1] / 2, 1.0, 0.3)
        columns = law.features(
            Motion(
                drive.s, drive.v, drive.a, drive.t, dict.fromkeys(law.covariates, later)
            )
        )
    except (NRFError, TypeError):
        return None
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    weights = 0.6 ** np.arange(columns.shape[1]) / np.where(sizes > 0, sizes, 1.0)
    return columns @ weights if law.output == "N" else None


def draw(path: Path, force: np.ndarray) -> None:
    """A picture without words."""
    sheet = Figure(figsize=(1.6, 1.2))
    ax = sheet.add_axes((0.02, 0.02, 0.96, 0.96))
    ax.axhline(0, color="0.8", linewidth=0.6)
    ax.axvline(0, color="0.8", linewidth=0.6)
    ax.plot(motion().s, force, color="#0072B2", linewidth=1.2)
    ax.set_axis_off()
    sheet.savefig(path, metadata={"Date": None})


def write(folder: Path) -> Path:
    """Write the page and its pictures into a folder."""
    (folder / "laws").mkdir(parents=True, exist_ok=True)
    families: dict[str, list[str]] = {}
    for name, kind in of_the_package().items():
        about = (kind.__doc__ or "").strip().splitlines()[0].replace("|", "\\|")
        force, picture = force_of(kind), ""
        if force is not None:
            draw(folder / "laws" / f"{name}.svg", force)
            picture = f"![Force of {name} against drift](laws/{name}.svg)"
        families.setdefault(kind.family, []).append(
            f"| {picture} | **{name}** | {about} |"
        )
    text = HEAD.format(count=len(of_the_package()))
    for family, rows in sorted(families.items()):
        head = [
            f"\n## {family.capitalize()}\n",
            "| force | name | what it is |",
            "|---|---|---|",
        ]
        text += "\n".join([*head, *rows, ""])
    page = folder / "law_catalogue.md"
    page.write_text(text, encoding="utf-8")
    return page
