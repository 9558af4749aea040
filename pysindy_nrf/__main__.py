"""``python -m pysindy_nrf`` is the command line."""

from .output.cli import main

if __name__ == "__main__":
    main()
