"""Test the diagnosis blindly: captures with sealed labels, answers, scores."""
