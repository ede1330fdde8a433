"""``clplen info``."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.microscopy import fourier
from clplen.cli.microscopy.microscope import describe_microscope
from clplen.cli.shared import options
from clplen.cli.shared.console import capture_messages, check_outputs, read
from clplen.cli.shared.light_field_rows import Rows, as_options, order_rows, sample_rows

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.raw.lenslet_lattice import Lattice

_MAPS = (".pfm", ".npy", ".tif", ".tiff")
_VOLUMES = (".tif", ".tiff", ".zarr")


def pupil_words(terms: dict[str, float] | None) -> str:
    """Return the Zernike terms of a pupil, in nanometres, as text."""
    if not terms:
        return "no aberrations"
    return ", ".join(f"{j}: {c * 1e9:.4g} nm" for j, c in terms.items()) + " (Noll's index)"


def read_map_if_any(source: Path) -> np.ndarray[Any, Any] | None:
    """Read a disparity map; return None if the file is something else."""
    from clplen.errors import FormatError
    from clplen.io import read_disparity

    if source.suffix.lower() not in _MAPS:
        return None
    try:
        return read_disparity(source)
    except FormatError:
        if source.suffix.lower() == ".pfm":
            raise
        return None


def map_info(source: Path, values: np.ndarray[Any, Any]) -> tuple[Rows, dict[str, Any]]:
    """Return the rows and data of a disparity map."""
    valid = values[np.isfinite(values)]
    low, median, high = (
        (float(valid.min()), float(np.median(valid)), float(valid.max()))
        if valid.size
        else (math.nan,) * 3
    )
    unknown = values.size - valid.size
    rows = [
        ("File", f"{source}, a disparity map"),
        ("Size", f"{values.shape[0]} x {values.shape[1]} pixels (y, x)"),
        ("Range", f"{low:.6g} to {high:.6g}, median {median:.6g}"),
        ("Invalid", f"{unknown} of {values.size} pixels (NaN or infinite)"),
    ]
    data = {"shape": values.shape, "low": low, "median": median, "high": high}
    return rows, {"file": source, "kind": "a disparity map", **data, "unknown": unknown}


def read_volume_if_any(source: Path) -> tuple[Any, dict[str, Any]] | None:
    """Read a volume or open a series, with its description; return None for other files."""
    from clplen.io.results.stored_volumes import open_volumes
    from clplen.io.results.volume_files import is_volume, read_volume
    from clplen.io.store.picture_series import describe_series

    if source.suffix.lower() not in _VOLUMES or not is_volume(source):
        return None
    about = describe_series(source)
    if "records" in about:
        return open_volumes(source), about
    return read_volume(source)


def volume_info(source: Path, values: Any, about: dict[str, Any]) -> tuple[Rows, dict[str, Any]]:
    """Return the rows and data of a volume, or of a series, of a light-field microscope."""
    is_series = len(values.shape) == 4
    kind = f"{'a series of volumes' if is_series else 'a volume'} of a light-field microscope"
    planes = about["planes_um"]
    records = about["records"] if is_series and isinstance(about["records"], list) else []
    steps = {round(step, 6) for step in np.diff(planes)}
    extents = [(part.sum(dtype=np.float64), float(part.max()))
               for part in (values if is_series else [values])]  # fmt: skip
    total, high = sum(light for light, _ in extents), max(top for _, top in extents)
    rows = [
        ("File", f"{source}, {kind}"),
        ("Size", f"{' x '.join(map(str, values.shape))} voxels ({'t, ' * is_series}z, y, x)"),
        ("Planes", f"z from {planes[0]:g} to {planes[-1]:g} um"
         + (f" every {steps.pop():g} um" if len(steps) == 1 else "")),
        ("Light", f"{total:.6g} in all, up to {high:.6g} in a voxel"),
    ]  # fmt: skip
    if "voxel_um" in about:
        rows.insert(3, ("Voxels", "{:g} x {:g} um (y, x)".format(*about["voxel_um"])))
    if about.get("residuals"):
        rows.append(
            ("Residual", f"{about['residuals'][-1]:.3g} after {len(about['residuals'])} iterations")
        )
    residuals = [record.get("residual") for record in records if isinstance(record, dict)]
    if residuals := [value for value in residuals if isinstance(value, float)]:
        rows.append(("Residual", f"{min(residuals):.3g} to {max(residuals):.3g}"))
    degenerate = about.get("degenerate_um")
    if degenerate:
        ends = f"z from {min(degenerate):g} to {max(degenerate):g} um"
        rows.append(("Degenerate", f"{ends}: details finer than a lenslet are not resolved"))
    if "place" in about:
        y, x = about["place"]["first"]
        rows.append(("Origin", f"voxel (0, 0) lies at (y, x) = ({y:g}, {x:g}) px of the raw frame"))
    rows += [("Note", text) for text in about.get("remarks", [])]
    data = {"file": source, "kind": kind, "shape": values.shape, "light": total, "high": high}
    return rows, data | about | {"shape": values.shape}


_HDF5 = (".h5", ".hdf5")
_MAX_COLUMNS = 100  # width of the text beside the labels
_FOCUSED = "focused camera (plenoptic 2.0): see 'clplen render', 'stack' and 'depth'"
_AXIS_WORDS = ("swap_uv", "flip_v", "flip_u")


@click.command(cls=options.Command)
@options.source
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@options.file("--save-grid", help="Output file of the lenslet lattice, for the option --grid.")
@click.option(
    "--save-pictures",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Output folder for the pictures and maps in a processed Lytro file.",
)
@click.option(
    "--farthest",
    type=click.FloatRange(0, 8, min_open=True),
    default=2.0,
    show_default=True,
    help="Largest absolute disparity of the first search for the order of the views.",
)
@options.layout
@options.device
def info(
    source: Path,
    as_json: bool,
    save_grid: Path | None,
    save_pictures: Path | None,
    farthest: float,
    selector: str | None,
    **layout: Any,
) -> None:
    """Describe a file, and check the order of its views.

    Light fields: size, type and range of the samples, dark views, and the sharpness of the focal
    stack in each of the eight orders of the view axes, with the options that correct a wrong order.
    Raw images: lenslet lattice, and the camera if the file stores it. Disparity maps: size and
    range. Volumes of microscopes: planes, voxels, residual and remarks. Results of focused cameras:
    size and m. Camera or microscope files (TOML): derived quantities. Point images of a microscope:
    their parameters. Processed Lytro files: their sections.

    \b
    Example:
      clplen info flower --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen info raw.tif --white flat.tif --save-grid grid.json
      clplen info truth.pfm --json
      clplen info IMG_0001-stk.lfp --save-pictures pictures
    """
    from clplen.io.raw.lytro_container import processed_contents
    from clplen.io.raw.raw_files import is_raw_file
    from clplen.io.results.focused_files import describe_focused

    if save_grid is not None:
        check_outputs(source, layout, save_grid)
    settings = {name for name, value in layout.items() if value not in (None, False)} - {"force"}
    focused = None if settings or save_grid else describe_focused(source)
    contents = processed_contents(source)
    if save_pictures is not None and contents is None:
        raise click.UsageError(
            f"--save-pictures applies to processed Lytro files, which {source} is not: use 'clplen "
            "render' to make pictures of a light field."
        )
    plain = not settings and not save_grid and focused is None
    volume = read_volume_if_any(source) if plain else None
    values = read_map_if_any(source) if plain and volume is None else None
    if contents is not None:
        rows, data = _processed_info(source, contents, save_pictures, layout["force"])
    elif focused is not None:
        rows, data = _focused_info(source, *focused)
    elif volume is not None:
        rows, data = volume_info(source, *volume)
    elif values is not None:
        rows, data = map_info(source, values)
    elif source.suffix.lower() == ".toml":
        rows, data = _camera_file_info(source, selector)
    elif (images := fourier.point_images(source)) is not None:
        rows, data = fourier.info_of_point_images(source, *images)
    elif (images := _point_images(source)) is not None:
        rows, data = _point_image_info(source, *images)
    elif source.suffix.lower() == ".xml":
        rows, data = _calibration_info(source)
    elif is_raw_file(source):
        rows, data = _raw_info(source, selector)
    else:
        rows, data = _light_field_info(source, selector, layout, farthest, save_grid)
    if as_json:
        click.echo(json.dumps(_plain(data), indent=2))
        return
    width = 2 + max(len(label) for label, _ in rows)
    for label, text in rows:
        lines = textwrap.wrap(text, _MAX_COLUMNS, break_long_words=False, break_on_hyphens=False)
        fits = len(text) <= _MAX_COLUMNS or "  " in text.strip()  # a line of a table
        for number, line in enumerate([text] if fits else lines):
            click.echo(f"{'' if number else label:<{width}}{line}".rstrip())


def _processed_info(
    source: Path, contents: list[tuple[str, int]], folder: Path | None, force: bool
) -> tuple[Rows, dict[str, Any]]:
    from clplen.io.raw.lytro_pictures import save_lytro_pictures

    kind = "a processed Lytro picture, without a raw image"
    rows = [("File", f"{source}, {kind}")]
    rows += [("" if n else "Sections", f"{title}: {size:,} bytes") for n, (title, size) in
             enumerate(contents)]  # fmt: skip
    saved = [] if folder is None else save_lytro_pictures(source, folder, force=force)
    if saved:
        rows.append(("Saved", ", ".join(map(str, saved))))
    else:
        rows.append(("Pictures", "--save-pictures FOLDER saves them"))
    sections = [{"title": title, "bytes": size} for title, size in contents]
    return rows, {"file": source, "kind": kind, "sections": sections, "saved": saved}


def _focused_info(source: Path, kind: str, about: dict[str, Any]) -> tuple[Rows, dict[str, Any]]:
    size = " x ".join(map(str, about["shape"]))
    rows = [("File", f"{source}, {kind}"), ("Size", f"{size} samples")]
    if "lenslets" in about:
        rows.append(("Lenslets", " x ".join(map(str, about["lenslets"]))))
    if "m" in about:
        rows.append(("m = b/a", ", ".join(f"{m:.6g}" for m in about["m"])))
    return rows, {"file": source, "kind": kind, **about}


def _camera_file_info(source: Path, selector: str | None) -> tuple[Rows, dict[str, Any]]:
    """Return the quantities derived from a camera or microscope file."""
    from clplen.compute.device import Device
    from clplen.config.camera_file import read_camera_file
    from clplen.config.kinds import FOURIER, kind_of
    from clplen.config.microscope import read_microscope_file
    from clplen.config.tables import read_toml

    content = read_toml(source, f"file {source}")
    kind = kind_of({"camera": {"kind": "microscope"}} | content)
    if kind == FOURIER:
        return fourier.info_of_parameters(source, Device.open(selector))
    if kind == "microscope":
        file = read_microscope_file(source)
        camera, defaults = file.camera, file.assumptions
        kind = "parameters of a light-field microscope"
        counts = {"slices": file.slices, "um_per_slice": file.um_per_slice, "voxels": file.voxels}
        counts |= {"pixels_per_lenslet": file.pixels, "binning": file.binning}
    else:
        camera, defaults, kind = read_camera_file(source).camera, (), "parameters of a camera"
        counts = {}
    built = camera.build(Device.open(selector))
    is_microscope = camera.kind == "microscope"
    description = describe_microscope(built) if is_microscope else built.describe()
    rows = [("File", f"{source}, {kind}"), ("Camera", description.title)]
    rows += [("", line) for line in str(description).splitlines()[1:]]
    rows += [(name.replace("_", " ").capitalize(), f"{value:g}") for name, value in counts.items()
             if value is not None]  # fmt: skip
    if (counts.get("binning") or 1) > 1:
        rows.append(("", "samples of a pixel along each axis; pixels of the camera are samples"))
    rows += [("Not given", sentence) for sentence in defaults]
    lengths = {row.name: row.value for row in description.rows}
    return rows, {"file": source, "kind": kind, "camera": lengths, **counts, "taken": defaults}


def _point_images(source: Path) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """Read the parameters and shapes of point images; return None for other files."""
    from clplen.microscopy.model import point_image_files

    return point_image_files.read_parameters(source) if source.suffix.lower() in _HDF5 else None


def _point_image_info(
    source: Path, parameters: dict[str, Any], shapes: list[tuple[int, ...]]
) -> tuple[Rows, dict[str, Any]]:
    from clplen.microscopy.model.cells import cell_in

    kind = "point images of a light-field microscope"
    binning = parameters["binning"]
    n, v = parameters["pixels_per_lenslet"], parameters["voxels_per_lenslet"]
    cell = cell_in(parameters, v, n)
    (ny, nx), (vy, vx), (down, across) = cell.pixels, cell.voxels, cell.lenslets
    unit_cell = "a lenslet" if down * across == 1 else f"a cell of {down} x {across} lenslets"
    reaches = ", ".join(str(shape[2] // nx) for shape in shapes)
    side = parameters["lenslet_pitch"] / (parameters["magnification"] * v)
    size = sum(map(math.prod, shapes)) * np.dtype(parameters["store"]).itemsize
    planes = ", ".join(f"{z * 1e6:g}" for z in parameters["planes"])
    of = (
        "the cover glass of its design"
        if parameters["cover"] is None
        else f"cover glass {parameters['cover']}"
    )
    rows = [
        ("File", f"{source}, {kind}"),
        ("Objective", f"{parameters['magnification']:g}x/{parameters['na']:g}, {of}"),
        ("Medium", f"index {parameters['medium_index']:g}, {parameters['wavelength'] * 1e9:g} nm, "
            f"apodisation {parameters['apodisation']:g}"),
        ("Pupil", pupil_words(parameters.get("pupil"))),
        ("Lenslets", f"pitch {parameters['lenslet_pitch'] * 1e6:g} um, focal length "
            f"{parameters['lenslet_focal_length'] * 1e6:g} um, fill {parameters['lenslet_fill']}"),
        ("Pixels", f"{ny} x {nx} {unit_cell}, of {binning} x {binning} parts"),
        ("Voxels", f"{vy} x {vx} {unit_cell}, {side * 1e6:.4g} um apart"),
        ("Planes", f"{len(shapes)}, z = {planes} um; farther from the objective positive"),
        ("Images", f"of {reaches} {unit_cell.split()[1]}s across"),
        ("Memory", f"{size:,} bytes, {parameters['store']}; {parameters['cut']:g} of light cut"),
    ]  # fmt: skip
    return rows, {"file": source, "kind": kind, **parameters, "shapes": shapes}


def _calibration_info(source: Path) -> tuple[Rows, dict[str, Any]]:
    from clplen.io import read_raytrix

    calibration = read_raytrix(source)
    data = {"file": source, "kind": "a Raytrix calibration", **asdict(calibration)}
    rows = [(name.replace("_", " ").capitalize(), str(value)) for name, value in data.items()]
    picture = _picture_beside(source)
    if picture is not None:
        path, shape = picture
        count = len(calibration.lattice(shape).centres())
        text = f"{path}, {shape[0]} x {shape[1]} pixels, {count} lenslets, of a {_FOCUSED}"
        rows.append(("Raw image", text))
        data["raw_image"] = {"file": path, "shape": shape, "lenslets": count}
    return rows, data


def _picture_beside(source: Path) -> tuple[Path, tuple[int, int]] | None:
    """Return the path and shape of the raw image of a calibration; None if it is missing."""
    from clplen.errors import FormatError
    from clplen.io.raw.raw_files import picture_of, read_frame

    try:
        path = picture_of(source)
    except FormatError:
        return None
    ny, nx = read_frame(path)[0].shape[:2]
    return path, (int(ny), int(nx))


def _raw_info(source: Path, selector: str | None) -> tuple[Rows, dict[str, Any]]:
    from clplen.compute.device import Device
    from clplen.io import read_raw

    raw = read_raw(source, device=Device.open(selector))
    camera: Any = raw.camera
    description = camera.describe()
    kind = f"a raw image of a {_FOCUSED}" if camera.kind == "focused" else "a raw image"
    values = raw.to_numpy()
    low, high = float(np.min(values)), float(np.max(values))
    ny, nx = raw.shape
    rows = [
        ("File", f"{source}, {kind}"),
        ("Size", f"{ny} x {nx} pixels of {1e6 * raw.pixel_pitch:g} um"),
        ("Samples", f"{values.dtype}, {low:g} to {high:g}"),
        ("Camera", description.title),
    ]
    rows += [("", line) for line in str(description).splitlines()[1:]]
    for number, lens_type in enumerate(raw.lens_types):
        near, far = lens_type.depth_range
        rows.append((f"Lens type {number}", f"virtual depth 1/m from {near:.4g} to {far:.4g}"))
    data = {"file": source, "kind": kind, "shape": raw.shape, "low": low, "high": high}
    lengths = {row.name: row.value for row in description.rows}
    return rows, data | {"camera": lengths, "lens_types": raw.lens_types}


def _light_field_info(
    source: Path,
    selector: str | None,
    layout: dict[str, Any],
    farthest: float,
    save_grid: Path | None,
) -> tuple[Rows, dict[str, Any]]:
    from clplen.io.lightfields.lightfield_files import kind_of
    from clplen.lightfield.axis_check.lightfield_report import (
        check_light_field,
        combine_layout_words,
    )

    kind = kind_of(source).name
    with capture_messages() as messages:
        lf = read(source, selector, layout)
    report = check_light_field(lf, farthest=farthest)
    summary = messages[-1].removeprefix("read ")
    data: dict[str, Any] = {"file": source, "kind": kind, "read": summary}
    rows = [("File", f"{source}, {kind}"), ("Read", summary)]
    rows += [("Note", text) for text in messages[:-1]]
    rows += sample_rows(report)
    data |= asdict(report)
    lattice = _lattice(lf, source, layout)
    if save_grid is not None:
        if lattice is None:
            raise click.UsageError("--save-grid applies to raw images of lenslet cameras only.")
        lattice.save(save_grid)
    if lattice is not None:
        rows += _lattice_rows(lattice)
        data["lattice"] = asdict(lattice)
    parameters = _parameters(source)
    if parameters:
        rows += [("Parameters", ", ".join(f"{name} {text}" for name, text in parameters.items()))]
        data["parameters"] = parameters
    read_with = tuple(word for word in _AXIS_WORDS if layout[word])

    def flags(layout_words: tuple[str, ...]) -> str:
        return as_options(combine_layout_words(read_with, layout_words)) or "no option"

    data["sentence"] = report.sentence(flags)
    for order, entry in zip(report.orders, data["orders"], strict=True):
        entry["words"] = as_options(combine_layout_words(read_with, order.keywords)).split()
    return rows + order_rows(report, read_with, data["sentence"]), data


def _lattice(lf: LightField, source: Path, layout: dict[str, Any]) -> Lattice | None:
    """Return the lattice of a raw image; read it again if reordering the views dropped it."""
    from clplen.io import read_raw

    if lf.raw is not None:
        return lf.raw.lattice
    files = {name: layout[name] for name in ("white", "dark", "grid") if layout[name] is not None}
    force = layout["force"]
    return read_raw(source, device=lf.device, force=force, **files).lattice if files else None


def _lattice_rows(lattice: Lattice) -> Rows:
    along, across = lattice.pitch
    return [
        ("Lenslets", f"{lattice.kind}, pitch {along:.4f} px along rows, {across:.4f} px across"),
        ("Rotation", f"{math.degrees(lattice.rotation):+.4f} degrees (+x towards +y)"),
        ("Centre", f"(y, x) = ({lattice.origin[0]:.3f}, {lattice.origin[1]:.3f}) px"),
        ("Residual", f"{lattice.residual:.4f} px rms, trust {lattice.trust}"),
        ("Lattice", lattice.verdict),
    ]


def _parameters(source: Path) -> dict[str, Any]:
    """Read the parameters of an HCI scene; empty if the folder has none."""
    from clplen.io import read_parameters

    if not (source.is_dir() and (source / "parameters.cfg").is_file()):
        return {}
    values = asdict(read_parameters(source))
    return {name: value for name, value in values.items() if value is not None}


def _plain(value: Any) -> Any:
    """Convert a value for JSON; NaN and infinity become None."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, dict):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
