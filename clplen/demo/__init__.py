"""Experiments of ``clplen demo``: things of light at three depths, and the thesis' three points."""

from clplen.demo.three_points import (
    DEPTHS,
    METHODS,
    POINTS,
    REFOCUS_ALPHAS,
    SOURCE_DIAMETER,
    STACK_ALPHAS,
    THESIS_ALPHAS,
    array_position,
    camera,
    estimates,
    expose_point,
    scene,
)

__all__ = [
    "DEPTHS",
    "METHODS",
    "POINTS",
    "REFOCUS_ALPHAS",
    "SOURCE_DIAMETER",
    "STACK_ALPHAS",
    "THESIS_ALPHAS",
    "array_position",
    "camera",
    "estimates",
    "expose_point",
    "scene",
]
