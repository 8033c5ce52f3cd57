"""Identification: a capture's base twin, what was seen, the unknowns, the search, the correction, the uncertainty."""

from physconvex.identify.clamping import Clamp, clamp_of
from physconvex.identify.correction import (
    CorrectedModel,
    Correction,
    FullRun,
    correct,
    parameter_shift,
    parameter_shifts,
)
from physconvex.identify.drift import DriftingObservations, first_contact, likely_drift, model_drift
from physconvex.identify.finer import FinerFit, extrapolated_nodes, fit_finer
from physconvex.identify.full_fit import fit_full
from physconvex.identify.held_region import HeldRegion
from physconvex.identify.levenberg_marquardt import Fit, FitOptions, Iteration, fit
from physconvex.identify.model import FullModel, LinearModel, Model, ReducedModel, roll_out_together
from physconvex.identify.nuisance import Nuisance
from physconvex.identify.observations import (
    MarkerObservations,
    Observations,
    PixelObservations,
    StackedObservations,
    camera_jacobian,
)
from physconvex.identify.parameters import Parameter, default_parameter
from physconvex.identify.roll_outs import RollOuts
from physconvex.identify.scan import Candidate, scan, scan_values
from physconvex.identify.setup import default_parameters, marker_observations
from physconvex.identify.twin import Twin, TwinOptions, base_twin, mesh_of_capture
from physconvex.identify.uncertainty import (
    Identifiability,
    NullDirection,
    clustered_deviations,
    identifiability,
    marginal_deviations,
    noise_covariance,
)
from physconvex.identify.weighting import WeightedObservations, frame_errors

__all__ = [
    "Candidate",
    "Clamp",
    "CorrectedModel",
    "Correction",
    "DriftingObservations",
    "FinerFit",
    "Fit",
    "FitOptions",
    "FullModel",
    "FullRun",
    "HeldRegion",
    "Identifiability",
    "Iteration",
    "LinearModel",
    "MarkerObservations",
    "Model",
    "Nuisance",
    "NullDirection",
    "Observations",
    "Parameter",
    "PixelObservations",
    "ReducedModel",
    "RollOuts",
    "StackedObservations",
    "Twin",
    "TwinOptions",
    "WeightedObservations",
    "base_twin",
    "camera_jacobian",
    "clamp_of",
    "clustered_deviations",
    "correct",
    "default_parameter",
    "default_parameters",
    "extrapolated_nodes",
    "first_contact",
    "fit",
    "fit_finer",
    "fit_full",
    "frame_errors",
    "identifiability",
    "likely_drift",
    "marginal_deviations",
    "marker_observations",
    "mesh_of_capture",
    "model_drift",
    "noise_covariance",
    "parameter_shift",
    "parameter_shifts",
    "roll_out_together",
    "scan",
    "scan_values",
]
