"""The object of a refinement as a convex field bound to the body: it moves as the fitted model does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import UInt8
from pydantic import JsonValue
from scipy.spatial.transform import Rotation

from inference.reconstruction_views import capture_views
from inference.refinement.motion import RefinedMotion
from inference.refinement.options import RefineOptions
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import InputError
from physconvex.convex import AdaptedField, BoundField, ConvexField, bind_to_tets, read_ply
from physconvex.identify import cast_camera_rays
from physconvex.io import Camera, Capture
from physconvex.numerics import device_named
from physconvex.reconstruction import (
    Observation,
    begin,
    fill_gaps,
    fit_field,
    observation_of,
    score_views,
    start_field,
)
from physconvex.render import render

_BUDGET, _STEPS = 6000, 150  # of a field that starts from a given mesh
_PARTS = ("points", "smoothness", "sharpness", "opacity", "harmonics")


@dataclass(frozen=True, eq=False)
class FieldSplit:
    """The field split for the fitted motion.

    Attributes:
        adapted: the field whose convexes move nearly affinely, with its counts.
        gain: by which it draws the object's pixels of the observed frames better than the whole field [dB of PSNR].
    """

    adapted: AdaptedField
    gain: float

    @property
    def used(self) -> bool:
        """Whether the split field is the one that is drawn."""
        return self.gain > 0

    def to_json(self) -> dict[str, JsonValue]:
        """Counts, distances from affine [m], gain [dB]."""
        return {**self.adapted.to_json(), "gain_db": self.gain, "used": self.used}


@dataclass(frozen=True, eq=False)
class Appearance:
    """A convex field at rest and the motion that carries it.

    Attributes:
        field: at rest, world frame.
        motion: of the fitted model.
        source: origin of the field, in words.
        first_frame_psnr: of each camera's first image, over the pixels of the object [dB].
        split: what splitting its convexes for the motion brings; None without videos to compare with.
    """

    field: ConvexField
    motion: RefinedMotion
    source: str
    first_frame_psnr: dict[str, float]
    split: FieldSplit | None = None

    @cached_property
    def bound(self) -> BoundField:
        """Bound to the nodes of the model's mesh."""
        return bind_to_tets(self.field, self.motion.mesh)

    def to_json(self) -> dict[str, JsonValue]:
        """Number of convexes, source, PSNR of the first images [dB], splitting."""
        scores: dict[str, JsonValue] = {**self.first_frame_psnr}
        return {
            "convexes": len(self.field),
            "source": self.source,
            "first_frame_psnr_object": scores,
            "splitting": None if self.split is None else self.split.to_json(),
        }

    def at(self, frame: int) -> ConvexField:
        """The field in a frame."""
        return self.bound.at(self.motion.nodes[frame])

    @torch.no_grad()
    def image(self, frame: int, camera: Camera) -> tuple[UInt8[np.ndarray, "H W 3"], np.ndarray]:
        """A camera's image of it in a frame, on white, and its alpha [H, W]."""
        found = render(self.at(frame), camera, background=torch.ones(3))
        colour = (255 * found.colour.clamp(0, 1)).round().to(torch.uint8).numpy()
        return colour, found.alpha.numpy()


class RestField:
    """The object at rest as a convex field: given, or fitted to the cameras' first images beside other work.

    If the capture has a mesh, the fit starts from it: one camera is enough in this case. The gaps inside are filled.

    Args:
        run: the refinement.

    Attributes:
        field: the convexes; None if the field is off or impossible (with a warning).
        source: its origin, in words.
        psnr: of each camera's first image, over the pixels of the object [dB].
    """

    def __init__(self, run: RefinementRun) -> None:
        self._run, self._fit = run, None
        options = run.options
        if options.field_file is None and options.field and run.capture.pictured:
            call = partial(fitted_field, run.capture, options)
            self._fit = call if run.stages.known("field") else run.workers.start(call)

    @cached_property
    def _found(self) -> Arrays | None:
        try:
            return None if self._fit is None else self._run.stages.run("field", self._fit)
        except InputError as error:
            self._run.warnings.append(f"No convex field: {error}")
            return None

    @cached_property
    def field(self) -> ConvexField | None:
        """The convexes.

        Raises:
            InputError: `field_file` of the options is no field.
        """
        if self._run.options.field_file is not None:
            return read_ply(Path(self._run.options.field_file))
        if self._found is None:
            return None
        return ConvexField(*(torch.as_tensor(self._found[name]) for name in _PARTS))

    @property
    def psnr(self) -> dict[str, float]:
        """Of each camera's first image [dB]."""
        if self._found is None:
            return {}
        return dict(zip(map(str, self._found["cameras"]), map(float, self._found["psnr"]), strict=True))

    @property
    def source(self) -> str:
        """In words."""
        if self._found is None:
            return "field given"
        return f"first images of {len(self.psnr)} cameras, from {self._found['kind']}"


def fitted_field(capture: Capture, options: RefineOptions) -> Arrays:
    """Parts of a field fitted to the first images on `options.device`, and the quality of each camera's image [dB]."""
    mesh = capture.mesh()
    views = capture_views(replace(capture, cameras=capture.pictured), least=2 if mesh is None else 1).training
    budget, steps = options.field_budget or _BUDGET, options.field_steps or _STEPS
    config = options.reconstruction.replace(budget=budget, steps=steps).resolved
    around = [*views]
    if mesh is not None and len(views) == 1:  # the hidden sides get the mean colour and stay fixed
        around += [_unseen(views[0], mesh, degrees) for degrees in (100.0, 180.0, 260.0)]
    start = start_field(around, config, mesh=mesh)
    state = fit_field(begin(start).to(device_named(options.device)), views, config)
    field = state.field().to("cpu")
    if mesh is not None and mesh.is_watertight:
        field = fill_gaps(field, mesh, footprint=state.footprint, budget=config.budget)
    scores = [one for one, _ in score_views(field, views)]
    arrays = {name: getattr(field, name).detach().cpu().numpy() for name in _PARTS}
    return arrays | {
        "cameras": np.array([one.camera for one in scores]),
        "psnr": np.array([one.psnr_object for one in scores]),
        "kind": np.array(start.kind),
    }


def appearance_of(motion: RefinedMotion, rest: RestField) -> Appearance | None:
    """The field at rest with the motion; None without a field."""
    return None if rest.field is None else Appearance(rest.field, motion, rest.source, rest.psnr)


def _unseen(seen: Observation, mesh: trimesh.Trimesh, degrees: float) -> Observation:
    """The object from another side, in its mean colour: the camera rotated about the vertical axis through it."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    centre = 0.5 * (vertices.min(0) + vertices.max(0))
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    matrix = np.array(seen.camera.transform_matrix, dtype=np.float64)
    matrix[:3, :3], matrix[:3, 3] = turn @ matrix[:3, :3], centre + turn @ (matrix[:3, 3] - centre)
    camera = replace(seen.camera, name=f"{seen.camera.name}+{degrees:g}", transform_matrix=matrix)
    inside = cast_camera_rays(camera, vertices, faces).faces >= 0
    mean = seen.image[seen.coverage > 0.99].mean(0).numpy()
    frame = np.where(inside[..., None], 255 * mean, 255.0).round().astype(np.uint8)
    return observation_of(camera, frame, np.where(inside, np.uint8(255), np.uint8(0)))
