"""Measures of optical quality: fields, pictures, cameras and results come in; numbers leave.

Rooms from the ground up: ``point``, ``cameras``, ``report``; ``quality`` needs none of them.
"""
