"""Validity domains in regressor space: where a mode has been seen, how far a sample lies outside, which modes are one."""
