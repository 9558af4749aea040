"""The command ``app``: a page on this machine on which files are dropped."""

from __future__ import annotations

import click


@click.command(short_help="Open a page on your computer: drop files, get the verdict.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default="a free one",
    help="Port on 127.0.0.1.",
)
@click.option(
    "--browser/--no-browser", default=True, help="Open the page in the browser."
)
def app(port: int, browser: bool) -> None:
    """Open a page on which files are dropped, mapped, run and reported.

    It is served on 127.0.0.1 only, and needs the token in the address that is printed.
    Nothing leaves your computer. Ctrl-C ends it, and its files with it. It calls what
    the command line calls: inspect --write-mapping, and run. Needs the extra app.

    \b
    Examples
      pysindy-nrf app
      pysindy-nrf app --port 8080 --no-browser
    """
    from .app.server import serve

    def announce(address: str) -> None:
        click.echo(f"Open {address}   (Ctrl-C ends it)")

    serve(port, browser, announce)
