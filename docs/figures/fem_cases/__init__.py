"""Verification problems of the finite-element code: set-up, run, and the numbers that tests and documentation share."""
