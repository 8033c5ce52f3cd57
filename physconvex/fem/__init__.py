"""Full-order finite elements: the physical truth that the rest of physconvex is measured against."""

from physconvex.contact import Plane, Sphere
from physconvex.fem.body import ElasticBody
from physconvex.fem.carried_contact import CarriedContact, SurfacePoints
from physconvex.fem.embedding import Embedding, sample_interior
from physconvex.fem.filling import filled
from physconvex.fem.hanging import HangingLoad
from physconvex.fem.implicit_meshing import tetrahedralize_implicit
from physconvex.fem.loads import surface_load
from physconvex.fem.mesh import TetMesh, box_mesh, refine, to_quadratic
from physconvex.fem.meshing import tetrahedralize
from physconvex.fem.modes import (
    elastic_responses,
    skinning_eigenmodes,
    skinning_responses,
    skinning_stiffness,
    tangent_stiffness,
    vibration_modes,
)
from physconvex.fem.quality import mesh_quality
from physconvex.fem.scene import Pins, Scene
from physconvex.fem.sensitivity import SensitiveTrajectory, simulate_with_sensitivities
from physconvex.fem.simulation import Trajectory, simulate, solve_static
from physconvex.stepping import SolveStatistics

__all__ = [
    "CarriedContact",
    "ElasticBody",
    "Embedding",
    "HangingLoad",
    "Pins",
    "Plane",
    "Scene",
    "SensitiveTrajectory",
    "SolveStatistics",
    "Sphere",
    "SurfacePoints",
    "TetMesh",
    "Trajectory",
    "box_mesh",
    "elastic_responses",
    "filled",
    "mesh_quality",
    "refine",
    "sample_interior",
    "simulate",
    "simulate_with_sensitivities",
    "skinning_eigenmodes",
    "skinning_responses",
    "skinning_stiffness",
    "solve_static",
    "surface_load",
    "tangent_stiffness",
    "tetrahedralize",
    "tetrahedralize_implicit",
    "to_quadratic",
    "vibration_modes",
]
