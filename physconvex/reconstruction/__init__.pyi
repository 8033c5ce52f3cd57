from .carving import footprint as footprint
from .config import (
    ReconstructionConfig as ReconstructionConfig,
    load_reconstruction_config as load_reconstruction_config,
)
from .depth_fusion import closed_surface as closed_surface
from .field_fit import (
    FitProgress as FitProgress,
    FitState as FitState,
    begin as begin,
    fit_field as fit_field,
    image_loss as image_loss,
    load_fit as load_fit,
    save_fit as save_fit,
)
from .field_refinement import (
    RefinedField as RefinedField,
    hidden as hidden,
    refine_field as refine_field,
    simplify as simplify,
)
from .gap_filling import fill_gaps as fill_gaps
from .hollow import Hollow as Hollow, find_hollow as find_hollow
from .hull_surface import level_surface as level_surface, visual_hull as visual_hull
from .observation import Observation as Observation, observation_of as observation_of
from .row_adam import RowAdam as RowAdam
from .scores import (
    ViewScore as ViewScore,
    psnr as psnr,
    score_views as score_views,
    structural_similarity as structural_similarity,
)
from .start import Start as Start, body_surface as body_surface, start_field as start_field, start_kind as start_kind
from .surface_errors import SurfaceError as SurfaceError, surface_error as surface_error
from .texture import textured as textured
from .triangles import even_triangles as even_triangles, welded as welded
from .view_checks import disagreement as disagreement, missing_sides as missing_sides
