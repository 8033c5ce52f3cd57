"""Read and write videos; each kind of bad file has its own error."""
