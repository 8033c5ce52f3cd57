"""Exceptions that physconvex raises on purpose."""


class PhysconvexError(Exception):
    """Base of every error raised on purpose."""


class InputError(PhysconvexError, ValueError):
    """Bad user input; the message names the argument, what came, what was expected and the remedy."""


class ConvergenceError(PhysconvexError, RuntimeError):
    """A solver could not reach its tolerance; the message says where and what was tried."""
