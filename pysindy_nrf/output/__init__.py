"""Words, figures, the page and the command line."""
