"""Fourier transforms and linear maps made of them: complex arrays come in, and leave."""
