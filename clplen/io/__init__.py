"""Files in and out: light fields, raw images, focal stacks, depth maps, volumes and pictures.

Rooms, each of which may import those before it: `formats` < `store` < `raw` < `lightfields` <
`results`. Paths come in and data leave, or the other way round.
"""

from clplen.files import check_folder, check_writable, clear_temporaries, output_folder
from clplen.io.formats.animation import write_animation
from clplen.io.formats.npy import read_npy, write_npy
from clplen.io.formats.pfm import read_pfm, write_pfm
from clplen.io.formats.picture import read_picture, write_picture
from clplen.io.formats.ply import points_of, read_ply, write_ply
from clplen.io.lightfields.lightfield_files import (
    files_of,
    open_lightfield,
    read_lightfield,
    write_lightfield,
)
from clplen.io.lightfields.mosaic import write_mosaic
from clplen.io.lightfields.view_folders import write_views
from clplen.io.raw.raw_files import is_raw_file, read_frame, read_lattice, read_raw, write_raw
from clplen.io.raw.raytrix import (
    Distortion,
    FocusType,
    RaytrixCalibration,
    read_raytrix,
    write_raytrix,
)
from clplen.io.results.disparity_maps import (
    read_disparity,
    read_masks,
    read_scene_truth,
    read_truth,
    write_truth,
)
from clplen.io.results.focused_files import write_focused, write_focused_depth
from clplen.io.results.hci import HciParameters, read_parameters, write_parameters
from clplen.io.results.stack_files import (
    read_depth,
    read_image,
    read_stack,
    write_depth,
    write_image,
    write_stack,
)
from clplen.io.results.volume_files import is_volume, read_volume, write_volume
from clplen.io.store.digest import digest, size_of
from clplen.io.store.picture_blocks import Tiles

__all__ = [
    "Distortion",
    "FocusType",
    "HciParameters",
    "RaytrixCalibration",
    "Tiles",
    "check_folder",
    "check_writable",
    "clear_temporaries",
    "digest",
    "files_of",
    "is_raw_file",
    "is_volume",
    "open_lightfield",
    "output_folder",
    "points_of",
    "read_depth",
    "read_disparity",
    "read_frame",
    "read_image",
    "read_lattice",
    "read_lightfield",
    "read_masks",
    "read_npy",
    "read_parameters",
    "read_pfm",
    "read_picture",
    "read_ply",
    "read_raw",
    "read_raytrix",
    "read_scene_truth",
    "read_stack",
    "read_truth",
    "read_volume",
    "size_of",
    "write_animation",
    "write_depth",
    "write_focused",
    "write_focused_depth",
    "write_image",
    "write_lightfield",
    "write_mosaic",
    "write_npy",
    "write_parameters",
    "write_pfm",
    "write_picture",
    "write_ply",
    "write_raw",
    "write_raytrix",
    "write_stack",
    "write_truth",
    "write_views",
    "write_volume",
]
