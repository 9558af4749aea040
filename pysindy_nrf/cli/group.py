"""The command group, and what becomes of errors: a sentence and an exit code."""

from __future__ import annotations

import _thread
import errno
import io
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import click

from .. import __version__
from ..exceptions import MissingExtraError, NRFError
from .app_command import app
from .change_commands import damage, forces
from .comparison_commands import compare, select_order
from .exit_codes import ExitCode
from .identify_commands import demo, identify
from .loop_commands import close_loop, run_test
from .options import OPTIONS_OF_ARGUMENTS
from .printing import printable
from .record_commands import inspect, list_laws, simulate
from .report_commands import plan, report

# Seconds after which an interruption that was swallowed is repeated.
_INTERRUPT_DELAY = 0.05


class _Ordered(click.Group):
    """Commands in the order in which they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=_Ordered,
    commands=[
        demo,
        inspect,
        run_test,
        app,
        identify,
        close_loop,
        select_order,
        forces,
        damage,
        compare,
        simulate,
        report,
        plan,
        list_laws,
    ],
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 110,
        "show_default": True,
    },
)
@click.version_option(__version__, prog_name="pysindy-nrf")
def cli() -> None:
    """Masses and nonlinear restoring forces of chain-like structures from measured
    forces and motions.

    \b
    Start with
        pysindy-nrf demo
    then give it your own test, a file with columns t, F1.., a1.., v1.., x1.. (SI):
        pysindy-nrf inspect test.csv     (what does the file hold?)
        pysindy-nrf run test.csv         (what was found, and a verdict)
    and for more say in it
        pysindy-nrf identify test.csv
        pysindy-nrf close-loop test.csv
    Columns with other names and units, on each of them:
        --map F2='Shaker @ kN' --unit a=g --unit x=mm

    \b
    Exit codes: 0 done, 2 wrong usage, 3 the data or what was asked of them, 4 done,
    but the verdict is red, 1 anything else, 130 stopped by Ctrl-C.
    Results go to the output stream, progress and errors to the error stream.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with an exit code."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> ExitCode:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process if None.

    Returns
    -------
    ExitCode
        An integer.
    """
    _show_unknown_signs_as_codes()
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        with _repeated_interrupts():
            code = cli.main(
                words, prog_name="pysindy-nrf", standalone_mode=False, obj=words
            )
        return ExitCode(code or 0)
    except click.ClickException as error:
        text = io.StringIO()
        error.show(text)
        click.echo(printable(text.getvalue()), err=True, nl=False)
        return ExitCode.USAGE
    except (click.Abort, KeyboardInterrupt):
        click.echo("Stopped. No half-written file is left.", err=True)
        return ExitCode.INTERRUPTED
    except Exception as error:
        click.echo(printable(f"Error: {_sentence(error)}"), err=True)
        return ExitCode.DATA if isinstance(error, NRFError) else ExitCode.OTHER


def _show_unknown_signs_as_codes() -> None:
    """A terminal that cannot show a sign shows its code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _sentence(error: Exception) -> str:
    """What went wrong, and what to do."""
    if isinstance(error, NRFError):
        return _with_option(error)
    if isinstance(error, MissingExtraError):
        return str(error)
    if isinstance(error, OSError):
        return _of_the_system(error)
    if isinstance(error, RecursionError):
        return "A file or expression is nested too deeply."
    if isinstance(error, MemoryError):
        return "Not enough memory. Cut the record or lower the degree."
    fault = f"This is a fault of pysindy-nrf {__version__}; please report it."
    return f"Unexpected {type(error).__name__}: {error}. {fault}"


def _with_option(error: NRFError) -> str:
    """An error of the library, with the option that stands for its argument."""
    option = OPTIONS_OF_ARGUMENTS.get(error.argument)
    return f"{error} On the command line: {option}." if option else str(error)


def _of_the_system(error: OSError) -> str:
    """An error of the operating system, with the file."""
    where = f"{error.filename}: " if error.filename else ""
    text = f"{where}{error.strerror or error}."
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        text += " Make room there, or write elsewhere (-o)."
    return text


@contextmanager
def _repeated_interrupts() -> Iterator[None]:
    """Repeat a Ctrl-C that falls into a callback of the compiler.

    Python drops what is raised there.
    """
    before = sys.unraisablehook

    def hook(fault: sys.UnraisableHookArgs) -> None:
        if issubclass(fault.exc_type, KeyboardInterrupt):
            threading.Thread(target=_interrupt_later, daemon=True).start()
        else:
            before(fault)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _interrupt_later() -> None:
    """Interrupt the main thread; by a real signal where there is one.

    A signal ends a wait of the main thread, too.
    """
    time.sleep(_INTERRUPT_DELAY)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
