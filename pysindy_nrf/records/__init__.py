"""Measured records: channels on one clock, files and bundled data."""
