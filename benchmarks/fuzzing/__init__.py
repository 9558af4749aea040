"""Fuzzing of every reader: good files, damaged at random, in processes with limits."""
