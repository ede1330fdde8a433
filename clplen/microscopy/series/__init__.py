"""Series of frames: volumes in batches, what they begin with, their background."""
