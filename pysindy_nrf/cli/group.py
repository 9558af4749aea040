"""The command group, and what happens to errors: a sentence and an exit code, no
traceback.
"""

import _thread
import errno
import io
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from .. import __version__
from ..exceptions import MissingExtraError, NRFError
from .change_commands import damage, forces
from .model_commands import close_loop, compare, demo, identify, run_test, select_order
from .options import in_options, printable
from .record_commands import inspect, list_laws, plan, report, simulate

USAGE, DATA, OTHER, INTERRUPTED = 2, 3, 1, 130  # and outcome.RED


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
    then give it your own test, a file with columns t, F1.., a1.., v1.., x1.. (SI
    units):
        pysindy-nrf inspect test.csv          (what does the file hold?)
        pysindy-nrf run test.csv              (masses, forces, what linear storeys lack; a verdict)
    and for more say in it
        pysindy-nrf identify test.csv
        pysindy-nrf close-loop test.csv
    Columns with other names and units: --map F2='Shaker @ kN' --unit a=g --unit x=mm,
    on each of them.

    \b Exit codes: 0 done, 2 wrong usage, 3 the data or what was asked of them, 4 done,
    but the verdict is red, 1 anything else, 130 stopped by Ctrl-C. Results go to the
    output stream, progress and errors to the error stream.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with an exit code."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(
            stream, "reconfigure"
        ):  # a terminal that cannot show a sign shows its code
            stream.reconfigure(errors="backslashreplace")
    try:
        given = None if arguments is None else list(arguments)
        with _heard():
            words = sys.argv[1:] if given is None else given
            return (
                cli.main(
                    args=given,
                    prog_name="pysindy-nrf",
                    standalone_mode=False,
                    obj=words,
                )
                or 0
            )
    except click.ClickException as error:
        said = io.StringIO()
        error.show(said)
        click.echo(printable(said.getvalue()), err=True, nl=False)
        return USAGE
    except NRFError as error:
        return _say(in_options(error), DATA)
    except MissingExtraError as error:
        return _say(str(error), OTHER)
    except (click.Abort, KeyboardInterrupt):
        return _say("Stopped. No half-written file is left.", INTERRUPTED, "")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        cure = (
            " Make room there, or write elsewhere (-o)."
            if error.errno in (errno.ENOSPC, errno.EDQUOT)
            else ""
        )
        return _say(f"{where}{error.strerror or error}.{cure}", OTHER)
    except RecursionError:
        return _say("A file or expression is nested too deeply.", OTHER)
    except MemoryError:
        return _say("Not enough memory. Cut the record or lower the degree.", OTHER)
    except Exception as error:  # a fault of ours
        fault = f"This is a fault of pysindy-nrf {__version__}; please report it."
        return _say(f"Unexpected {type(error).__name__}: {error}. {fault}", OTHER)


def _interrupt() -> None:
    """A real signal where there is one: it ends a wait of the main thread too."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


@contextmanager
def _heard() -> Iterator[None]:
    """Ctrl-C that falls into a callback of the compiler, which swallows it, comes again
    a moment later.
    """
    before = sys.unraisablehook

    def hook(fault: Any) -> None:
        if issubclass(fault.exc_type, KeyboardInterrupt):
            again = threading.Timer(0.05, _interrupt)
            again.daemon = True
            again.start()
        else:
            before(fault)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _say(text: str, code: int, word: str = "Error: ") -> int:
    click.echo(printable(f"{word}{text}"), err=True)
    return code
