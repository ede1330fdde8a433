"""Time against work, from a saved run of the benchmark of growth.

clplen bench growth --json > growth.json
python benchmarks/draw_growth.py growth.json docs/growth.png
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import click
import matplotlib.pyplot as plt
import numpy as np

from clplen.bench import saved

NAMES = {
    "rows": "rows of the views (9 x 9 x n x 640, 32 planes)",
    "views": "views (n x 256 x 640, 32 planes)",
    "planes": "planes (9 x 9 x 512 x 512)",
    "samples a side": r"$N^2 \log_2 2N$, a propagation padded to 2N",
    "fields of a batch": "fields of 1024 x 1024 in a batch, padded",
}


@click.command(help=__doc__)
@click.argument("run", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("figure", type=click.Path(dir_okay=False, path_type=Path))
def main(run: Path, figure: Path) -> None:
    found = saved.read(run)
    (report,) = (one for one in found["reports"] if one["name"] == "growth")
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in report["rows"]:
        name = row["name"].rsplit(" ", 1)[0]
        series[name].append((row["rate"] * row["seconds"], row["seconds"]))
    _, axes = plt.subplots(figsize=(7, 4.6), layout="constrained")
    for name, pairs in series.items():
        work, seconds = np.array(pairs).T
        slope = np.polyfit(np.log(work), np.log(seconds), 1)[0]
        axes.loglog(work / work[0], 1e3 * seconds, "o-", label=f"{NAMES[name]}: {slope:.2f}")
    low, high = axes.get_ylim()
    for start in 10.0 ** np.arange(np.floor(np.log10(low)), np.log10(high)):
        axes.loglog([1, 256], [start, 256 * start], color="0.85", lw=0.8, zorder=0)
    axes.set_ylim(low, high)
    axes.set_xlabel("work, of the smallest")
    axes.set_ylabel("time (ms)")
    axes.legend(title="exponent of the time in the work", fontsize=8, title_fontsize=8)
    place = found["environment"]
    axes.set_title(f"{place['device']}, {place['driver']}, {place['cores']} cores", fontsize=9)
    plt.savefig(figure, dpi=110)


if __name__ == "__main__":
    main()
