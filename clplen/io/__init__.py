"""Files in and out: folders of views, HDF5, focal stacks, depth maps and pictures."""

from __future__ import annotations

from clplen.files import check_folder, check_writable, output_folder
from clplen.io.formats.pfm import read_pfm, write_pfm
from clplen.io.formats.picture import read_picture, write_picture
from clplen.io.formats.ply import points_of, write_ply
from clplen.io.lightfields.lightfield_files import (
    files_of,
    open_lightfield,
    read_lightfield,
    write_lightfield,
)
from clplen.io.lightfields.mosaic import write_mosaic
from clplen.io.lightfields.view_folders import write_views
from clplen.io.raw.raw_files import is_raw_file, read_raw, write_raw
from clplen.io.raw.raytrix import read_raytrix, write_raytrix
from clplen.io.results.disparity_maps import read_disparity, read_masks, read_truth, write_truth
from clplen.io.results.focused_files import write_focused, write_focused_depth
from clplen.io.results.hci import HciParameters, read_parameters
from clplen.io.results.stack_files import write_depth, write_image, write_stack

__all__ = [
    "HciParameters",
    "check_folder",
    "check_writable",
    "files_of",
    "is_raw_file",
    "open_lightfield",
    "output_folder",
    "points_of",
    "read_disparity",
    "read_lightfield",
    "read_masks",
    "read_parameters",
    "read_pfm",
    "read_picture",
    "read_raw",
    "read_raytrix",
    "read_truth",
    "write_depth",
    "write_focused",
    "write_focused_depth",
    "write_image",
    "write_lightfield",
    "write_mosaic",
    "write_pfm",
    "write_picture",
    "write_ply",
    "write_raw",
    "write_raytrix",
    "write_stack",
    "write_truth",
    "write_views",
]
