"""What makes an OpenCL driver start and compile: a selector comes in, pyopencl devices and programs leave."""
