"""Everything that touches OpenCL: devices, memory, launches; numbers and kernels come in, arrays leave."""
