"""Reduced-order simulator: a body moved by M skinning weights, φ(X) = X + Σ_m W_m(X) Z_m [X; 1]."""

from physconvex.contact import Plane, Sphere
from physconvex.elastic_terms import with_fibres, with_strain_stiffening
from physconvex.inelastic import Plasticine, Sand, StandardLinearSolid
from physconvex.reduced.adjoint import LossGradient, simulate_with_adjoint
from physconvex.reduced.autograd import rollout_of_weights, rollout_positions
from physconvex.reduced.basis import (
    CallableWeights,
    NodalWeights,
    SkinningBasis,
    WeightField,
    eigenmode_weights,
    sample_basis,
)
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.candidates import Candidates, CandidateTrajectories, simulate_candidates
from physconvex.reduced.contact_modes import contact_weights
from physconvex.reduced.cubature import BodySamples, Cubature, tet_cubature
from physconvex.reduced.elastic_weights import elastic_weights
from physconvex.reduced.given_fields import ArrayWeights, StackedWeights, predicted_weights, snapshot_weights
from physconvex.reduced.loads import even_loads, held_nodes, touched_loads
from physconvex.reduced.neural_field import (
    NeuralFieldOptions,
    NeuralWeights,
    train_neural_weights,
    untrained_neural_weights,
)
from physconvex.reduced.optimised_cubature import optimised_cubature
from physconvex.reduced.parameters import PARAMETERS, parameter_values, with_parameters
from physconvex.reduced.pins import Pins
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.scene_weights import with_elastic_weights
from physconvex.reduced.sensitivity import SensitiveTrajectory, simulate_with_sensitivities
from physconvex.reduced.shell import Shell
from physconvex.reduced.simulation import ReducedTrajectory, simulate
from physconvex.reduced.space import ReducedSpace
from physconvex.reduced.world import ReducedWorld
from physconvex.reduced.world_simulation import WorldTrajectory, simulate_world
from physconvex.wind import Wind

__all__ = [
    "PARAMETERS",
    "ArrayWeights",
    "BodySamples",
    "CallableWeights",
    "CandidateTrajectories",
    "Candidates",
    "Cubature",
    "LossGradient",
    "NeuralFieldOptions",
    "NeuralWeights",
    "NodalWeights",
    "Pins",
    "Plane",
    "Plasticine",
    "ReducedBody",
    "ReducedScene",
    "ReducedSpace",
    "ReducedTrajectory",
    "ReducedWorld",
    "Sand",
    "SensitiveTrajectory",
    "Shell",
    "SkinningBasis",
    "Sphere",
    "StackedWeights",
    "StandardLinearSolid",
    "WeightField",
    "Wind",
    "WorldTrajectory",
    "contact_weights",
    "eigenmode_weights",
    "elastic_weights",
    "even_loads",
    "held_nodes",
    "optimised_cubature",
    "parameter_values",
    "predicted_weights",
    "rollout_of_weights",
    "rollout_positions",
    "sample_basis",
    "simulate",
    "simulate_candidates",
    "simulate_with_adjoint",
    "simulate_with_sensitivities",
    "simulate_world",
    "snapshot_weights",
    "tet_cubature",
    "touched_loads",
    "train_neural_weights",
    "untrained_neural_weights",
    "with_elastic_weights",
    "with_fibres",
    "with_parameters",
    "with_strain_stiffening",
]
