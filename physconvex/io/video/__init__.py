"""Read and write videos; one error per way in which a file can be bad."""
