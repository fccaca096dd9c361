"""The renderer: the form of an error, whatever its spans are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.render import render, render_all
from ebb.diagnostics.span import Source, Span
from ebb.errors import PhaseError, trimmed


@dataclass(frozen=True)
class Fault(Diagnostic):
    code = "E301"
    cause: Label | None = None
    others: tuple[Label, ...] = ()
    remarks: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    file: tuple[str, int | None] | None = None

    @property
    def title(self) -> str:
        return "it is wrong"

    @property
    def primary(self) -> Label | None:
        return self.cause

    @property
    def secondary(self) -> tuple[Label, ...]:
        return self.others

    @property
    def location(self) -> tuple[str, int | None] | None:
        return self.file

    @property
    def notes(self) -> tuple[str, ...]:
        return self.remarks

    @property
    def hints(self) -> tuple[str, ...]:
        return self.advice


STEP = "def step(v):\n    for e in v.edges:\n        dq = e.head.q - v.q\n\n    v.q += v.qd * dt\n"
PROGRAM = Source("step.py", STEP)


def label(source: Source, line: int, covered: str, text: str = "", caller: Span | None = None) -> Label:
    """A label on the first place of ``covered`` in that line."""
    column = source.line(line).index(covered)
    return Label(Span(source, line, column, line, column + len(covered), caller), text)


def shown(text: str) -> str:
    """A block of expected text as written in a test: without the empty first line and the margin of 4."""
    return "\n".join(line[4:] for line in text.strip("\n").split("\n")).rstrip()


def test_cause_and_conflict_are_merged_in_line_order() -> None:
    fault = Fault(
        label(PROGRAM, 5, "v.q", "changes it"),
        (label(PROGRAM, 3, "e.head.q", "reads another row"),),
        ("all rows run at once",),
        ("use a second field",),
    )
    assert render(fault) == shown(
        """
    error[E301]: it is wrong
     --> File "step.py", line 5
      |
    3 |         dq = e.head.q - v.q
      |              -------- reads another row
    5 |     v.q += v.qd * dt
      |     ^^^ changes it
      |
      = note: all rows run at once
      = hint: use a second field
      = more: ebb explain E301
    """
    )


def test_gutter_is_as_wide_as_the_largest_line_number() -> None:
    source = Source("long.py", "\n" * 99 + "x = y\n")
    lines = render(Fault(label(source, 100, "y", "here"))).split("\n")
    assert lines[1:5] == ['   --> File "long.py", line 100', "    |", "100 | x = y", "    |     ^ here"]


def test_two_labels_on_a_line_hang_from_bars() -> None:
    fault = Fault(label(PROGRAM, 3, "v.q", "right"), (label(PROGRAM, 3, "e.head.q", "left"),))
    assert render(fault).split("\n")[3:7] == [
        "3 |         dq = e.head.q - v.q",
        "  |              --------   ^^^ right",
        "  |              |",
        "  |              left",
    ]


def test_three_labels_and_labels_of_one_start() -> None:
    fault = Fault(
        label(PROGRAM, 5, "v.q", "first"),
        (label(PROGRAM, 5, "v.q += v.qd * dt", "whole"), label(PROGRAM, 5, "dt", "last")),
    )
    assert render(fault).split("\n")[3:] == [
        "5 |     v.q += v.qd * dt",
        "  |     ^^^------------- last",
        "  |     |",
        "  |     whole",
        "  |     first",
        "  |",
        "  = more: ebb explain E301",
    ]


def test_long_label_is_wrapped_beside_its_column_past_the_bars() -> None:
    fault = Fault(label(PROGRAM, 3, "v.q", "word " * 30), (label(PROGRAM, 3, "dq", "left"),))
    lines = render(fault).split("\n")[4:-2]
    assert all(len(line) <= 110 for line in lines)
    assert lines[1].index("word") == lines[0].index("word")
    assert lines[1].index("|", 4) == lines[0].index("--")


def test_tabs_and_wide_characters_keep_the_caret_under_its_text() -> None:
    source = Source("wide.py", "\tx = '日本' + y\n")
    lines = render(Fault(label(source, 1, "y", "here"))).split("\n")
    assert lines[3] == "1 |     x = '日本' + y"
    assert lines[4] == "  |" + " " * 18 + "^ here"  # two of the characters before it are two columns wide


def test_a_form_feed_does_not_shift_the_lines() -> None:
    source = Source("feed.py", "a = 1\n\fb = 2\nc = 3\r\nd = 4\n")
    assert [source.line(number) for number in range(1, 5)] == ["a = 1", "\fb = 2", "c = 3", "d = 4"]
    assert "  |  ^ here" in render(Fault(label(source, 2, "b", "here")))


def test_span_of_several_lines_marks_each_and_labels_the_last() -> None:
    source = Source("lines.py", "x = f(a,\n\n      b)\n")
    fault = Fault(Label(Span(source, 1, 4, 3, 8), "this call"))
    assert render(fault).split("\n")[3:-2] == [
        "1 | x = f(a,",
        "  |     ^^^^",
        "3 |       b)",
        "  |       ^^ this call",
    ]


def test_a_very_long_span_shows_its_ends() -> None:
    source = Source("lines.py", "x = [\n" + "    0,\n" * 50 + "]\n")
    text = render(Fault(Label(Span(source, 1, 4, 52, 1), "this list")))
    assert text.count("\n") < 12
    assert "52 | ]\n   | ^ this list" in text


def test_calls_of_inlined_code_are_shown() -> None:
    helper = Source("helper.py", "def reach(v):\n    return v.q\n")
    call = label(PROGRAM, 3, "e.head.q").span
    text = render(Fault(label(helper, 2, "v.q", "read here", caller=call)))
    assert text == shown(
        """
    error[E301]: it is wrong
     --> File "helper.py", line 2
      |
    2 |     return v.q
      |            ^^^ read here
      |
     ::: File "step.py", line 3
      |
    3 |         dq = e.head.q - v.q
      |              -------- called from here
      |
      = more: ebb explain E301
    """
    )


def test_a_call_that_is_a_label_already_is_not_shown_twice() -> None:
    call = label(PROGRAM, 3, "e.head.q", "this call")
    fault = Fault(label(PROGRAM, 5, "v.q", "changed", caller=call.span), (call,))
    assert "called from here" not in render(fault)


def test_faults_without_spans() -> None:
    assert render(Fault(remarks=("why",))) == "error[E301]: it is wrong\n  = note: why\n  = more: ebb explain E301"
    assert render(Fault(file=("mesh.off", 7))).split("\n")[1] == ' --> File "mesh.off", line 7'
    assert render(Fault(file=("mesh.off", None))).split("\n")[1] == ' --> File "mesh.off"'


def test_a_source_without_text_still_says_where() -> None:
    span = Span(Source("gone.py", ""), 12, 4, 12, 7)
    assert render(Fault(Label(span, "here"))).split("\n")[1:5] == [
        '  --> File "gone.py", line 12',
        "   |",
        "12 |",
        "   |     ^^^ here",
    ]


def test_notes_are_wrapped_and_keep_pieces_of_program() -> None:
    fault = Fault(remarks=("word " * 40,), advice=("write:\n    x = 1\n    y = 2",))
    lines = render(fault).split("\n")
    assert lines[1].startswith("  = note: word") and lines[2].startswith("          word")
    assert all(len(line) <= 100 for line in lines)
    assert "\n".join(lines[-4:-1]) == "  = hint: write:\n              x = 1\n              y = 2"


def test_paths_under_the_current_directory_are_relative(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    inside = Fault(file=(str(tmp_path / "here" / "sub" / "a.py"), 1))
    outside = Fault(file=(str(tmp_path / "b.py"), 1))
    console = Fault(file=("<stdin>", 1))
    assert f'File "{Path("sub") / "a.py"}"' in render(inside)
    assert f'File "{tmp_path / "b.py"}"' in render(outside)
    assert 'File "<stdin>"' in render(console)


def test_an_exception_is_its_diagnostics_rendered() -> None:
    error = PhaseError(Fault(remarks=("one",)), Fault(remarks=("two",)))
    assert str(error) == render_all(error.diagnostics)
    assert str(error).count("error[E301]") == 2
    assert error.codes == ("E301", "E301")


def test_trimmed_drops_the_frames_below_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise PhaseError(Fault())

    def frames() -> int:
        try:
            fail()
        except PhaseError as error:
            tail, count = trimmed(error).__traceback__, 0
            while tail is not None:
                tail, count = tail.tb_next, count + 1
            return count
        return -1

    assert frames() == 0
    monkeypatch.setenv("EBB_TRACEBACK", "1")
    assert frames() == 2
