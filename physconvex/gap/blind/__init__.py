"""Blind tests of the diagnosis: captures with sealed labels, answers, score."""

from physconvex.gap.blind.bank import diagnose_bank, generate_bank
from physconvex.gap.blind.scoring import BankScore, score_bank

__all__ = ["BankScore", "diagnose_bank", "generate_bank", "score_bank"]
