"""A kernel that cannot be had, to take the place of a real one."""

from pathlib import Path

from physconvex.kernels import Kernel

MISSING = Kernel(Path("missing"), {})
