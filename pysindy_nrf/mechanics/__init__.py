"""Where forces act: DOFs, storeys, links, and which balances an excitation can identify."""
