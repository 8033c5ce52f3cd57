"""Exceptions that physconvex raises on purpose."""


class PhysconvexError(Exception):
    """Base of every error raised on purpose."""


class InputError(PhysconvexError, ValueError):
    """Bad user input; the message names the argument, its value, the expected value and the remedy."""


class ConvergenceError(PhysconvexError, RuntimeError):
    """A solver could not reach its tolerance; the message states where, and the attempts."""
