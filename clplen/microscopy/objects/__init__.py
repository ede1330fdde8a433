"""What volumes hold: points, regions, their tracks and their brightness in time."""
