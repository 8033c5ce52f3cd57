"""The base twin of a capture: what `capture.json` states, reduced and full-order on one mesh; other weights for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from physconvex.dynamics import Plane, Timing, in_world
from physconvex.errors import ConvergenceError, InputError
from physconvex.fem import ElasticBody, Scene
from physconvex.identify.clamping import Clamp, clamp_of
from physconvex.io import Capture
from physconvex.mesh import TetMesh, enclosed_volume, filled, mesh_of_few_nodes, shape_mismatch, to_quadratic
from physconvex.reduced import (
    BodySamples,
    NodalWeights,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    WeightField,
    eigenmode_weights,
    elastic_weights,
    snapshot_weights,
    with_parameters,
)

RATE = 384.0  # least time steps per second: the time step's error stays below 0.02 decades of E, see design notes
_NODES_PER_WEIGHT = 5  # each weight adds four functions
_LOST = 0.2  # of the joint volume of body and mesh; a mesh that misses more of it is not replaced by a coarser one
_Surface = tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]


@dataclass(frozen=True)
class TwinOptions:
    """How a twin is discretised.

    Attributes:
        weights: number M of skinning weights besides the constant one, see `smooth_weights`.
        max_nodes: most nodes of the quadratic mesh; finer tetrahedra of a capture are remeshed.
        steps_per_frame: time steps per frame; None: at least 384 per second, at least 4 per frame.
        law: elastic law, see `physconvex.materials.laws`.
        youngs_modulus, poisson_ratio: of the twin before the fit.
        fill: whether mass and energy of a mesh made of a surface are those of the surface's interior
            (`physconvex.mesh.filled`).
    """

    weights: int = 20
    max_nodes: int = 700
    steps_per_frame: int | None = None
    law: str = "neo_hookean"
    youngs_modulus: float = 1e5
    poisson_ratio: float = 0.35
    fill: bool = False


@dataclass(frozen=True, eq=False)
class Twin:
    """A capture's body and world, ready for simulation.

    Attributes:
        capture: where it comes from.
        mesh: quadratic tetrahedra, rest state = state at t = 0, world frame [m].
        scene: the reduced scene; its cells are the tetrahedra of `mesh`.
        clamp: the held nodes, or None.
        steps_per_frame: time steps per frame.
    """

    capture: Capture
    mesh: TetMesh
    scene: ReducedScene
    clamp: Clamp | None
    steps_per_frame: int

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.capture.fps

    @property
    def may_strike(self) -> bool:
        """Whether the free body can hit an obstacle."""
        return bool(self.scene.obstacles) and self.clamp is None

    @property
    def surface(self) -> _Surface:
        """Rest vertices [m] and triangles of the body's surface: of the capture's mesh, else of the tetrahedra."""
        return _shown_surface(self.capture) or self.mesh.surface

    def with_scene(self, **changes: Any) -> Twin:
        """The same twin with fields of its reduced scene replaced (an effect added, for example)."""
        return replace(self, scene=replace(self.scene, **changes))

    def with_values(self, names: Sequence[str], values: Float[np.ndarray, " K"]) -> Twin:
        """The same twin with parameters set."""
        return replace(self, scene=with_parameters(self.scene, names, values))

    def timing(self, frames: int | None = None) -> Timing:
        """Timing of the roll-outs; all of the capture's frames unless given."""
        count = self.capture.frames if frames is None else frames
        return Timing(frames=count, fps=self.fps, steps_per_frame=self.steps_per_frame)

    def full_scene(self, mesh: TetMesh | None = None) -> Scene:
        """The same body and world for the full-order model.

        Args:
            mesh: another mesh of the same geometry (constants must then be uniform); the twin's own unless given.
        """
        scene, body = self.scene, self.scene.body
        constants = {name: getattr(body, name) for name in ("youngs_modulus", "poisson_ratio", "density")}
        clamp = self.clamp
        if mesh is None:
            mesh = self.mesh
        else:
            constants = {name: _uniform(name, value) for name, value in constants.items()}
            clamp = _clamp_on(self.capture, mesh)
        held = {} if clamp is None or scene.pins is None else {"pins": None, "node_pins": clamp.node_pins()}
        return in_world(
            Scene,
            ElasticBody(mesh, law=body.law, flow=body.flow, **constants),
            scene,
            initial_positions=body.space.shape_values(mesh.vertices) @ scene.start,
            initial_orientation=(0.0, 0.0, 0.0),  # those positions are rotated already
            contact_stiffness=scene.contact().stiffness,
            **held,
        )


def smooth_weights(mesh: TetMesh, count: int, clamp: Clamp | None) -> NodalWeights:
    """Skinning weights of a body without known motion: eigenmodes, or vibration modes if it is held.

    A clamped body with few free nodes has fewer of them.
    """
    body = ElasticBody(mesh)
    if clamp is None:
        return eigenmode_weights(body, count)
    held = clamp.held
    return elastic_weights(body, min(count, max(1, int((~held).sum()) // _NODES_PER_WEIGHT)), clamped=held)


def _uniform(name: str, value: np.ndarray) -> float:
    if np.ptp(value) > 1e-9 * abs(value).max():
        raise InputError(f"full_scene: {name} differs from cell to cell; expected a uniform body on another mesh")
    return float(value[0])


def _shown_surface(capture: Capture) -> _Surface | None:
    """Vertices [m] and triangles of `mesh.*`."""
    mesh = capture.mesh()
    return None if mesh is None else (np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))


def surface_of_capture(capture: Capture) -> _Surface | None:
    """Vertices [V, 3] m and triangles [F, 3] of a capture's rest geometry: the boundary of its tetrahedra, or `mesh.*`.

    None if it has neither.
    """
    tets = capture.tets()
    return _shown_surface(capture) if tets is None else tets.surface


def mesh_of_capture(capture: Capture, *, max_nodes: int = 700, fill: bool = False) -> TetMesh:
    """Quadratic tetrahedra of a capture's rest geometry, of about `max_nodes` nodes at most.

    Tetrahedra of `tets.npz` are used if they are few enough. Else their boundary (or `mesh.*`) is meshed
    (`mesh_of_few_nodes`) and, if requested, filled as far as possible.

    Raises:
        InputError: the capture has no rest geometry, or none that encloses a volume.
    """
    tets = capture.tets()
    if tets is not None:
        quadratic = to_quadratic(tets)
        if len(quadratic.vertices) <= max_nodes:
            return quadratic
    pair = surface_of_capture(capture)
    if pair is None:
        raise InputError(
            f"{capture.folder}: no rest geometry; expected tets.npz (vertices, tets) or mesh.obj, .ply or .glb of the "
            "closed surface where it is at t = 0, or inference.with_rest_geometry, which finds it in pictures of "
            "several cameras. Points alone do not tell what body carries them"
        )
    mesh = mesh_of_few_nodes(*pair, max_nodes=max_nodes)
    return filled(mesh, *pair) if fill else mesh


def _follows(mesh: TetMesh, capture: Capture) -> bool:
    """Whether a mesh has most of its volume in common with the closed surface of a capture, if there is one."""
    surface = None if capture.tets() is not None else _shown_surface(capture)
    return surface is None or enclosed_volume(*surface) is None or shape_mismatch(mesh, *surface) < _LOST


@lru_cache(maxsize=2)  # one refinement asks three times
def coarse_mesh(capture: Capture, mesh: TetMesh, *, max_nodes: int = 200) -> TetMesh:
    """A quadratic mesh of a capture with fewer nodes than the given one.

    The given one if it is small already, or if it is a poor approximation of the body, as a coarser one is worse.
    """
    if len(mesh.vertices) <= 1.5 * max_nodes or not _follows(mesh, capture):
        return mesh
    try:
        coarse = mesh_of_capture(capture, max_nodes=max_nodes, fill=mesh.filling is not None)
    except ConvergenceError:  # the shape needs more nodes
        return mesh
    return coarse if len(coarse.vertices) < len(mesh.vertices) else mesh


def _clamp_on(capture: Capture, mesh: TetMesh) -> Clamp | None:
    """The nodes of a mesh that a capture holds: its boundary indexes its tetrahedra, else its surface, else `mesh`."""
    boundary = capture.boundary()
    if boundary is None:
        return None
    tets = capture.tets()
    surface = None if tets is not None else _shown_surface(capture)
    vertices, cells = surface or ((tets or mesh).vertices, (tets or mesh).corner_tets)
    return clamp_of(boundary, mesh, reference=vertices, cells=cells, fps=capture.fps)


def base_twin(capture: Capture, options: TwinOptions | None = None, *, mesh: TetMesh | None = None) -> Twin:
    """The model stated by a capture: geometry, density, gravity, floor and friction, initial motion, boundary.

    A floor of unknown friction is frictionless.

    Args:
        capture: the capture; initial motion that it does not state is zero.
        options: discretisation.
        mesh: quadratic rest mesh, instead of the capture's own.

    Raises:
        InputError: no rest geometry, or a boundary that does not fit it.
    """
    options = options or TwinOptions()
    if mesh is None:
        mesh = mesh_of_capture(capture, max_nodes=options.max_nodes, fill=options.fill)
    mesh = to_quadratic(mesh)
    clamp = _clamp_on(capture, mesh)
    weights = smooth_weights(mesh, options.weights, clamp)
    body = ReducedBody(
        ReducedSpace(weights, BodySamples.of_mesh(mesh), interpolated=clamp is not None),
        law=options.law,
        youngs_modulus=options.youngs_modulus,
        poisson_ratio=options.poisson_ratio,
        density=capture.density,
    )
    scene = ReducedScene(
        body,
        obstacles=_obstacles(capture),
        gravity=tuple(float(g) for g in capture.gravity),
        pins=None if clamp is None else clamp.springs(),
        initial_velocity=_vector(capture.initial_velocity),
        initial_angular_velocity=_vector(capture.initial_angular_velocity),
    )
    steps = options.steps_per_frame or max(4, int(np.ceil(RATE / capture.fps)))
    return Twin(capture, mesh, scene, clamp, steps)


def _vector(value: np.ndarray | None) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if value is None else (float(value[0]), float(value[1]), float(value[2]))


def _obstacles(capture: Capture) -> tuple[Plane, ...]:
    floor = capture.floor
    if floor is None:
        return ()
    return (Plane(point=_vector(floor.point), normal=_vector(floor.normal), friction=floor.friction or 0.0),)


def enriched(twin: Twin, nodes: Float[np.ndarray, "T V 3"]) -> Twin:
    """The twin with the same number of weights, the roughest half replaced by ones from a motion of the full model.

    They come from proper orthogonal decomposition (`physconvex.reduced.snapshot_weights`).

    Args:
        twin: with M weights.
        nodes: positions of its mesh's nodes [m]; if their motion has a lower rank, it gives fewer weights.
    """
    weights = twin.scene.body.space.field.count
    body = ElasticBody(twin.mesh)
    for count in range((weights + 1) // 2, 0, -1):
        try:
            found = snapshot_weights(body, [nodes - twin.mesh.vertices], count)
        except InputError:  # the motion has fewer independent fields
            continue
        if count == weights:
            return with_weights(twin, found)
        kept = smooth_weights(twin.mesh, weights - count, twin.clamp)
        return with_weights(twin, NodalWeights(twin.mesh, np.hstack([kept.nodal_values, found.nodal_values])))
    return twin


def with_weights(twin: Twin, weights: WeightField) -> Twin:
    """The twin with other skinning weights, starting at rest; everything else stays."""
    interpolated = twin.clamp is not None and isinstance(weights, NodalWeights)  # as `base_twin` does
    body = twin.scene.body
    return with_body(twin, body.with_space(ReducedSpace(weights, body.space.samples, interpolated=interpolated)))


def with_body(twin: Twin, body: ReducedBody) -> Twin:
    """The twin with another reduced body, starting at rest where it was; everything else stays."""
    old = twin.scene.body
    position = old.first_moments @ twin.scene.start / old.total_mass
    expected = old.first_moments @ old.rest / old.total_mass
    moved = twin.with_scene(body=body, initial_coordinates=None)
    if np.abs(position - expected).max() < 1e-12:
        return moved
    rest = body.first_moments @ moved.scene.start / body.total_mass
    return moved.with_values([f"initial_position_{axis}" for axis in "xyz"], rest + position - expected)
