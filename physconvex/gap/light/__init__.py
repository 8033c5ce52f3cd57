"""Effects that show in the light of a video, not in the motion."""
