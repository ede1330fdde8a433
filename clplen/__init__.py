"""Light fields by wave optics on any OpenCL device.

This module holds the most used names. All others are in topics:

wave          fields, propagation, optical elements, systems of them, coherence
lightfield    calibrate, decode, views, refocus, focal stacks, depth
cameras       scenes and plenoptic cameras
microscopy    point images, projector, deconvolution of the light-field microscope
analysis      resolution of cameras, comparison of cameras
io            reading and writing files
plot          figures
batch         many light fields: jobs, their items, workers
torch, jax    operators with gradients for PyTorch and JAX, if installed

Names and topics are imported on first use; the stub ``__init__.pyi`` lists them.
"""

from lazy_loader import attach_stub

from clplen import interrupts  # noqa: F401 (first: Ctrl-C while the rest is imported)

__version__ = "0.1.0"
TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")
BRIDGES = ("jax", "torch")  # topics that need another library
__getattr__, __dir__, _names = attach_stub(__name__, __file__)
__all__ = [name for name in _names if name not in TOPICS + BRIDGES]
