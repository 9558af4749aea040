"""The chain: DOFs, storeys, links, and the balances that an excitation can identify."""
