"""File names of views: patterns, what they say about (v, u), and guesses."""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise

from clplen.errors import FormatError, argument
from clplen.io.formats.untrusted import listed
from clplen.io.lightfields.layout import Layout, View

DEFAULT_PATTERN = "view_{v:02d}_{u:02d}"  # and .png or .tif
_KNOWN = tuple(
    text + suffix
    for text in ("view_{v}_{u}", "input_Cam{i}", "out_{v}_{u}_*")
    for suffix in (".png", ".tif", ".jpg")
)
_FIELD = re.compile(r"\{(\w*)(?::\w*)?\}|(\*)")
_NUMBER = re.compile(r"\d+")
_DIGITS = r"\d{1,18}"  # of an index; time stamps have 17
# What lies beside the views of a data set without being one.
_OTHER = re.compile(
    r"(?<![a-z])(?:gt|masks?|depths?|disp|disparity|objectids?|labels?|normals?|boundaries)"
    r"(?![a-z])",
    re.IGNORECASE,
)
logger = logging.getLogger("clplen.io")

_FEW = 3  # views, too few to tell a counter
_ROW = 2  # digits; a longer constant number is a date or a serial number, no row
_MOST = 10**6  # views


class Pattern:
    """File names with numbers in them."""

    def __init__(self, text: str) -> None:
        matches = list(_FIELD.finditer(text))
        fields = sorted(m.group(1) for m in matches if m.group(1) not in (None, "n"))
        if fields not in (["u", "v"], ["i"]):
            raise ValueError(
                f"The pattern {text!r} must have {{v}} and {{u}} once each, or {{i}} once, besides "
                "any {n} and *; for example 'view_{v}_{u}.png'."
            )
        self.text = text
        self.counts_views = fields == ["i"]
        parts, position = [], 0
        for match in matches:
            parts += [re.escape(text[position : match.start()]), self._group(match)]
            position = match.end()
        self._regex = re.compile("".join(parts) + re.escape(text[position:]))

    @staticmethod
    def _group(match: re.Match[str]) -> str:
        name, anything = match.groups()
        if anything:
            return ".*?"
        return r"\d+" if name == "n" else rf"(?P<{name}>{_DIGITS})"

    def numbers(self, names: Iterable[str]) -> dict[tuple[int, ...], list[str]]:
        """The files of each (v, u) or (i,), as the names give them."""
        found: dict[tuple[int, ...], list[str]] = {}
        for name in names:
            match = self._regex.fullmatch(name)
            if match:
                fields = match.groupdict()
                key = (fields["i"],) if self.counts_views else (fields["v"], fields["u"])
                found.setdefault(tuple(int(k) for k in key), []).append(name)
        return found


def arrange(
    pattern: Pattern,
    names: Iterable[str],
    *,
    views: View | None = None,
    lawnmower: bool = False,
    where: str = "the folder",
) -> tuple[View, dict[View, str]]:
    """Which file is which view, by rank: the first number and the step do not matter."""
    names = list(names)
    _require_one_number(pattern, lawnmower)
    found = pattern.numbers(names)
    if not found:
        raise FormatError(
            f"No file in {where} matches the pattern {pattern.text!r}; there are, for example, "
            f"{listed(sorted(names)[:3]) or 'no files'}."
        )
    twice = [" and ".join(files) for files in found.values() if len(files) > 1]
    if twice:
        raise FormatError(f"Several files in {where} are the same view: {listed(twice)}.")
    axes = [_ranks(sorted({key[axis] for key in found})) for axis in range(len(next(iter(found))))]
    counts = [1 + max(ranks.values()) for ranks in axes]
    ranked = {
        tuple(axes[axis][value] for axis, value in enumerate(key)): files[0]
        for key, files in found.items()
    }
    _require_few(counts, len(ranked), pattern, where)
    if pattern.counts_views:
        shape = _shape_of(counts[0], views, pattern)
        return shape, {
            _place(rank[0], shape[1], lawnmower=lawnmower): file for rank, file in ranked.items()
        }
    shape = (counts[0], counts[1])
    if views is not None and tuple(views) != shape:
        raise FormatError(
            f"The names in {where} give {shape[0]} x {shape[1]} views (V x U, pattern "
            f"{pattern.text!r}), but {argument('views', tuple(views))} was asked for."
        )
    return shape, {(rank[0], rank[1]): file for rank, file in ranked.items()}


def _require_one_number(pattern: Pattern, lawnmower: bool) -> None:
    if lawnmower and not pattern.counts_views:
        raise ValueError(
            f"{argument('order', 'lawnmower')} is for names with one number; the pattern "
            f"{pattern.text!r} has row and column: give a pattern with {{i}}, or leave order out."
        )


def _require_few(counts: Sequence[int], files: int, pattern: Pattern, where: str) -> None:
    if math.prod(counts) > _MOST:
        raise FormatError(
            f"The numbers in the names in {where} (pattern {pattern.text!r}) would give "
            f"{' x '.join(f'{n:,}' for n in counts)} views from {files} files: give a "
            "pattern that matches the views only."
        )


def _place(index: int, columns: int, *, lawnmower: bool) -> View:
    """(v, u) of a view that is counted row by row."""
    v, u = divmod(index, columns)
    return (v, columns - 1 - u) if lawnmower and v % 2 else (v, u)


def views_only(names: Iterable[str], *, pattern: str | None = None) -> list[str]:
    """Names without those that say they are masks, depths or the like, hidden ones neither."""
    shown = [name for name in names if not any(part[:1] == "." for part in name.split("/"))]
    if pattern is not None and _OTHER.search(pattern.rsplit("/", 1)[-1]):
        return shown
    return [name for name in shown if not _OTHER.search(name.rsplit("/", 1)[-1])]


def _ranks(values: Sequence[int]) -> dict[int, int]:
    """Rank of each number in an even progression; a gap in it leaves ranks out."""
    step = math.gcd(*(b - a for a, b in pairwise(values))) or 1
    return {value: (value - values[0]) // step for value in values}


def _shape_of(count: int, views: View | None, pattern: Pattern) -> View:
    """(V, U) of views that are numbered row by row."""
    if views is not None:
        if count > views[0] * views[1]:
            raise FormatError(
                f"The pattern {pattern.text!r} gives {count} views, more than "
                f"{argument('views', tuple(views))}."
            )
        return (views[0], views[1])
    side = math.isqrt(count)
    if side * side != count:
        raise FormatError(
            f"The pattern {pattern.text!r} gives {count} views, which is no square: say how many "
            f"rows and columns with {argument('views', ('V', 'U'))}."
        )
    return (side, side)


def guess(names: Sequence[str], *, where: str = "the folder") -> Pattern:
    """The pattern of a folder's names: a known one, else the most frequent form.

    Two numbers that vary are taken for v and u in this order, also where one of the two is the same
    everywhere and below 100 (one row or column of views). One number alone is i. Pictures of other
    names are left out, and counted in the log.
    """
    pattern = _guessed(names, where)
    left_out = len(names) - sum(len(files) for files in pattern.numbers(names).values())
    if left_out:
        logger.info(
            "%d of %d pictures in %s are left out: they do not fit the pattern %r that was guessed "
            "from the names",
            left_out,
            len(names),
            where,
            pattern.text,
        )
    return pattern


def _guessed(names: Sequence[str], where: str) -> Pattern:
    for text in _KNOWN:
        count = len(Pattern(text).numbers(names))
        if count > 1 or count == len(names) == 1:
            return Pattern(text)
    forms = Counter(_NUMBER.sub("{}", name) for name in names)
    if not forms:
        raise FormatError(
            f"There is no picture in {where}: name the folder of views, or give a pattern, for "
            f"example {argument('pattern', 'view_{v}_{u}.png')}."
        )
    form, count = forms.most_common(1)[0]
    same = [_NUMBER.findall(name) for name in names if _NUMBER.sub("{}", name) == form]
    columns = [sorted(set(column)) for column in zip(*same, strict=True)]
    varying = [index for index, column in enumerate(columns) if len(column) > 1]
    if len(columns) == 2 and len(varying) == 1 and len(columns[1 - varying[0]][0]) <= _ROW:
        varying = [0, 1]
    if not varying or count < 2:
        raise FormatError(
            f"No number varies in the names in {where} ({listed(sorted(names)[:3])}): these are no "
            "views of a light field. Give a raw frame as a file, not its folder; for views give a "
            f"pattern, for example {argument('pattern', 'view_{v}_{u}.png')}."
        )
    fields = dict(zip(varying, ("{v}", "{u}") if len(varying) == 2 else ("{i}",), strict=False))
    counters = [index for index in varying if len(columns[index]) == count]
    one_counts = min(len(columns[index]) for index in varying) > 1 and counters and count > _FEW
    if len(varying) > 2 or (len(varying) == 2 and one_counts):
        raise FormatError(
            f"{len(varying)} numbers vary in the names in {where} ({listed(sorted(names)[:3])}), "
            "which does not tell row and column of the view: "
            + _proposed(form, columns, varying, counters)
        )
    return Pattern(_filled(form, columns, fields))


def _filled(form: str, columns: Sequence[Sequence[str]], fields: dict[int, str]) -> str:
    """A form of names with fields for some of its numbers; the others as they are."""
    values = [fields.get(index, column[0]) for index, column in enumerate(columns)] + [""]
    return "".join(a + b for a, b in zip(form.split("{}"), values, strict=True))


def _proposed(
    form: str, columns: Sequence[Sequence[str]], varying: Sequence[int], counters: Sequence[int]
) -> str:
    """A pattern that may suit: the two numbers with the fewest values are row and column."""
    fields = dict.fromkeys(varying, "{n}")
    if len(varying) == 2:  # one of them differs in every name: it counts the views
        counter = min(counters, key=lambda index: max(map(len, columns[index])))
        fields[counter] = "{i}"
        return (
            f"give a pattern, perhaps {argument('pattern', _filled(form, columns, fields))} ({{i}} "
            "counts views row by row, {n} is ignored)."
        )
    row, column = sorted(sorted(varying, key=lambda index: (len(columns[index]), -index))[:2])
    fields |= {row: "{v}", column: "{u}"}
    return (
        f"give a pattern, perhaps {argument('pattern', _filled(form, columns, fields))}, with "
        "{v} and {u} exchanged if columns come first ({n} is ignored)."
    )


def arranged(
    names: list[str], pictures: list[str], layout: Layout, where: str
) -> tuple[Pattern, View, dict[View, str]]:
    """Which name is which view."""
    if layout.order not in (None, "lawnmower"):
        raise ValueError(
            f"Names of views are in {argument('order', 'lawnmower')} or row by row (leave order "
            f"out), not in {argument('order', layout.order)}."
        )
    pattern = Pattern(layout.pattern) if layout.pattern else guess(pictures, where=where)
    lawnmower = layout.order == "lawnmower"
    return pattern, *arrange(pattern, names, views=layout.views, lawnmower=lawnmower, where=where)
