"""Fits and corrections as arrays, and back: what a stage keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physconvex.identify import Candidate, Correction, Fit, FullRun, Iteration, Parameter

__all__ = ["Scanned", "arrays_of_correction", "arrays_of_fit", "arrays_of_scan", "fit_of", "runs_of", "scan_of"]

Arrays = dict[str, np.ndarray]
Scanned = tuple[tuple[Parameter, ...], ...]


def arrays_of_scan(
    candidates: Sequence[Candidate], keep: int = 2, *, within: tuple[float, float] | None = None
) -> Arrays:
    """Pairs tried with their misfits, and the starts of the best ones, one with log10 E `within` bounds among them."""
    best = list(candidates[:keep])
    if within is not None:
        inside = [c for c in candidates if within[0] <= c.log10_youngs_modulus <= within[1]]
        best += [c for c in inside[:1] if c not in best]
    return {
        "pairs": np.array([[c.log10_youngs_modulus, c.poisson_ratio, c.misfit] for c in candidates]),
        "starts": np.array([[p.start for p in c.parameters] for c in best]),
    }


def scan_of(arrays: Arrays, parameters: Sequence[Parameter]) -> Scanned:
    """The starts, as parameters."""
    return tuple(tuple(p.at(float(v)) for p, v in zip(parameters, row, strict=True)) for row in arrays["starts"])


def arrays_of_fit(found: Fit) -> Arrays:
    """All numbers of a fit."""
    return {
        "starts": np.array([p.start for p in found.parameters]),
        "values": found.values,
        "positions": found.positions,
        "residuals": found.residuals,
        "jacobian": found.jacobian,
        "weights": found.weights,
        "history_values": np.array([i.values for i in found.history]),
        "history": np.array([[i.misfit, i.damping] for i in found.history]),
        "state": np.array([int(found.converged), found.evaluations]),
    }


def fit_of(arrays: Arrays, parameters: Sequence[Parameter]) -> Fit:
    """The fit again."""
    pairs = zip(arrays["history_values"], arrays["history"], strict=True)
    return Fit(
        tuple(replace(p, start=float(s)) for p, s in zip(parameters, arrays["starts"], strict=True)),
        arrays["values"],
        arrays["positions"],
        arrays["residuals"],
        arrays["jacobian"],
        arrays["weights"],
        tuple(Iteration(values, float(m), float(d)) for values, (m, d) in pairs),
        bool(arrays["state"][0]),
        int(arrays["state"][1]),
    )


def arrays_of_correction(found: Correction) -> Arrays:
    """The corrected fit, and the runs of the full model."""
    return arrays_of_fit(found.fit) | {
        "run_values": np.array([run.values for run in found.runs]),
        "runs": np.array([[run.misfit, run.distance] for run in found.runs]),
        "correction_converged": np.array(int(found.converged)),
    }


def runs_of(arrays: Arrays) -> tuple[FullRun, ...]:
    """The runs of the full model."""
    if "runs" not in arrays:
        return ()
    pairs = zip(arrays["run_values"], arrays["runs"], strict=True)
    return tuple(FullRun(values, float(m), float(d)) for values, (m, d) in pairs)
