"""What a recording was made with that its file does not state: floors that give way, its own elements, much damping."""
