"""Fourier transforms of complex arrays, and linear maps composed of them."""
