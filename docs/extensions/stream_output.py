"""Printed output of tutorials, joined without breaks inside words.

IPython sends the output of ``%%sh`` in pieces of 100 characters; myst-nb ends each with a newline.
"""

from __future__ import annotations

from typing import Any

from myst_nb.core import render
from sphinx.application import Sphinx

import clplen


def join_streams(outputs: list[Any]) -> list[Any]:
    """Return the outputs of a cell with the pieces of each stream joined at its first piece."""
    joined: list[Any] = []
    streams: dict[str, Any] = {}
    for output in outputs:
        if output["output_type"] != "stream":
            joined.append(output)
        elif output["name"] in streams:
            streams[output["name"]]["text"] += output["text"]
        else:
            streams[output["name"]] = output
            joined.append(output)
    return joined


def open_device(app: Sphinx) -> None:
    """Open a device before tutorials do, so that none of them reports the first use of a driver."""
    if app.config.nb_execution_mode != "off":
        clplen.Device.open()


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", open_device)
    render.coalesce_streams = join_streams
    return {"parallel_read_safe": True, "parallel_write_safe": True}
