from .adam import RowAdam as RowAdam
from .carving import footprint as footprint, visual_hull as visual_hull
from .config import (
    ReconstructionConfig as ReconstructionConfig,
    load_reconstruction_config as load_reconstruction_config,
)
from .field_fit import FitState as FitState, Progress as Progress, begin as begin, fit as fit, image_loss as image_loss
from .field_refinement import Refinement as Refinement, hidden as hidden, refine as refine, simplify as simplify
from .filling import fill_gaps as fill_gaps
from .observation import Observation as Observation, observe as observe
from .scores import ViewScore as ViewScore, score as score
from .similarity import psnr as psnr, structural_similarity as structural_similarity
from .start import Start as Start, body_surface as body_surface, start_field as start_field, start_kind as start_kind
from .state import load_state as load_state, save_state as save_state
from .triangles import even_triangles as even_triangles, welded as welded
