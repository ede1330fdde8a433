"""File names of views: patterns with (v, u), and guesses of patterns."""

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

DEFAULT_PATTERN = "view_{v:02d}_{u:02d}"  # without suffix
_COMMON_PATTERNS = tuple(
    text + suffix
    for text in ("view_{v}_{u}", "input_Cam{i}", "out_{v}_{u}_*")
    for suffix in (".png", ".tif", ".jpg")
)
_FIELD = re.compile(r"\{(\w*)(?::\w*)?\}|(\*)")
_NUMBER = re.compile(r"\d+")
_DIGITS = r"\d{1,18}"  # index; time stamps have 17 digits
# Names of files in a data set that are not views.
_NON_VIEWS = re.compile(
    r"(?<![a-z])(?:gt|masks?|depths?|disp|disparity|objectids?|labels?|normals?|boundaries)"
    r"(?![a-z])",
    re.IGNORECASE,
)
logger = logging.getLogger("clplen.io")

_MAX_AMBIGUOUS_VIEWS = 3  # views; a counter cannot be detected among so few
_MAX_ROW_DIGITS = 2  # a longer constant number is a date or a serial number
_MAX_VIEWS = 10**6


class Pattern:
    """Pattern of file names with numbers."""

    def __init__(self, text: str) -> None:
        matches = list(_FIELD.finditer(text))
        fields = sorted(m.group(1) for m in matches if m.group(1) not in (None, "n"))
        if fields not in (["u", "v"], ["i"]):
            raise ValueError(
                f"pattern must have {{v}} and {{u}} once each, or {{i}} once, besides any {{n}} "
                f"and *, got {text!r}: use for example 'view_{{v}}_{{u}}.png'."
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
        """Return the files of each (v, u) or (i,) as numbered in the names."""
        files: dict[tuple[int, ...], list[str]] = {}
        for name in names:
            match = self._regex.fullmatch(name)
            if match:
                fields = match.groupdict()
                key = (fields["i"],) if self.counts_views else (fields["v"], fields["u"])
                files.setdefault(tuple(int(k) for k in key), []).append(name)
        return files


def arrange(
    pattern: Pattern,
    names: Iterable[str],
    *,
    views: View | None = None,
    lawnmower: bool = False,
    where: str = "the folder",
) -> tuple[View, dict[View, str]]:
    """Assign files to views by the rank of their numbers, independent of start and step."""
    names = list(names)
    _require_one_number(pattern, lawnmower)
    by_number = pattern.numbers(names)
    if not by_number:
        raise FormatError(
            f"No file in {where} matches the pattern {pattern.text!r}; existing files are "
            f"{listed(sorted(names)[:3]) or 'none'}."
        )
    duplicates = [" and ".join(files) for files in by_number.values() if len(files) > 1]
    if duplicates:
        raise FormatError(f"Several files in {where} have the same view: {listed(duplicates)}.")
    axes = [
        _ranks(sorted({key[axis] for key in by_number}))
        for axis in range(len(next(iter(by_number))))
    ]
    counts = [1 + max(ranks.values()) for ranks in axes]
    ranked = {
        tuple(axes[axis][value] for axis, value in enumerate(key)): files[0]
        for key, files in by_number.items()
    }
    _require_plausible(counts, len(ranked), pattern, where)
    if pattern.counts_views:
        shape = _shape_of(counts[0], views, pattern)
        return shape, {
            _grid_index(rank[0], shape[1], lawnmower=lawnmower): file
            for rank, file in ranked.items()
        }
    shape = (counts[0], counts[1])
    if views is not None and tuple(views) != shape:
        raise FormatError(
            f"{argument('views', tuple(views))} must equal {shape[0]} x {shape[1]}, the views (V x "
            f"U) of the names in {where} (pattern {pattern.text!r})."
        )
    return shape, {(rank[0], rank[1]): file for rank, file in ranked.items()}


def _require_one_number(pattern: Pattern, lawnmower: bool) -> None:
    if lawnmower and not pattern.counts_views:
        raise ValueError(
            f"{argument('order', 'lawnmower')} requires names with one number, but the pattern "
            f"{pattern.text!r} has row and column: give a pattern with {{i}}, or omit order."
        )


def _require_plausible(counts: Sequence[int], files: int, pattern: Pattern, where: str) -> None:
    if math.prod(counts) > _MAX_VIEWS:
        raise FormatError(
            f"The numbers in the names in {where} (pattern {pattern.text!r}) would give "
            f"{' x '.join(f'{n:,}' for n in counts)} views from {files} files: give a "
            "pattern that matches the views only."
        )


def _grid_index(index: int, columns: int, *, lawnmower: bool) -> View:
    """Return (v, u) of a view numbered row by row."""
    v, u = divmod(index, columns)
    return (v, columns - 1 - u) if lawnmower and v % 2 else (v, u)


def views_only(names: Iterable[str], *, pattern: str | None = None) -> list[str]:
    """Return names without hidden files, masks, depths and the like."""
    visible = [name for name in names if not any(part[:1] == "." for part in name.split("/"))]
    if pattern is not None and _NON_VIEWS.search(pattern.rsplit("/", 1)[-1]):
        return visible
    return [name for name in visible if not _NON_VIEWS.search(name.rsplit("/", 1)[-1])]


def _ranks(values: Sequence[int]) -> dict[int, int]:
    """Return the rank of each number in an arithmetic progression; gaps skip ranks."""
    step = math.gcd(*(b - a for a, b in pairwise(values))) or 1
    return {value: (value - values[0]) // step for value in values}


def _shape_of(count: int, views: View | None, pattern: Pattern) -> View:
    """Return (V, U) of views numbered row by row."""
    if views is not None:
        if count > views[0] * views[1]:
            raise FormatError(
                f"{argument('views', tuple(views))} must cover the {count} views of the pattern "
                f"{pattern.text!r}."
            )
        return (views[0], views[1])
    side = math.isqrt(count)
    if side * side != count:
        raise FormatError(
            f"The pattern {pattern.text!r} gives {count} views, not a square number: give rows and "
            f"columns by {argument('views', ('V', 'U'))}."
        )
    return (side, side)


def guess(names: Sequence[str], *, where: str = "the folder") -> Pattern:
    """Guess the pattern of a folder's names: a common pattern, else the most frequent form.

    Two varying numbers are v and u in this order, even if one of them is constant and below 100 (a
    single row or column of views). A single number is i. Pictures with other names are left out and
    counted in the log.
    """
    pattern = _guess_pattern(names, where)
    skipped = len(names) - sum(len(files) for files in pattern.numbers(names).values())
    if skipped:
        logger.info(
            "%d of %d pictures in %s are left out: their names do not match the guessed pattern %r",
            skipped,
            len(names),
            where,
            pattern.text,
        )
    return pattern


def _guess_pattern(names: Sequence[str], where: str) -> Pattern:
    for text in _COMMON_PATTERNS:
        count = len(Pattern(text).numbers(names))
        if count > 1 or count == len(names) == 1:
            return Pattern(text)
    forms = Counter(_NUMBER.sub("{}", name) for name in names)
    if not forms:
        raise FormatError(
            f"There is no picture in {where}: give the folder of views, or a pattern, for example "
            f"{argument('pattern', 'view_{v}_{u}.png')}."
        )
    form, count = forms.most_common(1)[0]
    number_rows = [_NUMBER.findall(name) for name in names if _NUMBER.sub("{}", name) == form]
    columns = [sorted(set(column)) for column in zip(*number_rows, strict=True)]
    varying = [index for index, column in enumerate(columns) if len(column) > 1]
    if (
        len(columns) == 2
        and len(varying) == 1
        and len(columns[1 - varying[0]][0]) <= _MAX_ROW_DIGITS
    ):
        varying = [0, 1]
    if not varying or count < 2:
        raise FormatError(
            f"No number varies in the names in {where} ({listed(sorted(names)[:3])}), so they are "
            "not views of a light field. Give a raw frame as a file instead of its folder; for "
            f"views, give a pattern, for example {argument('pattern', 'view_{v}_{u}.png')}."
        )
    fields = dict(zip(varying, ("{v}", "{u}") if len(varying) == 2 else ("{i}",), strict=False))
    counters = [index for index in varying if len(columns[index]) == count]
    has_counter = (
        min(len(columns[index]) for index in varying) > 1
        and counters
        and count > _MAX_AMBIGUOUS_VIEWS
    )
    if len(varying) > 2 or (len(varying) == 2 and has_counter):
        raise FormatError(
            f"{len(varying)} numbers vary in the names in {where} ({listed(sorted(names)[:3])}), "
            "so row and column of the view are ambiguous: "
            + _proposal(form, columns, varying, counters)
        )
    return Pattern(_fill_fields(form, columns, fields))


def _fill_fields(form: str, columns: Sequence[Sequence[str]], fields: dict[int, str]) -> str:
    """Return a form of names with fields in place of some numbers."""
    values = [fields.get(index, column[0]) for index, column in enumerate(columns)] + [""]
    return "".join(a + b for a, b in zip(form.split("{}"), values, strict=True))


def _proposal(
    form: str, columns: Sequence[Sequence[str]], varying: Sequence[int], counters: Sequence[int]
) -> str:
    """Propose a pattern: the two numbers with the fewest values are row and column."""
    fields = dict.fromkeys(varying, "{n}")
    if len(varying) == 2:  # a number that differs in every name counts the views
        counter = min(counters, key=lambda index: max(map(len, columns[index])))
        fields[counter] = "{i}"
        return (
            f"give a pattern, perhaps {argument('pattern', _fill_fields(form, columns, fields))} "
            "({i} counts views row by row, {n} is ignored)."
        )
    row, column = sorted(sorted(varying, key=lambda index: (len(columns[index]), -index))[:2])
    fields |= {row: "{v}", column: "{u}"}
    return (
        f"give a pattern, perhaps {argument('pattern', _fill_fields(form, columns, fields))}, with "
        "{v} and {u} exchanged if columns come first ({n} is ignored)."
    )


def assign_views(
    names: list[str], pictures: list[str], layout: Layout, where: str
) -> tuple[Pattern, View, dict[View, str]]:
    """Return the pattern, the number of views and the name of each view."""
    if layout.order not in (None, "lawnmower"):
        raise ValueError(
            f"order must be {argument('order', 'lawnmower')} or omitted (row by row) for names of "
            f"views, got {argument('order', layout.order)}."
        )
    pattern = Pattern(layout.pattern) if layout.pattern else guess(pictures, where=where)
    lawnmower = layout.order == "lawnmower"
    return pattern, *arrange(pattern, names, views=layout.views, lawnmower=lawnmower, where=where)
