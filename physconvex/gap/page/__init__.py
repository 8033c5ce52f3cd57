"""The result as JSON, as a page with pictures, and as an improved twin."""
