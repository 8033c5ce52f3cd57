"""Training on falls that are simulated at once on a GPU and drawn anew at every step."""
