"""The one renderer: a diagnostic as text, with carets under the cause and dashes under what it conflicts with.

    error[E301]: field 'vertices.q' is in two phases in kernel 'step'
      --> File "spring_mass.py", line 14
       |
    11 |         dq = e.head.q - v.q
       |              -------- READ: the 'q' of another row
    14 |     v.q += v.qd * dt
       |     ^^^ REDUCE(+): changes the 'q' of this row, which other rows read
       |
       = note: ...
       = hint: ...
       = more: ebb explain E301

The text is plain, so that it is right in a terminal, in pytest, in a notebook and in a log.
"""

from __future__ import annotations

import os
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator

from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.span import Source, Span
from ebb.records import record

COLUMNS = 100
"""Notes, hints and labels are wrapped at about this many columns."""

TAB = 4
LONG_SPAN = 5
"""A span of more lines than this shows its first two and its last."""


@record
class Mark:
    """The part of a label on one line, in columns of the expanded line. ``text`` stands at its last line only."""

    start: int
    end: int
    sign: str
    text: str


def render_all(diagnostics: Iterable[Diagnostic]) -> str:
    """All ``diagnostics`` as text, one after the other with a blank line between."""
    return "\n\n".join(render(diagnostic) for diagnostic in diagnostics)


def render(diagnostic: Diagnostic) -> str:
    """``diagnostic`` as text, without colour and without a newline at the end."""
    labels = _all_labels(diagnostic)
    gutter = len(str(max((label.span.end_line for label, _ in labels), default=1)))
    lines = [f"error[{diagnostic.code}]: {diagnostic.title}"]
    if diagnostic.location is not None and not labels:
        lines.append(f"{' ' * gutter}--> {_place(*diagnostic.location)}")
    for number, block in enumerate(_by_file(labels)):
        lines += _render_file(block, gutter, "-->" if number == 0 else ":::")
        lines.append(f"{' ' * gutter} |")
    for kind, texts in (("note", diagnostic.notes), ("hint", diagnostic.hints)):
        for text in texts:
            lines += _render_remark(kind, text, gutter)
    lines.append(f"{' ' * gutter} = more: ebb explain {diagnostic.code}")
    return "\n".join(lines)


def shown_path(filename: str) -> str:
    """``filename`` relative to the current directory where it lies under it, else as it is."""
    if not os.path.isabs(filename):
        return filename
    try:
        relative = os.path.relpath(filename)
    except (ValueError, OSError):  # another drive on Windows; a current directory that is gone
        return filename
    return filename if relative.startswith(os.pardir) else relative


def _place(filename: str, line: int | None) -> str:
    return f'File "{shown_path(filename)}"' + ("" if line is None else f", line {line}")


def _all_labels(diagnostic: Diagnostic) -> list[tuple[Label, str]]:
    """The labels with their signs, the primary one first, and the calls by which inlined code was reached."""
    labels: list[tuple[Label, str]] = []
    if diagnostic.primary is not None:
        labels.append((diagnostic.primary, "^"))
    labels += [(label, "-") for label in diagnostic.secondary]
    seen = {_extent(label.span) for label, _ in labels}
    for label, _ in tuple(labels):
        caller = label.span.caller
        while caller is not None:
            if _extent(caller) not in seen:
                seen.add(_extent(caller))
                labels.append((Label(caller, "called from here"), "-"))
            caller = caller.caller
    return labels


def _extent(span: Span) -> tuple[str, int, int, int, int]:
    return (span.source.filename, span.line, span.column, span.end_line, span.end_column)


def _by_file(labels: list[tuple[Label, str]]) -> Iterator[list[tuple[Label, str]]]:
    """The labels grouped by file, in the order in which the files first appear."""
    groups: dict[str, list[tuple[Label, str]]] = {}
    for label, sign in labels:
        groups.setdefault(label.span.source.filename, []).append((label, sign))
    yield from groups.values()


def _render_file(labels: list[tuple[Label, str]], gutter: int, arrow: str) -> Iterator[str]:
    first = labels[0][0].span
    yield f"{' ' * gutter}{arrow} {_place(first.source.filename, first.line)}"
    yield f"{' ' * gutter} |"
    rows: dict[int, list[Mark]] = {}
    for label, sign in labels:
        for number, mark in _marks(label, sign):
            rows.setdefault(number, []).append(mark)
    for number in sorted(rows):
        source = _expand(first.source.line(number))
        yield f"{number:>{gutter}} | {source}".rstrip()
        for line in _render_marks(rows[number]):
            yield f"{' ' * gutter} | {line}".rstrip()


def _marks(label: Label, sign: str) -> Iterator[tuple[int, Mark]]:
    """The marks of a label by line: one, or where it spans several lines, one on each line that is shown."""
    span = label.span
    numbers = _shown_lines(span)
    for number in numbers:
        line = span.source.line(number)
        start = span.column if number == span.line else len(line) - len(line.lstrip())
        end = span.end_column if number == span.end_line else len(line.rstrip())
        left = _column(line, start)
        right = max(_column(line, end), left + 1)
        yield number, Mark(left, right, sign, label.text if number == numbers[-1] else "")


def _shown_lines(span: Span) -> tuple[int, ...]:
    count = span.end_line - span.line + 1
    if count > LONG_SPAN:
        return (span.line, span.line + 1, span.end_line)
    lines = range(span.line, max(span.end_line, span.line) + 1)
    return tuple(number for number in lines if number == span.line or _has_code(span.source, number))


def _has_code(source: Source, number: int) -> bool:
    return bool(source.line(number).strip())


def _expand(line: str) -> str:
    """``line`` with tabs as spaces and control characters as blanks, as it is shown."""
    shown: list[str] = []
    column = 0
    for character in line:
        if character == "\t":
            shown.append(" " * (TAB - column % TAB))
            column += TAB - column % TAB
        else:
            shown.append(character if character.isprintable() else " ")
            column += _width(shown[-1])
    return "".join(shown)


def _column(line: str, index: int) -> int:
    """The column of the shown line at which character ``index`` of ``line`` stands; beyond the end counts on."""
    shown = sum(_width(character) for character in _expand(line[:index]))
    return shown + max(0, index - len(line))


def _width(character: str) -> int:
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def _render_marks(marks: list[Mark]) -> Iterator[str]:
    """The lines under a line of source: carets and dashes, the rightmost text beside them, the others hung below."""
    canvas = [" "] * max(mark.end for mark in marks)
    # Long marks first, and dashes before carets, so that what lies inside and what matters stays visible.
    for mark in sorted(marks, key=lambda mark: (mark.start - mark.end, mark.sign == "^")):
        canvas[mark.start : mark.end] = mark.sign * (mark.end - mark.start)
    texts = sorted((mark for mark in marks if mark.text), key=lambda mark: mark.start)
    signs = "".join(canvas)
    if not texts:
        yield signs
        return
    beside = texts[-1] if _fits_beside(texts, len(canvas)) else None
    hung = texts[:-1] if beside else texts
    bars = sorted({mark.start for mark in hung})
    yield from _write(f"{signs} " if beside else signs, beside.text if beside else "", bars)
    if hung:
        yield _bars(bars, len(canvas))
    for mark in reversed(hung):
        left = [bar for bar in bars if bar < mark.start]
        yield from _write(_bars(left, mark.start), mark.text, left)


def _fits_beside(texts: list[Mark], width: int) -> bool:
    """Whether the last text may stand on the line of the signs: its mark ends there and no other begins with it."""
    last = texts[-1]
    return last.end == width and all(mark.start != last.start for mark in texts[:-1])


def _bars(columns: list[int], width: int) -> str:
    return "".join("|" if column in columns else " " for column in range(width))


def _write(lead: str, text: str, bars: list[int]) -> Iterator[str]:
    """``lead`` and ``text`` beside it, continued below where it is long, past the ``bars`` of other texts."""
    width = max(40, COLUMNS - len(lead))
    for line in textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]:
        yield lead + line
        lead = _bars(bars, len(lead))


def _render_remark(kind: str, text: str, gutter: int) -> Iterator[str]:
    """A note or hint, wrapped; line breaks in it stay, so that it may hold a piece of program."""
    prefix = f"{' ' * gutter} = {kind}: "
    for paragraph in text.split("\n"):
        body = paragraph.lstrip()
        own = " " * (len(paragraph) - len(body))
        width = COLUMNS - len(prefix) - len(own)
        for line in textwrap.wrap(body, width, break_long_words=False, break_on_hyphens=False) or [""]:
            yield f"{prefix}{own}{line}".rstrip()
            prefix = " " * len(prefix)
