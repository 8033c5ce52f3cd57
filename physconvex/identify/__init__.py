"""Identification: a capture's base twin, what was seen, the unknowns, the search, the correction, the uncertainty."""

from physconvex.identify.clamping import Clamp, clamp_of
from physconvex.identify.correction import CorrectedModel, Correction, FullRun, correct, parameter_shift
from physconvex.identify.held_region import HeldRegion
from physconvex.identify.levenberg_marquardt import Fit, FitOptions, Iteration, fit
from physconvex.identify.model import FullModel, Model, ReducedModel
from physconvex.identify.observations import (
    MarkerObservations,
    Observations,
    PixelObservations,
    StackedObservations,
    camera_jacobian,
)
from physconvex.identify.parameters import Parameter, default_parameter
from physconvex.identify.scan import Candidate, scan, scan_values
from physconvex.identify.setup import default_parameters, marker_observations
from physconvex.identify.twin import Twin, TwinOptions, base_twin, mesh_of_capture
from physconvex.identify.uncertainty import Identifiability, NullDirection, identifiability, noise_covariance
from physconvex.identify.weighting import WeightedObservations, frame_errors

__all__ = [
    "Candidate",
    "Clamp",
    "CorrectedModel",
    "Correction",
    "Fit",
    "FitOptions",
    "FullModel",
    "FullRun",
    "HeldRegion",
    "Identifiability",
    "Iteration",
    "MarkerObservations",
    "Model",
    "NullDirection",
    "Observations",
    "Parameter",
    "PixelObservations",
    "ReducedModel",
    "StackedObservations",
    "Twin",
    "TwinOptions",
    "WeightedObservations",
    "base_twin",
    "camera_jacobian",
    "clamp_of",
    "correct",
    "default_parameter",
    "default_parameters",
    "fit",
    "frame_errors",
    "identifiability",
    "marker_observations",
    "mesh_of_capture",
    "noise_covariance",
    "parameter_shift",
    "scan",
    "scan_values",
]
