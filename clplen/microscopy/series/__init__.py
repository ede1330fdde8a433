"""Series of frames: volumes in batches, initial volumes, rolling background."""
