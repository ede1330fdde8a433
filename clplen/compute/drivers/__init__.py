"""What OpenCL drivers need to start: a selector comes in; devices and built programs leave."""
