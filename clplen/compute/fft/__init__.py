"""Fourier transforms and what is built of them: maps and factors come in, transformed arrays leave."""
