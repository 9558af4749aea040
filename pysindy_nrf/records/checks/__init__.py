"""Checks of the channels of a record against each other."""
