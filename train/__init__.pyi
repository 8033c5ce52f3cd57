from .blind.answers import diagnose_bank as diagnose_bank
from .blind.metrics import area_under_roc as area_under_roc
from .blind.oracle import run_oracle as run_oracle
from .blind.scoring import Bank as Bank, BankScore as BankScore, score_banks as score_banks
from .cache import prepare_clips as prepare_clips
from .config import TrainConfig as TrainConfig, load_train_config as load_train_config
from .data import TrainingClips as TrainingClips
from .falls.batches import FallBatch as FallBatch, RealClips as RealClips
from .falls.pretrain import pretrain as pretrain
from .falls.run import train_on_falls as train_on_falls
from .falls.world import Falls as Falls, simulate_falls as simulate_falls
from .finder_loop import overlap_of_frames as overlap_of_frames
from .loop import train_predictor as train_predictor
from .losses import smoothed_target as smoothed_target
from .motion_states import flipped_states as flipped_states
from .options import PaperOptions as PaperOptions, Pretraining as Pretraining
from .paper.evaluation import evaluate_paper as evaluate_paper
from .reconstruction_coverage import Coverage as Coverage, measure_coverage as measure_coverage
from .records import (
    LabelledClip as LabelledClip,
    Split as Split,
    dataset_checksum as dataset_checksum,
    read_clips as read_clips,
)
from .validation import constant_mae as constant_mae
