"""Training on falls that are simulated together on a GPU and rendered again at every step."""
