"""Blind captures for tests of the diagnosis: what is hidden, how it is simulated, sealed labels, controls."""
