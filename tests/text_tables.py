"""Tables of cases, written as text."""

import re


def rows_of(table):
    """Cells of a table in which two blanks or more separate columns."""
    return [re.split(r"\s{2,}", line.strip()) for line in table.strip().splitlines()]
