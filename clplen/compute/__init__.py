"""Devices, memory, kernel launches and Fourier transforms through OpenCL."""
