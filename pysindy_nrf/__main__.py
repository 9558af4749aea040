"""``python -m pysindy_nrf`` is the command line."""

from .cli import main

if __name__ == "__main__":
    main()
