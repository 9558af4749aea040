"""The page: files, mapping, what is known, run, verdict, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from types import ModuleType
from typing import Any
from uuid import uuid4

import numpy as np

from ...exceptions import NRFError
from .columns import Column, channels_to_choose, columns_of, mapping_file_text
from .server import MAX_FILE_BYTES
from .window import MODEL, PAGE, WORKBOOK, Look, Window

# Seconds between two looks at a run.
POLL = 0.5
_STATES = {
    "green": "Can be used",
    "amber": "Use with care",
    "red": "Not to be used",
    "error": "No result",
    "stopped": "Stopped",
}
_CHANNELS = (
    "F2 is the force on floor 2, a2 its acceleration, x2 its displacement relative to"
    " the base, ag the acceleration of the base, t the time."
)
_STYLE = """
:root { --ok: #00775a; --care: #9a6a00; --bad: #b3410a; --line: #8884; }
body { font: 16px/1.5 system-ui, "Segoe UI", Roboto, Arial, sans-serif; }
.nicegui-content { max-width: 76rem; margin: 0 auto; padding: 1rem; width: 100%; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .2rem 0; font-weight: 650; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 1rem 0 .3rem; font-weight: 600; }
.whole, .columns { width: 100%; }
.columns .entry > * { min-width: 0; width: 100%; }
.columns .entry { display: grid; grid-template-columns: 8.5rem 11rem minmax(9rem, 1fr)
  minmax(9rem, 1.3fr); gap: .8rem; align-items: center; padding: .15rem 0;
  border-bottom: 1px solid var(--line); }
.columns svg { width: 100%; height: 2.4rem; }
.columns polyline { fill: none; stroke: #2b83ba; stroke-width: 1;
  vector-effect: non-scaling-stroke; }
.columns .doubtful polyline { stroke: var(--bad); }
.columns .name { overflow-wrap: anywhere; }
.doubt { color: var(--bad); font-size: .9rem; }
.form { display: grid; grid-template-columns: repeat(auto-fill, minmax(10rem, 1fr));
  gap: .6rem 1rem; width: 100%; }
.verdict { border-left: .5rem solid var(--line); padding: .4rem 1rem; width: 100%; }
.verdict.green { border-color: var(--ok); }
.verdict.amber { border-color: var(--care); }
.verdict.red, .verdict.error { border-color: var(--bad); }
.verdict b { font-size: 1.05rem; }
.report { width: 100%; height: 80vh; border: 1px solid var(--line); }
.command, .said { font: .85rem/1.5 ui-monospace, monospace; white-space: pre-wrap;
  overflow-wrap: anywhere; width: 100%; }
.q-uploader { width: 100%; max-height: 16rem; }
@media (max-width: 46rem) {
  .columns .entry { grid-template-columns: 7rem minmax(0, 1fr); }
}
"""


def build(nicegui: ModuleType) -> None:
    """Define the page; each browser window gets a folder and its own state."""
    ui, app = nicegui.ui, nicegui.app
    windows: dict[str, Window] = {}

    @app.get("/report/{key}")
    def report(key: str) -> object:
        from starlette.responses import HTMLResponse

        window = windows.get(key)
        path = None if window is None else window.result / PAGE
        if path is None or not path.exists():
            return HTMLResponse("There is no report.", 404)
        return HTMLResponse(path.read_text("utf-8"))

    @ui.page("/")
    def page() -> None:
        key = uuid4().hex
        windows[key] = Window()

        def close() -> None:
            windows.pop(key).close()

        ui.context.client.on_delete(close)
        ui.add_css(_STYLE)
        _Page(nicegui, windows[key], f"/report/{key}").draw()

    def close_all() -> None:
        for window in windows.values():
            window.close()

    app.on_shutdown(close_all)


class _Page:
    """One window of the page."""

    def __init__(self, nicegui: ModuleType, window: Window, report: str) -> None:
        self._ui = nicegui.ui
        self._run = nicegui.run
        self._window = window
        self._report = report
        self._files: list[Path] = []
        self._columns: list[Column] = []
        self._fields: dict[str, Any] = {}
        self._masses: dict[int, Any] = {}
        self._look_number = 0

    def draw(self) -> None:
        """Lay the page out."""
        ui = self._ui
        ui.html("<h1>Drop the files of a test</h1>", sanitize=False)
        ui.label(
            "CSV, Excel, TDMS, MATLAB, Parquet, HDF5, NumPy, UFF 58, strong motion."
            " Nothing leaves your computer."
        )
        ui.upload(
            multiple=True,
            auto_upload=True,
            max_file_size=MAX_FILE_BYTES,
            on_upload=self._take,
            on_rejected=lambda: ui.notify("The file is too large.", type="negative"),
            label="Drop files here, or choose them with +",
        ).props("data-what=files")
        self._mapping = ui.column().classes("whole")
        self._known = ui.column().classes("whole")
        self._outcome = ui.column().classes("whole")

    # -- files -------------------------------------------------------------------------

    async def _take(self, event: Any) -> None:
        """Keep a file that was dropped, and propose its channels."""
        path = self._window.place_for(event.file.name)
        await event.file.save(path)
        self._files.append(path)
        if len(self._files) == 1 or self._value("together"):
            await self._propose()
        else:
            self._draw_mapping()
            await self._look()

    async def _propose(self) -> None:
        """Channels for the columns of the first file, or of all files of one test."""
        files = self._files if self._value("together") else self._files[:1]
        try:
            self._columns = await self._run.io_bound(columns_of, files)
        except (NRFError, ImportError, OSError) as error:
            self._draw_error(str(error))
            return
        self._draw_mapping()
        self._draw_known()
        await self._look()

    def _draw_error(self, words: str) -> None:
        """Why files cannot be read: one file goes, several stay to be read apart."""
        place = self._mapping
        if len(self._files) > 1:
            place = self._notes
        else:
            self._files.clear()
        place.clear()
        with place:
            self._ui.label(words).classes("doubt")

    # -- the mapping -------------------------------------------------------------------

    def _draw_mapping(self) -> None:
        """The table of the columns, to be corrected by menus."""
        ui = self._ui
        self._mapping.clear()
        with self._mapping:
            names = ", ".join(path.name for path in self._files)
            ui.html("<h2>Which column is which channel?</h2>", sanitize=False)
            ui.label(f"{names}. {_CHANNELS}")
            if len(self._files) > 1:
                together = ui.select(
                    {False: "each file is a test", True: "channels of one test"},
                    value=bool(self._value("together")),
                    on_change=self._propose,
                )
                self._fields["together"] = together.props("data-what=together")
            choices = channels_to_choose(self._columns)
            with ui.element("div").classes("columns"):
                for number, column in enumerate(self._columns):
                    self._draw_column(number, column, choices)
            self._notes = ui.column().classes("whole")

    def _draw_column(self, number: int, column: Column, choices: list[str]) -> None:
        """One row: menu, plot, name, what is in doubt."""
        ui = self._ui

        async def change(event: Any) -> None:
            changed = replace(self._columns[number], channel=event.value, doubts=())
            self._columns[number] = changed
            doubt.set_text("")
            await self._look()

        options = choices if column.channel in choices else [*choices, column.channel]
        with ui.element("div").classes("entry") as row:
            menu = ui.select(options, value=column.channel, on_change=change)
            menu.props(f'dense options-dense aria-label="channel {number + 1}"')
            ui.html(small_plot(column.line), sanitize=False)
            ui.label(column.text).classes("name")
            doubt = ui.label("; ".join(column.doubts)).classes("doubt")
        if column.doubts:
            row.classes("doubtful")

    async def _look(self) -> None:
        """Write the mapping, and say what the files hold by it."""
        self._look_number += 1
        number = self._look_number
        self._write_mapping()
        look = await self._run.io_bound(self._window.look)
        if number == self._look_number:
            self._draw_look(look)

    def _write_mapping(self) -> None:
        settings = {
            "together": self._value("together") or None,
            "fs": self._value("fs"),
            "coordinates": self._value("coordinates"),
        }
        text = mapping_file_text(self._files, self._columns, settings)
        self._window.write_mapping(text)

    def _value(self, name: str) -> Any:
        """The value of a field; None if it is empty or not drawn."""
        field = self._fields.get(name)
        return None if field is None or field.value in ("", None) else field.value

    def _draw_look(self, look: Look) -> None:
        """What was understood, and what looks wrong."""
        ui = self._ui
        self._notes.clear()
        with self._notes:
            if look.error:
                ui.label(look.error).classes("doubt")
                return
            sentences = [text for texts in look.doubts.values() for text in texts]
            for sentence in dict.fromkeys(sentences):
                ui.label(f"Take care: {sentence}").classes("doubt")
            if not sentences:
                ui.label("Nothing looks wrong with the channels.")
            with ui.expansion("What was understood"):
                ui.label(look.words).classes("said")

    # -- what is known -----------------------------------------------------------------

    def _draw_known(self) -> None:
        """Clock, reference, band, masses; and the run."""
        ui = self._ui
        self._known.clear()
        with self._known:
            with ui.expansion("What is known (masses, base, clock, band)"):
                with ui.element("div").classes("form"):
                    self._draw_fields()
            with ui.row():
                self._start = ui.button("Run", on_click=self._run_loop).props(
                    "data-what=run"
                )
                self._stop = ui.button("Stop", on_click=self._stop_run).props(
                    "data-what=stop"
                )
                self._stop.props("outline").set_visibility(False)
                self._bar = ui.linear_progress(show_value=False)
                self._bar.props("indeterminate").set_visibility(False)
                self._says = ui.label().props("data-what=progress")

    def _draw_fields(self) -> None:
        ui = self._ui
        fields = self._fields
        fields["fs"] = ui.number(
            "sampling rate, Hz, if there is no time", min=0, on_change=self._look
        )
        fields["coordinates"] = ui.select(
            {"": "as the file says", "relative": "to the base", "absolute": "absolute"},
            value="",
            label="displacements are",
            on_change=self._look,
        )
        fields["low"] = ui.number("band from, Hz", min=0)
        fields["high"] = ui.number("band to, Hz", min=0)
        channels = {column.channel for column in self._columns}
        floors = [int(name[1:]) for name in channels if name[1:].isdigit()]
        for j in range(1, max(floors, default=1) + 1):
            self._masses[j] = ui.number(f"mass of floor {j}, kg, if known", min=0)

    def _options(self) -> list[str]:
        """Options of the command line."""
        options: list[str] = []
        for dof, field in self._masses.items():
            if field.value is not None:
                options += ["--known-mass", f"{dof}={field.value:g}"]
        ends = [self._value("low"), self._value("high")]
        if ends != [None, None]:
            words = ["none" if end is None else f"{end:g}" for end in ends]
            options += ["--band", ",".join(words)]
        return options

    # -- the run -----------------------------------------------------------------------

    async def _run_loop(self) -> None:
        """Start the run, and look at it until it ends."""
        if self._window.is_running:
            return
        self._write_mapping()
        self._outcome.clear()
        self._window.start(self._options())
        self._show_running(True)
        self._timer = self._ui.timer(POLL, self._watch)

    def _show_running(self, running: bool) -> None:
        self._start.set_enabled(not running)
        self._stop.set_visibility(running)
        self._bar.set_visibility(running)

    def _watch(self) -> None:
        """Show what the run does, and at its end what it found."""
        if self._window.is_running:
            self._says.set_text(self._window.progress)
            return
        self._timer.cancel()
        self._show_running(False)
        self._says.set_text("")
        self._draw_outcome()

    async def _stop_run(self) -> None:
        await self._run.io_bound(self._window.stop)

    # -- the outcome -------------------------------------------------------------------

    def _draw_outcome(self) -> None:
        """Verdict, downloads, report."""
        ui = self._ui
        finding = self._window.finding()
        reasons = "".join(f"<li>{escape(text)}</li>" for text in finding.reasons)
        self._outcome.clear()
        with self._outcome:
            ui.html(
                f"<div class='verdict {finding.state}'><b>{_STATES[finding.state]}</b>"
                f"<div>{escape(finding.sentence)}</div><ul>{reasons}</ul></div>",
                sanitize=False,
            ).classes("whole").props("data-what=verdict")
            if finding.state in ("error", "stopped"):
                return
            self._draw_downloads()
            ui.element("iframe").props(
                f'src="{self._report}" title="The report"'
                ' sandbox="allow-scripts allow-downloads allow-modals"'
            ).classes("report")

    def _draw_downloads(self) -> None:
        """Page, model, workbook, mapping, and the command line that repeats the run."""
        ui = self._ui
        command = self._window.command(self._options())
        files = {
            "Page": self._window.result / PAGE,
            "Model": self._window.result / MODEL,
            "Workbook": self._window.result / WORKBOOK,
            "Mapping": self._window.mapping,
        }
        with ui.row():
            for name, path in files.items():
                if path.exists():
                    self._draw_download(name, path)
        ui.label("The same by the command line, next to the files and the mapping:")
        ui.label(command).classes("command").props("data-what=command")

    def _draw_download(self, name: str, path: Path) -> None:
        ui = self._ui
        button = ui.button(name, on_click=lambda: ui.download.file(path))
        button.props("outline")


def small_plot(line: np.ndarray) -> str:
    """A line as a small drawing (SVG); empty without numbers."""
    if not len(line):
        return "<svg aria-hidden='true'></svg>"
    low, high = float(line.min()), float(line.max())
    scaled = (line - low) / (high - low or 1.0)
    drawing = f"<polyline points='{_points(scaled)}'/>"
    label = f"role='img' aria-label='from {low:.3g} to {high:.3g}'"
    box = "viewBox='0 0 100 24' preserveAspectRatio='none'"
    return f"<svg {box} {label}>{drawing}</svg>"


def _points(scaled: Sequence[float] | np.ndarray) -> str:
    """Points of a line between 0 and 1."""
    x = np.linspace(0, 100, len(scaled))
    pairs = [f"{a:.1f},{23 - 22 * b:.1f}" for a, b in zip(x, scaled)]
    return " ".join(pairs)
