"""Camera files: TOML text comes in; cameras, scenes, light and sensors in SI units leave."""

from clplen.config.camera_file import CameraFile, read_camera_file
from clplen.config.example import EXAMPLE
from clplen.config.scene import CoherenceTable

__all__ = ["EXAMPLE", "CameraFile", "CoherenceTable", "read_camera_file"]
