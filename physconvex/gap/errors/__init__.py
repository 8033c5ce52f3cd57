"""What residuals may be off by without any effect: noise, numerical error; and scores beside that."""
