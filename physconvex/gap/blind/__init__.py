"""Blind tests of the diagnosis: captures with sealed labels, answers, score."""

from physconvex.gap.blind.answers import diagnose_bank
from physconvex.gap.blind.bank import generate_bank
from physconvex.gap.blind.oracle import run_oracle
from physconvex.gap.blind.plan import Shares
from physconvex.gap.blind.scoring import Bank, BankScore, score_banks

__all__ = ["Bank", "BankScore", "Shares", "diagnose_bank", "generate_bank", "run_oracle", "score_banks"]
