"""Partially coherent light: light and a system come in, a mean intensity and its error go out."""
