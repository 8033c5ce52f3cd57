"""The last search compares colours: the fitted model moves the first image, blurred as wide as the model's error.

The rebound of a stiff body depends on E, ν and damping together. The followed points cannot distinguish rebounds, since
rigid drift absorbs the difference. The colours can, but only near the solution. If they lose the body after a contact,
the search restarts from another material.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from inference.refinement.coarse_start import misfits_of
from inference.refinement.problem import Problem, in_pixels, material_of, started_from, tried
from inference.refinement.rigid_drift import drifted, with_drift
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError, InputError
from physconvex.identify import (
    FULL_OPTIONS,
    ColourObservations,
    Fit,
    FullModel,
    Observations,
    PixelObservations,
    ReducedModel,
    StackedObservations,
    blurred,
    colour_seeds,
    fit,
    seen_by,
)

_NARROW = 1.5  # pixels
_WIDE = 6.0  # pixels: finds the nearest rebound from far away
_LOST = 5.0  # times the colours' residuals in flight: above it the body is lost after the contact
_MODULI = (0.0, -0.08, 0.08)  # decades
_RATIOS = (0.25, 0.42)
_LOSSES = (0.1, 0.3)  # of energy, by the slowest wave's angular frequency times β; besides the fitted damping


def fit_colours(run: RefinementRun, problem: Problem, found: Fit) -> tuple[Problem, Fit]:
    """The problem with colours instead of the followed points, and its fit from another one."""
    kept = problem
    try:
        kept, found = _fitted(run, problem, found, blur_for(problem))
        if run.options.own_derivatives and (lost := colours_lost(kept, found)) > _LOST:
            kept, found = _restarted(run, problem, kept, found, lost)
    except ConvergenceError as error:
        run.warnings.append(f"Colours were not compared, or not again: the model failed ({error}).")
    return kept, found


def _fitted(run: RefinementRun, problem: Problem, found: Fit, blur: float, name: str = "") -> tuple[Problem, Fit]:
    trial = with_drift(run, _coloured(run, problem, found, blur), found, f"drift_{blur:g}{name}")
    start = started_from(problem.parameters, found)
    model = trial.full(run.memory) if run.options.own_derivatives else trial.reduced
    stage = f"colours_{blur:g}{name}"
    return trial, run.fit(stage, problem.parameters, lambda: fit(model, trial.weighted, start, options=FULL_OPTIONS))


def _restarted(run: RefinementRun, problem: Problem, kept: Problem, found: Fit, lost: float) -> tuple[Problem, Fit]:
    """The fit from the nearby material with the smallest misfit of wide-blurred colours, if it is the better one."""
    values = materials_about(problem, found)

    def compute() -> Arrays:
        colours = _coloured(run, problem, found, _WIDE).observed
        wide = replace(kept, observed=colours)
        return {"misfits": misfits_of(wide, wide.full(run.memory), values)}

    best = int(np.argmin(run.stages.run("elsewhere", compute)["misfits"]))
    if best == 0:
        return kept, found
    there, moved = kept, replace(found, values=values[best])
    for blur in dict.fromkeys((_WIDE, blur_for(problem))):
        there, moved = _fitted(run, problem, moved, blur, "_elsewhere")
    return (there, moved) if colours_lost(there, moved) < lost else (kept, found)


def blur_for(problem: Problem) -> float:
    """Width of the blur [pixels], in steps of one half.

    It is the model's error in the images of the nearest camera. A narrower blur compares unrelated pixels.
    """
    return float(np.clip(round(2 * in_pixels(problem, problem.astray)) / 2, _NARROW, _WIDE))


def colours_lost(problem: Problem, found: Fit) -> float:
    """Ratio of the colours' rms residual from the first contact on to that before it, where the model is nearly exact.

    One if there is no contact, or no colour is compared on one of the two sides.
    """
    if problem.drift_limit is None:
        return 1.0
    stack, positions, begin = problem.observed.observations, drifted(problem, found), problem.drift_limit[0]
    before, after = [], []
    for part, where in zip(stack.parts, stack.point_slices, strict=True):
        if isinstance(part, ColourObservations):
            squares = np.square(part.residuals(positions[:, where]))
            before.append(squares[part.frames < begin])
            after.append(squares[part.frames >= begin])
    flight, rest = (np.concatenate(part) if part else np.zeros(0) for part in (before, after))
    if not len(flight) or not len(rest):
        return 1.0
    return float(np.sqrt(rest.mean() / max(flight.mean(), 1e-12)))


def materials_about(problem: Problem, found: Fit) -> list[Float[np.ndarray, " K"]]:
    """Values at which to look for another rebound, those of the fit first."""
    parameters = started_from(problem.parameters, found)
    modulus, density = material_of(problem.twin, found)
    slowest = np.pi * np.sqrt(10.0**modulus / density) / problem.twin.mesh.size  # half a wave along the body [rad/s]
    kept = {p.name: p.start for p in parameters}
    others = {
        "log10_youngs_modulus": [modulus + change for change in _MODULI],
        "poisson_ratio": _RATIOS,
        "damping_time": [kept.get("damping_time", 0.0), *(loss / slowest for loss in _LOSSES)],
    }
    choices = (tried(p, others.get(p.name, [p.start])) for p in parameters)
    return [found.values, *map(np.array, product(*choices))]


def _coloured(run: RefinementRun, problem: Problem, found: Fit, blur: float) -> Problem:
    """The problem with the colours of surface points instead of the followed points.

    The fitted model gives the visible points. A camera that sees none keeps its followed points.
    """
    model: FullModel | ReducedModel = problem.full(run.memory) if run.options.correction else problem.reduced
    observed, (vertices, triangles) = problem.observed, problem.twin.surface
    parts: list[Observations] = []
    sources = []
    for part, source in zip(observed.observations.parts, observed.sources, strict=True):
        added = None
        if isinstance(part, PixelObservations):
            images = run.capture.video(part.camera.name).frames[: len(part.pixels)]
            masks = run.capture.mask(part.camera.name)
            margin = round(2 * blur)
            seeds = colour_seeds(
                part.camera, images[0], vertices, triangles, mask=None if masks is None else masks[0], margin=margin
            )
            points = seeds.on(vertices, triangles)
            if len(points):
                everything = np.concatenate([vertices, points])
                moved = replace(model, points=everything).positions(found.values)
                surface, carried = moved[:, : len(vertices)], moved[:, len(vertices) :]
                visible = seen_by(part.camera, surface, triangles, carried, seeds.faces, margin=margin)
                added = _colours(part, points, blurred(images, blur), visible, run.options.exposure)
        parts.append(part if added is None else added)
        sources.append(
            source if added is None else f"camera {added.camera.name}: colours of {len(added.points)} points"
        )
    observed = replace(observed, observations=StackedObservations.of(parts), sources=tuple(sources))
    return replace(problem, observed=observed)


def _colours(
    part: PixelObservations, points: np.ndarray, images: np.ndarray, visible: np.ndarray, exposure: bool
) -> ColourObservations | None:
    try:
        return ColourObservations(part.camera, points, images, visible, exposure=exposure)
    except InputError:  # no point is visible again
        return None
