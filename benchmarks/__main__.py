"""Run a benchmark, or measure published claims again.

\b
    python -m benchmarks --help                      # names of the benchmarks
    python -m benchmarks peers/stack --quick
    python -m benchmarks check refocus.stack gpu     # claims by name or group, or all

`claims.toml` lists every published figure with the command that measures it. `check` runs the
commands of the claims and ends with 1 where a figure is farther from the published one than its
tolerance, or where a test fails.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import click

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "tests")]

from benchmarks.claims import Claim, claims  # noqa: E402 - after the path that leads there

FOLDERS = ("accuracy", "speed", "peers", "gpu")
MAIN = re.compile(r"^(main = |def main\()", re.M)


class Scripts(click.Group):
    """The modules of the folders that have a `main`, by "folder/name"."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        files = [file for folder in FOLDERS for file in sorted((HERE / folder).glob("*.py"))]
        return [f"{f.parent.name}/{f.stem}" for f in files if MAIN.search(f.read_text())]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_text("check " + " ".join(self.list_commands(ctx)))

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in self.list_commands(ctx):
            return super().get_command(ctx, name)
        module = importlib.import_module(f"benchmarks.{name.replace('/', '.')}")
        module.main.help = module.__doc__
        return module.main


@click.group(cls=Scripts, help=__doc__)
def main() -> None:
    pass


def measured(claim: Claim, output: str, status: int) -> tuple[bool, str]:
    """Whether a claim holds, and the words that say so, from what its command printed."""
    if claim.test:
        return status == 0, "its test passed" if status == 0 else "its test failed"
    if not claim.find:
        return status == 0, f"published {claim.figures}; compare with\n{output[-2000:]}"
    numbers = claim.numbers_in(output)
    if not numbers:
        return False, "the output holds no figure"
    holds = claim.agrees_with(numbers)
    return holds, f"published {claim.figures}, now {', '.join(f'{n:g}' for n in numbers)}"


@main.command()
@click.argument("names", nargs=-1)
def check(names: tuple[str, ...]) -> None:
    """Measure claims again, by name or group; all of them without a name."""
    chosen = [c for c in claims() if not names or c.name in names or c.group in names]
    unknown = set(names) - {c.name for c in chosen} - {c.group for c in chosen}
    if unknown:
        raise click.UsageError(f"No claim or group has the name {', '.join(sorted(unknown))}.")
    failed = 0
    for words in dict.fromkeys(tuple(c.words) for c in chosen):
        call = [sys.executable if words[0] == "python" else words[0], *words[1:]]
        done = subprocess.run(call, cwd=HERE.parent, capture_output=True, text=True, check=False)
        for claim in (c for c in chosen if tuple(c.words) == words):
            holds, words_of = measured(claim, done.stdout, done.returncode)
            failed += not holds
            state = "DIFFERS" if not holds else "holds" if claim.test or claim.find else "printed"
            click.echo(f"{claim.name}: {state}: {words_of}")
            if not holds:
                click.echo(f"    {' '.join(words)}\n" + (done.stdout + done.stderr)[-2000:])
    sys.exit(bool(failed))


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
