"""A page on this machine on which files are dropped, mapped, run and reported.

It calls what the command line calls: the proposal and the reading of files, and the
command ``run`` in its own process.
"""
