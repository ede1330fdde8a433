"""Light fields by wave optics, on any OpenCL device: the names of a first week.

Everything else is public one step down, by topic:

wave          fields, propagation, optical elements, systems of them, coherence
lightfield    calibrate, decode, views, refocus, focal stacks, depth
cameras       scenes and plenoptic cameras: where the two towers meet
microscopy    point images, projector, deconvolution of the light-field microscope
analysis      what a camera resolves; cameras compared
io            files in and out
plot          figures
batch         many light fields: jobs, their items, workers
torch, jax    operators with gradients in programs of PyTorch and JAX, where these are installed

Names and topics are imported when they are asked for; the stub beside this file lists them.
"""

from lazy_loader import attach_stub

from clplen import interrupts  # noqa: F401 (first: Ctrl-C while the rest is imported)

__version__ = "0.1.0"
TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")
BRIDGES = ("jax", "torch")  # topics that need another library
__getattr__, __dir__, _names = attach_stub(__name__, __file__)
__all__ = [name for name in _names if name not in TOPICS + BRIDGES]
