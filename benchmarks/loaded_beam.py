"""E and damping of the measured silicone beam from its motion with a known load hung on (Dubied et al. 2022).

PYTHONPATH=. python benchmarks/loaded_beam.py

The recording of `silicone_beam.py`'s beam with 1.00062 N (102 g) on the top edge of its free end. The load is given
here; how slack the string was that it hung by when the beam was let go is not known: for 60 ms the tip falls as that
of the bare beam. E, damping and the height at which the beam was held are fitted by the full model for each of some
slacks (none: the load is fixed to the beam from the start), and again at the best one, for each of the instants of
release of `silicone_beam.py`. ν is given, since bending does not tell it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from silicone_beam import AUTHORS, CELLS, HELD, OFFSETS_MS

from docs.figures.fem_cases.beam_capture import SIGMA, beam_capture
from docs.figures.fem_cases.beams import edge_load
from docs.figures.fem_cases.measured import GRAVITY, LOAD
from inference import interval_of
from physconvex.dynamics import HangingLoad
from physconvex.fem import Scene
from physconvex.identify import (
    Fit,
    FitOptions,
    FullModel,
    MarkerObservations,
    Twin,
    TwinOptions,
    base_twin,
    clustered_deviations,
    default_parameters,
    fit,
    marker_observations,
)

RESULT = Path(__file__).parent / "results" / "loaded_beam.json"
FRAMES, OBSERVED = 60, 40
RATIO = 0.45
MASS = float(LOAD / np.linalg.norm(GRAVITY))  # kg
SLACKS_MM = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0)
START = {"log10_youngs_modulus": 5.42, "damping_time": 5e-3}
OPTIONS = FitOptions(max_iterations=10, max_step=1.5, absolute_tolerance=0.02)


@dataclass(frozen=True, eq=False)
class LoadedModel(FullModel):
    """The full model of the twin with the load on the top edge of its free end.

    Attributes:
        slack: of the string [m].
    """

    slack: float = 0.0

    @property
    def differenced(self) -> bool:
        """A load that falls by itself at first has no derivatives of its own."""
        return True

    def scene(self, values: np.ndarray) -> Scene:
        """The scene with the parameters set, and the load."""
        masses = edge_load(self.rolled_mesh, (0.0, 0.0, MASS))[:, 2]
        return replace(super().scene(values), hanging=HangingLoad(self.rolled_mesh.vertices, masses, self.slack))


@dataclass(frozen=True)
class LoadedFit:
    """What was found for one slack; deviations take the errors of one frame's markers as one.

    Attributes:
        slack_mm: of the string.
        misfit: half the weighted squares.
        youngs_modulus, youngs_modulus_90: [Pa], and its 90 % interval for this slack.
        damping_time_ms, damping_time_90: and its 90 % interval.
        height_mm: of the middle of the beam, as it was held.
        rms_mm, future_rms_mm: of the markers in the fitted frames and in those that follow.
        converged: whether the search settled.
    """

    slack_mm: float
    misfit: float
    youngs_modulus: float
    youngs_modulus_90: tuple[float, float]
    damping_time_ms: float
    damping_time_90: tuple[float, float]
    height_mm: float
    rms_mm: float
    future_rms_mm: float
    converged: bool


def fitted(twin: Twin, seen: MarkerObservations, slack: float, start: dict[str, float]) -> Fit:
    """The fit for one slack [m]."""
    free = default_parameters(
        twin, damping=True, free=tuple(HELD), fixed=("poisson_ratio",), priors=HELD
    )  # fmt: skip
    begun = [p.at(start.get(p.name, p.start)) for p in free]
    model = LoadedModel(twin, tuple(p.name for p in free), seen.points, OBSERVED, slack=slack)
    return fit(model, seen, begun, options=OPTIONS)


def row_of(twin: Twin, found: Fit, slack: float, tracks: np.ndarray, seen: MarkerObservations) -> LoadedFit:
    """The fit as it is stored."""
    names = tuple(p.name for p in found.parameters)
    deviations = clustered_deviations(found, np.asarray(seen.frames))
    pairs = {name: (float(v), float(s)) for name, v, s in zip(names, found.values, deviations, strict=True)}
    (modulus, _), (damping, _) = pairs["log10_youngs_modulus"], pairs["damping_time"]
    softest, stiffest = interval_of(*pairs["log10_youngs_modulus"], -np.inf, np.inf)
    least, most = interval_of(*pairs["damping_time"], -np.inf, np.inf)
    model = LoadedModel(twin, names, seen.points, FRAMES, slack=slack)
    distance = np.square(model.positions(found.values) - tracks).sum(-1)
    observed, future = (1e3 * float(np.sqrt(d.mean())) for d in (distance[:OBSERVED], distance[OBSERVED:]))
    return LoadedFit(
        slack_mm=1e3 * slack,
        misfit=found.misfit,
        youngs_modulus=10**modulus,
        youngs_modulus_90=(10**softest, 10**stiffest),
        damping_time_ms=1e3 * damping,
        damping_time_90=(1e3 * least, 1e3 * most),
        height_mm=1e3 * pairs["initial_position_z"][0],
        rms_mm=observed,
        future_rms_mm=future,
        converged=found.converged,
    )


def lowest(slacks: list[float], misfits: list[float]) -> float:
    """Where a parabola through the best slack and its neighbours is lowest."""
    best = int(np.clip(np.argmin(misfits), 1, len(slacks) - 2))
    near = slice(best - 1, best + 2)
    a, b, _ = np.polyfit(slacks[near], misfits[near], 2)
    if a <= 0:
        return slacks[int(np.argmin(misfits))]
    return float(np.clip(-b / (2 * a), slacks[best - 1], slacks[best + 1]))


def fits_of(folder: Path, offset: float) -> list[LoadedFit]:
    """One instant of release [ms after the first frame that moves]: a fit for each slack, then one at the best."""
    capture = beam_capture(folder, "load101", frames=FRAMES, observed=OBSERVED, offset_ms=offset, cells=CELLS)
    tracks, seen = capture.tracks(), marker_observations(capture)
    assert tracks is not None
    twin = base_twin(capture, TwinOptions(weights=6)).with_values(("poisson_ratio",), np.array([RATIO]))
    start, rows = dict(START), list[LoadedFit]()

    def add(slack: float) -> None:
        found = fitted(twin, seen, slack, start)
        start.update({p.name: float(v) for p, v in zip(found.parameters, found.values, strict=True)})
        rows.append(row_of(twin, found, slack, tracks.positions, seen))
        print(offset, rows[-1], flush=True)

    for slack in SLACKS_MM:
        add(1e-3 * slack)
    add(1e-3 * lowest([row.slack_mm for row in rows], [row.misfit for row in rows]))
    return rows


def main() -> None:
    """Run and store."""
    torch.set_num_threads(1)
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    clock = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        fits = {offset: fits_of(Path(folder) / f"beam_{offset:+g}", offset) for offset in OFFSETS_MS}
    best = min(OFFSETS_MS, key=lambda offset: fits[offset][-1].misfit)
    result = {
        "command": "PYTHONPATH=. python benchmarks/loaded_beam.py",
        "authors": AUTHORS,
        "poisson_ratio": RATIO,
        "load_kg": MASS,
        "stated_noise_mm": 1e3 * SIGMA,
        "best": {"release_offset_ms": best} | asdict(fits[best][-1]),
        "by_release_offset_ms": {f"{offset:+g}": [asdict(row) for row in rows] for offset, rows in fits.items()},
        "process_seconds": round(time.process_time() - clock, 1),
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
