"""The tables of the paper on the benchmark of `physconvex generate benchmark`."""

from inference.paper.evaluation import PaperOptions, evaluate_paper

__all__ = ["PaperOptions", "evaluate_paper"]
