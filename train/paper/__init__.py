"""The tables of the paper on the benchmark of `physconvex generate benchmark`."""
