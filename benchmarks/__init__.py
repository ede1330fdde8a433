"""Measurements beside other programs, of accuracy beyond what tests assert, and on GPUs."""
