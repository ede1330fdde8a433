"""Python runs this file at its start when its folder is on PYTHONPATH (see tests/forcing.py)."""

from __future__ import annotations

import os

import pyopencl as cl
from forcing import VARIABLE, force_name

from clplen.compute.drivers import pocl
from clplen.compute.drivers.environment import expose_intel_runtime

expose_intel_runtime()
for platform in cl.get_platforms():
    if platform.name == pocl.PLATFORM:
        for device in filter(pocl.written_name, platform.get_devices()):
            force_name(device, os.environ[VARIABLE])
