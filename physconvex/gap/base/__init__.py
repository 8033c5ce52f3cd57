"""The base model at its best: what is compared, what is free, how residuals count, what runs cost."""
