"""OpenCL drivers: device selection, adaptation of PoCL, kernel builds, limits and errors."""
