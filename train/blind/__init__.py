"""Blind tests of the diagnosis: captures with sealed labels, answers, score."""
