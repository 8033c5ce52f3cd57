"""The published method of fitting (PhysConvex, section 3.3), and the same with this project's parts in its place.

The field of the first frames (eq. 8) is the body: samples within the hulls of its convexes, M = 10 skinning weights
W^θ of a network trained on the body alone (eq. 4), implicit Euler steps, one a frame. From the network's prediction,
Adam fits E, ν and θ to all pixels of the observed frames of one view (eq. 9). Its rates 5e-3, 1e-3 and 5e-7 apply to
log10 E (the paper reports errors of log E), to ν, and to the entries of θ. What the paper leaves open is that of
`physconvex refine`: contact acts on the reconstructed closed surface, the background is the median of the frames.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField, bind_to_space
from physconvex.dynamics import Timing, simulate
from physconvex.identify import (
    PhotometricObservations,
    Twin,
    TwinOptions,
    base_twin,
    convex_twin,
    default_parameter,
    fit_in_turns,
    lower_bounds,
    moved_points,
    of_visible,
    simulation_loss,
    upper_bounds,
    with_few_samples,
    with_weights,
)
from physconvex.io import Capture, whole_file
from physconvex.reduced import NeuralWeights, ReducedTrajectory

NAMES = ("log10_youngs_modulus", "poisson_ratio")
WAYS: dict[str, tuple[bool, bool]] = {  # own steps, own optimiser
    "published_way": (False, False),
    "published_own_steps": (True, False),
    "published_own_optimiser": (False, True),
    "published_own_both": (True, True),
}
_STORE_EVERY = 20  # steps of Adam; then the visible convexes are found anew
_LEVELS = ((0.25, 1.0), (1.0, 0.0))  # of this project's optimiser: share of the images' scale, blur [pixels]


@dataclass(frozen=True)
class PublishedOptions:
    """Settings; the defaults are the paper's.

    Attributes:
        weights: M.
        steps: of Adam.
        rates: of Adam, for log10 E, ν and θ.
        own_steps: BDF2 with this project's time step, instead of implicit Euler with one step a frame.
        own_optimiser: Levenberg–Marquardt on E and ν, coarse images first, instead of Adam.
        turns: of that with fits of θ held near the data-free energy (`physconvex.identify.fit_weights`).
        scale: of the compared images.
        max_nodes: of the mesh that `Twin` needs; weights, mass and energy do not depend on it.
    """

    weights: int = 10
    steps: int = 400
    rates: tuple[float, float, float] = (5e-3, 1e-3, 5e-7)
    own_steps: bool = False
    own_optimiser: bool = False
    turns: int = 1
    scale: float = 1.0
    max_nodes: int = 200

    @classmethod
    def of_way(cls, way: str) -> PublishedOptions:
        """The settings of one of `WAYS`."""
        own_steps, own_optimiser = WAYS[way]
        return cls(own_steps=own_steps, own_optimiser=own_optimiser)


@dataclass(frozen=True, eq=False)
class PublishedFit:
    """Result of a fit.

    Attributes:
        values: log10 E, ν after the last step.
        losses: L_sim of every step; of the last images alone, if the optimiser is this project's.
        twin: the convex twin with these values and the fitted weights.
        field: its convexes at rest [m].
        trajectory: its motion in all frames of the capture.
    """

    values: Float[np.ndarray, " 2"]
    losses: Float[np.ndarray, " N"]
    twin: Twin
    field: ConvexField
    trajectory: ReducedTrajectory

    def fields(self, frames: range) -> list[ConvexField]:
        """The moved convexes in some frames."""
        bound = bind_to_space(self.field, self.trajectory.space)
        return [bound.at(self.trajectory.coordinates[frame]) for frame in frames]


def fit_as_published(
    capture: Capture,
    field: ConvexField,
    start: Float[np.ndarray, " 2"],
    *,
    options: PublishedOptions | None = None,
    out: Path | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> PublishedFit:
    """Fit E, ν and θ to the video of the first camera that has one.

    Args:
        capture: with a video, its masks, and a rest geometry (`inference.with_rest_geometry`).
        field: the reconstruction's, at rest [m].
        start: log10 E, ν.
        options: settings.
        out: folder in which the state of Adam is stored, every twenty steps; the same call continues from it.
        on_step: called with the number of every finished step of Adam, and its loss.

    Raises:
        InputError: no video, no mask or no geometry; `out` holds another fit.
        ConvergenceError: the model fails at the start.
    """
    options = options or PublishedOptions()
    twin = _convex_twin(capture, field, np.asarray(start, dtype=np.float64), options)
    timing = twin.timing()
    if not options.own_steps:
        timing = replace(timing, integrator="implicit_euler", steps_per_frame=1)
    seen = partial(_seen, capture, field, options)
    if options.own_optimiser:
        twin, losses = _own_optimiser(twin, seen, timing, options.turns)
    else:
        claim = _claim(capture, field, start, options)
        adam = _Adam(twin, seen(1.0, 0.0), timing, options)
        losses = adam.run(None if out is None else out / "adam.safetensors", claim, on_step)
        twin = adam.twin()
    values = [np.log10(twin.scene.body.youngs_modulus.mean()), twin.scene.body.poisson_ratio.mean()]
    return PublishedFit(np.array(values), losses, twin, field, simulate(twin.scene, timing))


def _convex_twin(capture: Capture, field: ConvexField, start: np.ndarray, options: PublishedOptions) -> Twin:
    """The body of the convexes, with the mass at the samples of the energy, and weights trained on it (eq. 4)."""
    base = base_twin(capture, TwinOptions(1, options.max_nodes, fill=True)).with_values(NAMES, start)
    return with_few_samples(convex_twin(base, field, "neural", weights=options.weights))


def _seen(
    capture: Capture, field: ConvexField, options: PublishedOptions, share: float, blur: float
) -> PhotometricObservations:
    """All pixels of the observed frames of the front view, at a share of the settings' scale."""
    if not capture.filmed:
        raise InputError(f"{capture.folder}: no camera has a video; the published way needs one")
    camera = capture.filmed[0]
    masks = capture.mask(camera.name)
    if masks is None:
        raise InputError(f"{capture.folder}: camera {camera.name!r} has no masks; expected {camera.name}_mask.mp4")
    frames = capture.video(camera.name).frames[: capture.observed_frames]
    seen = PhotometricObservations.of_video(
        camera, frames, masks[: len(frames)], field, scale=share * options.scale, blur=blur, exposure=False
    )
    whole = np.tile([0, seen.camera.h, 0, seen.camera.w], (len(frames), 1))
    return replace(seen, windows=whole, robust_scale=np.inf)


def _own_optimiser(
    twin: Twin, seen: Callable[[float, float], PhotometricObservations], timing: Timing, turns: int
) -> tuple[Twin, np.ndarray]:
    """Levenberg–Marquardt, coarse images first; θ in turns with it at the finest."""
    values = [np.log10(twin.scene.body.youngs_modulus.mean()), twin.scene.body.poisson_ratio.mean()]
    parameters = [default_parameter(name, start=float(v)) for name, v in zip(NAMES, values, strict=True)]
    for number, (share, blur) in enumerate(_LEVELS):
        images = seen(share, blur)
        finest = number == len(_LEVELS) - 1
        twin, found = fit_in_turns(twin, parameters, [images], turns=turns if finest else 0, timing=timing)
        parameters = [p.at(float(v)) for p, v in zip(parameters, found.values, strict=True)]
    misfits = np.array([state.misfit for state in found.history])
    return twin, 2 * images.sigma**2 / images.sizes.sum() * misfits


class _Adam:
    """Adam (Kingma & Ba 2015) on log10 E, ν and θ, within the bounds of E and ν."""

    def __init__(self, twin: Twin, seen: PhotometricObservations, timing: Timing, options: PublishedOptions) -> None:
        weights = twin.scene.body.space.field
        assert isinstance(weights, NeuralWeights)
        self._twin, self.seen, self.weights, self.options = twin, seen, weights, options
        self.timing = replace(timing, frames=len(seen.images))
        body = twin.scene.body
        self.modulus = torch.tensor(np.log10(body.youngs_modulus.mean()), requires_grad=True)
        self.ratio = torch.tensor(body.poisson_ratio.mean(), requires_grad=True)
        self.theta = weights.theta.clone().requires_grad_()
        groups = zip(self._parts, options.rates, strict=True)
        self.adam = torch.optim.Adam([{"params": [part], "lr": rate} for part, rate in groups])
        self.losses: list[float] = []
        self.shown: PhotometricObservations | None = None

    @property
    def _parts(self) -> list[Tensor]:
        return [self.modulus, self.ratio, self.theta]

    def run(self, file: Path | None, claim: str, on_step: Callable[[int, float], None] | None) -> np.ndarray:
        """All steps that are left; the losses of all."""
        if file is not None and file.exists():
            self._load(file, claim)
        while len(self.losses) < self.options.steps:
            try:
                self._step()
            except ConvergenceError as error:
                if not self.losses:
                    raise
                raise ConvergenceError(f"step {len(self.losses) + 1} of Adam: {error}") from error
            done = len(self.losses)
            if file is not None and (done % _STORE_EVERY == 0 or done == self.options.steps):
                self._store(file, claim)
            if on_step is not None:
                on_step(done, self.losses[-1])
        return np.array(self.losses)

    def _step(self) -> None:
        self.adam.zero_grad()
        if self.shown is None or len(self.losses) % _STORE_EVERY == 0:
            with torch.no_grad():
                (self.shown,) = of_visible([self.seen], self._moved(self.seen))
        loss = simulation_loss(self._moved(self.shown), [self.shown])
        loss.backward()
        self.adam.step()
        usual = [default_parameter(name) for name in NAMES]
        with torch.no_grad():
            for value, low, high in zip(
                (self.modulus, self.ratio), lower_bounds(usual), upper_bounds(usual), strict=True
            ):
                value.clamp_(float(low), float(high))
        self.losses.append(float(loss.detach()))

    def _moved(self, seen: PhotometricObservations) -> Tensor:
        """Positions of the points of the convexes."""
        values = torch.stack([self.modulus, self.ratio])
        weights = self.weights.with_theta(self.theta)
        return moved_points(self._twin, weights, seen.points, self.timing, parameters=NAMES, values=values)

    def twin(self) -> Twin:
        """The twin with the present values."""
        twin = self._twin.with_values(NAMES, np.array([float(self.modulus.detach()), float(self.ratio.detach())]))
        return with_weights(twin, self.weights.with_theta(self.theta.detach()))

    def _store(self, file: Path, claim: str) -> None:
        """Parameters and moments, under their name at once."""
        tensors = {"losses": torch.tensor(self.losses, dtype=torch.float64)}
        for number, part in enumerate(self._parts):
            tensors[f"{number}"] = part.detach().contiguous()
            tensors |= {f"{number}.{name}": value.contiguous() for name, value in self.adam.state[part].items()}
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as unfinished:
            save_file(tensors, unfinished, metadata={"claim": claim})

    def _load(self, file: Path, claim: str) -> None:
        with safe_open(file, framework="pt") as stored:
            if (stored.metadata() or {}).get("claim") != claim:
                raise InputError(f"{file}: holds another fit; remove it, or choose another folder")
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}
        self.losses = tensors["losses"].tolist()
        for number, part in enumerate(self._parts):
            with torch.no_grad():
                part.copy_(tensors[f"{number}"])
            moments = {name: tensors[f"{number}.{name}"] for name in ("step", "exp_avg", "exp_avg_sq")}
            self.adam.state[part] = moments


def _claim(capture: Capture, field: ConvexField, start: np.ndarray, options: PublishedOptions) -> str:
    """Checksum of what a fit depends on, but for the number of steps."""
    settings = asdict(options) | {"steps": 0, "start": [float(value) for value in start]}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for part in (field.points, field.harmonics, field.opacity):
        digest.update(part.detach().double().numpy().tobytes())
    digest.update((capture.folder / "capture.json").read_bytes())
    return digest.hexdigest()
