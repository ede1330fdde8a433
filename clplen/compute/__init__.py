"""What touches OpenCL: host arrays and kernel names come in; arrays on a device leave."""
