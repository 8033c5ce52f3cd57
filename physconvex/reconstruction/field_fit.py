"""Fitting a field to views: the loss, the steps, the schedule, and the file from which a stopped fit continues."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from physconvex.convex import ConvexField, FreeParameters
from physconvex.errors import InputError
from physconvex.io import whole_file
from physconvex.reconstruction.config import ReconstructionConfig
from physconvex.reconstruction.field_refinement import hidden, refine_field
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.row_adam import RowAdam
from physconvex.reconstruction.scores import structural_similarity
from physconvex.reconstruction.start import Start
from physconvex.render import RenderedImage, render

WARM_UP = 20  # steps over which the rates rise at the start
WIDEST, NARROWEST = 10.0, 0.1  # permitted edges, times the first width
SHARPEST = 20.0  # β and 1/β at most
NAMES = tuple(entry.name for entry in fields(FreeParameters))


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit: steps done and in all, recent mean loss, convexes, scale of the images."""

    step: int
    steps: int
    loss: float
    convexes: int
    scale: float


@dataclass
class FitState:
    """The state from which a fit can continue.

    Attributes:
        parameters: of the field.
        adam: moments of their gradients.
        fixed: fillers, and convexes that no view shows: they do not change, shape [N].
        footprint: [m].
        surface_known: whether the start is made from a mesh, so that invisible convexes belong to the body.
        step: steps done.
        seconds: time spent.
        losses: of every step.
    """

    parameters: FreeParameters
    adam: RowAdam
    fixed: Tensor
    footprint: float
    surface_known: bool
    step: int = 0
    seconds: float = 0.0
    losses: list[float] = field(default_factory=list)

    def field(self) -> ConvexField:
        """The field as it is now, without a graph."""
        with torch.no_grad():
            return self.parameters.field().map(torch.detach)

    def to(self, device: torch.device | str) -> FitState:
        """The state on another device."""
        moved = FreeParameters(*(t.detach().to(device).requires_grad_() for t in self.parameters.tensors()))
        return replace(self, parameters=moved, adam=self.adam.to(device), fixed=self.fixed.to(device))


def begin(start: Start) -> FitState:
    """The state before the first step."""
    parameters = FreeParameters.of(start.field)
    fixed = torch.arange(len(start.field), device=start.field.points.device) >= len(start.field) - start.fillers
    return FitState(parameters, RowAdam.of(parameters.tensors()), fixed, start.footprint, start.kind == "mesh")


def image_loss(image: RenderedImage, seen: Observation, config: ReconstructionConfig) -> Float[Tensor, ""]:
    """(1 − λ) L1 + λ (1 − SSIM)/2 + μ mean |alpha − mask|."""
    loss = (1 - config.dissimilarity) * (image.colour - seen.image).abs().mean()
    if config.dissimilarity:
        loss = loss + config.dissimilarity * 0.5 * (1 - structural_similarity(image.colour, seen.image))
    return loss + config.mask_weight * (image.alpha - seen.coverage).abs().mean()


def fit_field(
    state: FitState,
    observations: Sequence[Observation],
    config: ReconstructionConfig,
    *,
    on_step: Callable[[FitProgress, FitState], None] | None = None,
) -> FitState:
    """Do the remaining steps, in place, on the device of the state.

    Each step renders one view, in an order that depends only on the seed and the step, so that an interrupted fit gives
    the result of an uninterrupted one.

    Args:
        observations: on the CPU.
        on_step: called after every step, for example to show progress or to store the state.
    """
    device = state.fixed.device
    levels = {
        scale: [seen.resized(scale).cropped().to(device) for seen in observations] for scale in set(config.levels)
    }
    refinements = set(config.refinement_steps())
    if state.step == 0 and state.surface_known:
        finest = max(config.levels)
        state.fixed = state.fixed | hidden(state.field(), levels[finest], footprint=state.footprint / finest)
    while state.step < config.steps:
        clock = time.perf_counter()
        views = levels[config.scale_at(state.step)]
        if state.step in refinements:
            _refine(state, views, config)
        epoch, place = divmod(state.step, len(views))
        seen = views[np.random.default_rng([config.seed, epoch]).permutation(len(views))[place]]
        loss = _step(state, seen, config)
        state.step += 1
        state.losses.append(loss)
        state.seconds += time.perf_counter() - clock
        if on_step is not None:
            recent = float(np.mean(state.losses[-len(views) :]))
            count = len(state.fixed)
            on_step(FitProgress(state.step, config.steps, recent, count, config.scale_at(state.step - 1)), state)
    return state


def _step(state: FitState, seen: Observation, config: ReconstructionConfig) -> float:
    """One step of Adam on one view; the loss before it."""
    tensors = state.parameters.tensors()
    for tensor in tensors:
        tensor.grad = None
    current = state.parameters.field()
    loss = image_loss(render(current, seen.view, background=seen.background), seen, config)
    loss.backward()
    state.adam.step(tensors, _rates(state, config))
    with torch.no_grad():
        state.parameters.harmonics[:, 1:] *= 1 - config.view_decay
        first = np.log(4 / (config.edge_width * state.footprint))
        state.parameters.log_smoothness.clamp_(first - np.log(WIDEST), first - np.log(NARROWEST))
        state.parameters.log_sharpness.clamp_(-np.log(SHARPEST), np.log(SHARPEST))
        state.parameters.logit_opacity.clamp_(-8.0, 8.0)
    return float(loss.detach())


def _rates(state: FitState, config: ReconstructionConfig) -> tuple[Tensor | float, ...]:
    """Rates of points, log α, log β, logit of the opacity, harmonics: fall geometrically after the warm-up."""
    factor = config.final_rate ** (state.step / config.steps) * min(1.0, (state.step + 1) / WARM_UP)
    free = (~state.fixed).float() * factor
    colour = free.new_full((state.parameters.harmonics.shape[1], 1), config.colour_rate * config.view_rate)
    colour[0] = config.colour_rate
    return (
        (config.point_rate * state.footprint * free)[:, None, None],
        config.edge_rate * free,
        config.edge_rate * free,
        config.opacity_rate * free,
        colour * free[:, None, None],
    )


def _refine(state: FitState, views: Sequence[Observation], config: ReconstructionConfig) -> None:
    generator = torch.Generator("cpu").manual_seed(config.seed + state.step)
    pixel = state.footprint / config.scale_at(state.step)
    made = refine_field(
        state.field(),
        views,
        budget=config.fit_budget,
        footprint=pixel,
        fixed=state.fixed,
        generator=generator,
        keep_hidden=state.surface_known,
    )
    state.parameters = FreeParameters.of(made.field)
    state.adam = state.adam.select(made.sources, made.fresh)
    state.fixed = made.fixed


def save_fit(state: FitState, path: Path, *, claim: str) -> None:
    """Write the state under its name atomically; `claim` identifies the fit."""
    tensors = {"fixed": state.fixed, "losses": torch.tensor(state.losses, dtype=torch.float64, device="cpu")}
    groups = {"": state.parameters.tensors(), "first.": state.adam.first, "second.": state.adam.second}
    for prefix, group in groups.items():
        tensors |= {prefix + name: value.detach().contiguous() for name, value in zip(NAMES, group, strict=True)}
    numbers = {
        "claim": claim,
        "footprint": state.footprint,
        "surface_known": state.surface_known,
        "step": state.step,
        "seconds": state.seconds,
        "adam_steps": state.adam.steps,
    }
    with whole_file(path) as partial:
        save_file(tensors, partial, metadata={"state": json.dumps(numbers)})


def load_fit(path: Path, *, claim: str) -> FitState | None:
    """The state in a file; None without a file.

    Raises:
        InputError: the file belongs to another claim, or is not from `save_fit`.
    """
    if not path.exists():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            numbers = json.loads((file.metadata() or {})["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        groups = [[tensors[prefix + name] for name in NAMES] for prefix in ("", "first.", "second.")]
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path}: no state of a reconstruction ({error}); remove it, or start anew with redo"
        ) from None
    if numbers["claim"] != claim:
        raise InputError(
            f"{path}: belongs to another capture or other settings; choose another folder, or start anew with redo"
        )
    return FitState(
        FreeParameters(*(tensor.requires_grad_() for tensor in groups[0])),
        RowAdam(groups[1], groups[2], numbers["adam_steps"]),
        tensors["fixed"],
        numbers["footprint"],
        numbers["surface_known"],
        numbers["step"],
        numbers["seconds"],
        tensors["losses"].tolist(),
    )
