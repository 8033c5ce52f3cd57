"""The simulators as models of a fit: positions of material points as a function of the parameters."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import ContactSolver, Timing, simulate, simulate_with_sensitivities
from physconvex.errors import ConvergenceError
from physconvex.fem import Scene, SceneFamily, SurfacePoints
from physconvex.identify.parameters import default_parameter, lower_bounds, step_scales, upper_bounds
from physconvex.identify.point_models import Positions, Tangents, Values
from physconvex.identify.roll_outs import RollOut, RollOuts
from physconvex.identify.twin import Twin
from physconvex.mesh import Embedding, TetMesh
from physconvex.reduced import NamedParameters

_DIFFERENCE = 1e-6  # of a typical step: half width of the central differences of gradients
# of a typical step, of whole roll-outs; iterated friction makes them rough at smaller scales
_WHOLE_DIFFERENCE: dict[ContactSolver, float] = {"condensed": 1e-2, "passes": 0.1}
_TOLERANCE = 1e-6  # of Newton's last step, over the size: a thousandth of the motion of such a difference


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """The reduced simulator as a model.

    Attributes:
        twin: body and world.
        names: the parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T, the first at t = 0.
        timing: of the roll-outs, except for the number of frames; the twin's own unless given.
    """

    twin: Twin
    names: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    timing: Timing | None = None

    @cached_property
    def _shapes(self) -> np.ndarray:
        return self.twin.scene.body.space.shape_values(self.points)

    @property
    def _timing(self) -> Timing:
        return replace(self.timing or self.twin.timing(), frames=self.frames)

    def positions(self, values: Values) -> Positions:
        """Positions of the points at the frames [m]."""
        run = simulate(self.twin.with_values(self.names, values).scene, self._timing)
        return self._shapes @ run.coordinates

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Positions and their derivatives, by the implicit function theorem (`simulate_with_sensitivities`)."""
        scene = self.twin.with_values(self.names, values).scene
        run = simulate_with_sensitivities(NamedParameters(scene, self.names), self._timing)
        return self._shapes @ run.trajectory.coordinates, self._shapes @ run.coordinate_tangents


@dataclass(frozen=True, eq=False)
class FullModel:
    """The full-order finite elements as a model.

    Attributes:
        twin: body and world.
        names: the parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T.
        mesh: another mesh of the same geometry; the twin's own unless given.
        refinement: factor on the number of time steps.
        surface: points at which obstacles act, instead of the boundary's nodes.
        memory: of the last roll-outs; several models may share it.
        held: parameters that keep their values; derivatives by differences are zero by them.
    """

    twin: Twin
    names: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    mesh: TetMesh | None = None
    refinement: int = 1
    surface: SurfacePoints | None = None
    memory: RollOuts = field(default_factory=RollOuts)
    held: tuple[str, ...] = ()

    @property
    def rolled_mesh(self) -> TetMesh:
        """The mesh of the simulation."""
        return self.twin.mesh if self.mesh is None else self.mesh

    @cached_property
    def _embedding(self) -> Embedding:
        return Embedding.of_points(self.rolled_mesh, self.points)

    @property
    def differenced(self) -> bool:
        """Whether derivatives are differences of whole roll-outs, at one more roll-out for each parameter."""
        return bool(self.twin.scene.obstacles)

    def node_positions(self, values: Values) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes of the mesh at the frames [m]."""
        return self.memory.positions(self.key(values), lambda: self.roll_out(values))

    def scene(self, values: Values) -> Scene:
        """The scene with the parameters set."""
        scene = self.twin.with_values(self.names, values).full_scene(self.mesh)
        return scene if self.surface is None else replace(scene, contact_points=self.surface)

    @property
    def _solver(self) -> ContactSolver:
        """Contact and friction are solved together. With contact damping they are iterated, which is less accurate."""
        scene = self.twin.scene
        damped = scene.contact_damping > 0 or "contact_damping" in self.names
        return "condensed" if scene.obstacles and not damped else "passes"

    def roll_out(self, values: Values) -> RollOut:
        """The case to be simulated."""
        return RollOut(self.scene(values), replace(self._timing(), contact_solver=self._solver))

    def _timing(self) -> Timing:
        timing = self.twin.timing(self.frames)
        steps, tolerance = timing.steps_per_frame * self.refinement, _TOLERANCE if self.differenced else None
        return replace(timing, steps_per_frame=steps, tolerance=tolerance)

    def key(self, values: Values) -> Hashable:
        """Key of a roll-out in the memory."""
        how = (self.rolled_mesh, self.refinement, self.frames, self.surface)
        return (self.twin, self.names, *how, np.asarray(values, dtype=np.float64).tobytes())

    def positions(self, values: Values) -> Positions:
        """Positions of the points at the frames [m]."""
        return self._embedding.apply(self.node_positions(values))

    def begun(self, values: Values) -> Positions:
        """Positions at the start of a search, with derivatives if both together are cheap."""
        return self.positions(values) if self.differenced else self.linearise(values)[0]

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Positions and their derivatives.

        Without obstacles the derivatives are those of the step equations
        (`physconvex.dynamics.simulate_with_sensitivities`). With obstacles they are differences of whole roll-outs over
        a hundredth of a typical step (a tenth with contact damping), over which condensed contact is linear. P + 1 such
        roll-outs cost about as much as one with derivatives, which needs iterated friction.
        """
        key = (self.key(values), self.held)
        known = self.memory.tangents(key)
        if known is None:
            known = self._differences(values) if self.differenced else self._sensitivities(values)
            self.memory.keep_tangents(key, known)
        return self.positions(values), self._embedding.apply(known)

    def _usual(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Typical steps and bounds."""
        usual = [default_parameter(name) for name in self.names]
        return step_scales(usual), lower_bounds(usual), upper_bounds(usual)

    def _sensitivities(self, values: np.ndarray) -> np.ndarray:
        steps, lower, upper = self._usual()
        family = SceneFamily(
            scene_of=self.scene, values=values, steps=_DIFFERENCE * steps, lower=lower, upper=upper, names=self.names
        )
        found = simulate_with_sensitivities(family, self._timing())
        self.memory.keep(self.key(values), found.trajectory.positions)
        return found.coordinate_tangents

    def beside(self, values: Values) -> list[Values]:
        """Values of the roll-outs for the differences: upwards unless a bound prevents it."""
        steps, _, upper = self._usual()
        free = [name not in self.held for name in self.names]
        changes = np.diag(_WHOLE_DIFFERENCE[self._solver] * steps)[free]
        return [values + c if (values + c <= upper).all() else values - c for c in changes]

    def _differences(self, values: np.ndarray) -> np.ndarray:
        moved = self.beside(values)
        free = [place for place, name in enumerate(self.names) if name not in self.held]
        roll_out_together([(self, values)], beside=[(self, values)])
        base, lower = self.node_positions(values), self._usual()[1]
        tangents = np.zeros((len(base), len(values), *base.shape[1:]))
        for place, trial in zip(free, moved, strict=True):
            try:
                there = self.node_positions(trial)
            except ConvergenceError:
                trial = 2 * values - trial
                if trial[place] < lower[place]:
                    raise
                there = self.node_positions(trial)
            tangents[:, place] = (there - base) / (trial - values)[place]
        return tangents


_Wanted = tuple[FullModel, Values]


def roll_out_together(wanted: Iterable[_Wanted], *, beside: Iterable[_Wanted] = ()) -> None:
    """Run the roll-outs that are needed next; the models share a memory. A failure is raised when its result is used.

    Args:
        wanted: models and values.
        beside: models whose differenced derivatives are needed too; their roll-outs guide those of the differences.
    """
    wanted, near = list(wanted), dict[Hashable, Hashable]()
    for model, values in beside:
        if model.differenced:
            wanted += [(model, values), *((model, moved) for moved in model.beside(values))]
            near |= {model.key(moved): model.key(values) for moved in model.beside(values)}
    if wanted:
        jobs = {model.key(values): partial(model.roll_out, values) for model, values in wanted}
        wanted[0][0].memory.prepare(jobs, near)
