"""Reduced-order simulator: a body moved by M skinning weights, φ(X) = X + Σ_m W_m(X) Z_m [X; 1]."""

from physconvex.contact import Plane, Sphere
from physconvex.reduced.basis import (
    CallableWeights,
    NodalWeights,
    SkinningBasis,
    WeightField,
    eigenmode_weights,
    sample_basis,
)
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.cubature import BodySamples, Cubature, tet_cubature
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.simulation import ReducedTrajectory, simulate
from physconvex.reduced.space import ReducedSpace

__all__ = [
    "BodySamples",
    "CallableWeights",
    "Cubature",
    "NodalWeights",
    "Plane",
    "ReducedBody",
    "ReducedScene",
    "ReducedSpace",
    "ReducedTrajectory",
    "SkinningBasis",
    "Sphere",
    "WeightField",
    "eigenmode_weights",
    "sample_basis",
    "simulate",
    "tet_cubature",
]
