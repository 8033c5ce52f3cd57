from .clamping import Clamp as Clamp, HeldRegion as HeldRegion, clamp_of as clamp_of
from .colours import (
    ColourObservations as ColourObservations,
    blurred as blurred,
    colour_seeds as colour_seeds,
    seen_by as seen_by,
)
from .convexes import Basis as Basis, convex_twin as convex_twin, skinning_weights as skinning_weights
from .correction import (
    FULL_OPTIONS as FULL_OPTIONS,
    Correction as Correction,
    FullRun as FullRun,
    correct as correct,
    fit_full as fit_full,
    parameter_shift as parameter_shift,
    parameter_shifts as parameter_shifts,
)
from .free_parameters import (
    default_parameters as default_parameters,
    marker_observations as marker_observations,
    start_motion as start_motion,
    with_free_friction as with_free_friction,
)
from .image_loss import (
    moved_points as moved_points,
    of_visible as of_visible,
    simulation_loss as simulation_loss,
    with_few_samples as with_few_samples,
)
from .levenberg_marquardt import Fit as Fit, FitOptions as FitOptions, Iteration as Iteration, fit as fit
from .model import FullModel as FullModel, ReducedModel as ReducedModel, roll_out_together as roll_out_together
from .model_error import (
    LEFT_BY_FITTED as LEFT_BY_FITTED,
    FinerFit as FinerFit,
    WeightedObservations as WeightedObservations,
    extrapolated_nodes as extrapolated_nodes,
    fit_finer as fit_finer,
    frame_errors as frame_errors,
)
from .nuisance import MarginalObservations as MarginalObservations, Nuisance as Nuisance
from .observations import (
    MarkerObservations as MarkerObservations,
    Observations as Observations,
    PixelObservations as PixelObservations,
    StackedObservations as StackedObservations,
    WrappedObservations as WrappedObservations,
    camera_jacobian as camera_jacobian,
    misfit_of as misfit_of,
)
from .outlines import OutlineObservations as OutlineObservations
from .parameter_scan import Candidate as Candidate, scan as scan, scan_values as scan_values
from .parameters import (
    Parameter as Parameter,
    default_parameter as default_parameter,
    lower_bounds as lower_bounds,
    step_scales as step_scales,
    upper_bounds as upper_bounds,
)
from .photometric import PhotometricObservations as PhotometricObservations, background_of as background_of
from .point_models import (
    CorrectedModel as CorrectedModel,
    LinearModel as LinearModel,
    PointModel as PointModel,
    SecantModel as SecantModel,
)
from .rigid_drift import (
    RigidDriftObservations as RigidDriftObservations,
    first_contact as first_contact,
    likely_drift as likely_drift,
    model_drift as model_drift,
)
from .roll_outs import RollOut as RollOut, RollOuts as RollOuts
from .twin import (
    Twin as Twin,
    TwinOptions as TwinOptions,
    base_twin as base_twin,
    coarse_mesh as coarse_mesh,
    enriched as enriched,
    mesh_of_capture as mesh_of_capture,
    surface_of_capture as surface_of_capture,
    with_weights as with_weights,
)
from .uncertainty import (
    Identifiability as Identifiability,
    NullDirection as NullDirection,
    clustered_deviations as clustered_deviations,
    identifiability as identifiability,
    marginal_deviations as marginal_deviations,
    noise_covariance as noise_covariance,
)
from .video_tracks import (
    FollowOptions as FollowOptions,
    appearance_map as appearance_map,
    follow as follow,
    follow_from_model as follow_from_model,
    seed_points as seed_points,
)
from .visible_points import cast_camera_rays as cast_camera_rays, shaded as shaded, unit_normals as unit_normals
from .weight_fit import (
    WeightFit as WeightFit,
    WeightFitOptions as WeightFitOptions,
    fit_in_turns as fit_in_turns,
    fit_weights as fit_weights,
)
