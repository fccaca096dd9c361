"""The front end makes verified KIR or an error, and passes keep the meaning of kernels."""

from __future__ import annotations

import re
import warnings
from random import Random

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import ebb
from ebb.compiler.kir_verify import verify_kernel
from ebb.compiler.pipeline import PASSES, run_passes

from .programs import accepted, elaborated, interpret, programs
from .worlds import difference

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=300, derandomize=True, **QUIET)
@given(program=programs(salt=10))
def test_passes_keep_the_meaning(program):
    kernel = accepted(program)
    assume(kernel is not None)
    before = interpret(program, kernel)
    for each in PASSES:
        passed = run_passes(kernel, (each,))
        if passed != kernel:  # else it means the same
            assert difference(before, interpret(program, passed)) is None, each.__name__
        kernel = passed


@settings(max_examples=200, derandomize=True, **QUIET)
@given(program=programs(salt=11))
def test_elaboration_makes_verified_kernels_of_right_programs(program):
    verify_kernel(elaborated(program))


TOKENS = re.compile(r"[A-Za-z_][A-Za-z_0-9]*|\d+\.?\d*|[-+*/%&|^<>=!~@]+|[()\[\],.:]|\s+")
WORDS = (
    *("r", "a1", "k1", "e1", "n1", "nodes", "links", "cells", "ebb", "half", "three", "turns", "shift", "GX", "GI"),
    *("next", "cell", "a", "b", "i", "w", "x", "s", "p", "m", "t", "out", "up", "value", "T"),
    *("0", "1", "2.5", "True", "None", "'x'", "[1, 2]", "-1", "(1, 2)", "10**40", "1e400"),
    *("+", "*", "//", "**", "@", "<", "==", "and", "not", "in", "is", "if", "else", "=", "+=", "-=", "/=", "|="),
    *("pass", "return", "break", "continue", "lambda", "del", "print", "assert", "len", "min", "range", "bump", "pick"),
    *("(", ")", "[", "]", ",", ".", ":"),
)


def damaged(text: str, seed: int, count: int) -> str:
    """``text`` with some of its words replaced, dropped or doubled, so that it is Python still."""
    head, body = text.split("\n", 2)[:2], text.split("\n", 2)[2]
    random = Random(seed)
    for _ in range(100):
        words = TOKENS.findall(body)
        for at in random.choices([at for at, word in enumerate(words) if not word.isspace()], k=count):
            words[at] = random.choice((random.choice(WORDS), random.choice(words).strip(), "", words[at] * 2))
        wrong = "\n".join([*head, "".join(words)])
        if _is_python(wrong):
            return wrong
    return text


def _is_python(text: str) -> bool:
    try:
        compile(text, "damaged", "exec")
    except SyntaxError:
        return False
    return True


def check_damaged(program, seed, count):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)
        text = damaged(program.kernel.text, seed, count)
        try:
            kernel = elaborated(program, text)
        except ebb.EbbError as error:
            assert str(error).startswith("error[E")
        else:
            verify_kernel(kernel)


@settings(max_examples=500, derandomize=True, **QUIET)
@given(program=programs(salt=12), seed=st.integers(0, 2**32 - 1), count=st.integers(1, 3))
def test_wrong_programs_are_verified_kernels_or_errors(program, seed, count):
    check_damaged(program, seed, count)


@pytest.mark.slow
@settings(max_examples=2_500, **QUIET)
@given(program=programs(), seed=st.integers(0, 2**32 - 1), count=st.integers(1, 5))
def test_many_wrong_programs_are_verified_kernels_or_errors(program, seed, count):
    check_damaged(program, seed, count)
