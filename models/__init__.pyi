from .calibration import (
    Calibration as Calibration,
    DensityCalibration as DensityCalibration,
    fit_density_calibration as fit_density_calibration,
)
from .checkpoint import (
    PredictorConfig as PredictorConfig,
    TrainingRange as TrainingRange,
    load_checkpoint as load_checkpoint,
)
from .checkpoint_files import find_checkpoint as find_checkpoint, save_network as save_network
from .clip import (
    ClipConfig as ClipConfig,
    PreparedClip as PreparedClip,
    freeze_time as freeze_time,
    prepare_clip as prepare_clip,
    shuffle_time as shuffle_time,
    touches_border as touches_border,
)
from .config import (
    BinConfig as BinConfig,
    EncoderConfig as EncoderConfig,
    KinematicsConfig as KinematicsConfig,
    NetworkConfig as NetworkConfig,
)
from .edge_cut import sharp_foreground as sharp_foreground
from .encoder import load_pretrained_encoder as load_pretrained_encoder
from .estimator import (
    ClipEstimate as ClipEstimate,
    PhysicsPredictor as PhysicsPredictor,
    collate_clips as collate_clips,
)
from .foreground import (
    locate_foreground as locate_foreground,
    moving_window as moving_window,
    plain_background_masks as plain_background_masks,
)
from .heads import BinnedDensity as BinnedDensity, DensityHead as DensityHead
from .kinematics import SilhouetteFeatures as SilhouetteFeatures, differences as differences
from .mirror import (
    answer_both_ways as answer_both_ways,
    mirrored_moments as mirrored_moments,
)
from .motion import STATE_NAMES as STATE_NAMES, STATE_SCALE as STATE_SCALE, MotionBranch as MotionBranch
from .network import ClipBatch as ClipBatch, NetworkOutput as NetworkOutput, PhysicsNetwork as PhysicsNetwork
from .outline import (
    OutlineConfig as OutlineConfig,
    OutlineNetwork as OutlineNetwork,
    load_outline as load_outline,
    outline_input as outline_input,
    refined_coverage as refined_coverage,
)
from .scaling import (
    dimensionless_interval as dimensionless_interval,
    log10_dimensionless_stiffness as log10_dimensionless_stiffness,
)
from .segmenter import (
    SegmenterConfig as SegmenterConfig,
    SilhouetteSegmenter as SilhouetteSegmenter,
    block_pixels as block_pixels,
    clip_references as clip_references,
    load_segmenter as load_segmenter,
    object_coverage as object_coverage,
    pad_pictures as pad_pictures,
)
from .silhouette import MOMENT_NAMES as MOMENT_NAMES, silhouette_moments as silhouette_moments
from .skinning_energy import (
    captured_energy as captured_energy,
    captured_energy_loss as captured_energy_loss,
    random_basis as random_basis,
    span_loss as span_loss,
)
from .stabilisation import stabilise as stabilise
from .windows import GREY as GREY
