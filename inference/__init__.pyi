from .batch import BatchSummary as BatchSummary, predict_batch as predict_batch
from .loading import load_clip as load_clip
from .masks import find_masks as find_masks
from .pictures import ClipPictures as ClipPictures, frame_strip as frame_strip, weight_maps as weight_maps
from .prediction import Prediction as Prediction
from .predictor import predict as predict
from .preparation import ready_source as ready_source, to_prediction as to_prediction
from .reconstruction import Reconstruction as Reconstruction, reconstruct as reconstruct
from .reconstruction_views import CaptureViews as CaptureViews, capture_views as capture_views
from .refinement.motion import RefinedMotion as RefinedMotion
from .refinement.observations import observe_capture as observe_capture
from .refinement.options import RefineOptions as RefineOptions
from .refinement.pipeline import refine as refine
from .refinement.result import (
    FittedParameter as FittedParameter,
    Refinement as Refinement,
    interval_of as interval_of,
)
from .refinement.result_files import write_refinement as write_refinement
from .refinement.stages import RefinementRun as RefinementRun, Stages as Stages
from .rest_geometry import with_rest_geometry as with_rest_geometry
from .results import ResultsFolder as ResultsFolder
from .settings import ReconstructOptions as ReconstructOptions, StatedConditions as StatedConditions
from .sources import ClipSource as ClipSource, find_sources as find_sources
from .streaming import ClipResult as ClipResult, iter_predictions as iter_predictions
from .units import format_pascals as format_pascals, format_pascals_range as format_pascals_range
