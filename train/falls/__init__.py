"""Training on falls that are simulated at once on a GPU and drawn anew at every step."""

from train.falls.pretrain import Pretraining, pretrain
from train.falls.run import train_on_falls
from train.falls.world import Falls, simulate_falls

__all__ = ["Falls", "Pretraining", "pretrain", "simulate_falls", "train_on_falls"]
