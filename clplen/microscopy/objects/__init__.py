"""Objects in volumes: points, regions, tracks and brightness over time."""
