"""What the light of a video tells, apart from the motion."""
