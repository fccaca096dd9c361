"""Where the source of a function is found, and what its signature declares."""

from __future__ import annotations

import ast
import linecache
import os
import subprocess
import sys
import textwrap

import pytest
from elaborated import define

import ebb
from ebb.compiler.elaborate.parameters import parameter_types, row_annotation
from ebb.compiler.elaborate.source import find_source

V = ebb.Relation("V", size=2)


def unkept(text, **names):
    """Runs ``text`` as ``exec`` of a bare string does; returns its names."""
    namespace = {"ebb": ebb, "V": V, **names}
    exec(compile(text, "<string>", "exec", dont_inherit=True), namespace)
    return namespace


def codes(error):
    return error.value.codes


def test_a_function_of_this_file_with_decorators_and_odd_docstrings():
    def passed(function):
        return function

    @passed
    @passed
    def inner(v):
        """First line.
        in column 0
        """
        v.x = 1

    source = find_source(inner)
    assert source.node.name == "inner"
    assert source.source.line(source.node.lineno).strip() == "def inner(v):"


def test_a_bare_string_has_no_source_but_may_bring_it():
    text = "\n\ndef step(v):\n    v.x = 1\n"
    function = unkept(text)["step"]
    with pytest.raises(ebb.KernelSyntaxError) as error:
        find_source(function)
    assert codes(error) == ("E101",)
    assert "source=text" in str(error.value)
    assert find_source(function, text).node.lineno == 3
    assert find_source(function, "    def step(v):\n        v.x = 1\n").node.lineno == 1


@pytest.mark.parametrize(
    "text", ["def other(v): pass", "def step(w): pass", "def step(v): pass\n" * 2 + "x = 1", "def ("]
)
def test_a_text_that_is_not_the_function(text):
    function = unkept("\n\n\n\ndef step(v):\n    v.x = 1\n")["step"]
    with pytest.raises(ebb.KernelSyntaxError) as error:
        find_source(function, text)
    assert codes(error) == ("E103",)


@pytest.mark.parametrize("function", [lambda v: v, len, int, 3, None])
def test_what_is_no_function(function):
    with pytest.raises(ebb.KernelSyntaxError) as error:
        find_source(function)
    assert codes(error) == ("E102",)


def test_an_edited_file():
    name = "<edited>"
    old = "def step(v):\n    v.x = 1\n"
    namespace = {}
    exec(compile(old, name, "exec"), namespace)
    new = "import math\n" + old
    linecache.cache[name] = (len(new), None, new.splitlines(keepends=True), name)
    with pytest.raises(ebb.KernelSyntaxError) as error:
        find_source(namespace["step"])
    assert codes(error) == ("E103",)


def test_a_source_that_a_loader_keeps():
    class Loader:
        def get_source(self, name):
            return "def step(v):\n    v.x = 1\n"

    namespace = {"__name__": "kept", "__loader__": Loader()}
    exec(compile(Loader().get_source("kept"), "archive.zip/kept.py", "exec"), namespace)
    assert find_source(namespace["step"]).node.name == "step"


def test_a_program_on_standard_input(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(
            """
            import ebb
            from ebb.compiler.elaborate.source import find_source

            def step(v):
                v.x = 1

            print(find_source(step).node.lineno)
            """
        )
    )
    with program.open() as stream:
        done = subprocess.run([sys.executable, "-"], stdin=stream, capture_output=True, text=True, env=dict(os.environ))
    assert done.stdout.strip() == "5", done.stderr


@pytest.mark.parametrize("future", ["", "from __future__ import annotations\n"])
def test_annotations_with_and_without_the_future_import(future):
    text = future + "def step(v: V, dt: ebb.float32, name: str, k: V, bare, quoted: 'ebb.vec3d'): pass\n"
    source = find_source(define(text, V=V)["step"])
    assert row_annotation(source) is V
    assert dict(parameter_types(source)) == {
        "dt": ebb.float32,
        "name": str,
        "k": ebb.key(V),
        "bare": None,
        "quoted": ebb.vec3d,
    }


def test_an_annotation_that_names_a_local_of_the_caller():
    text = """
    from __future__ import annotations
    def make(local):
        def step(v: local): pass
        return step, dict(locals())
    """
    function, frame_locals = define(text)["make"](V)
    assert row_annotation(find_source(function, None, frame_locals)) is V
    with pytest.raises(ebb.KernelTypeError) as error:
        row_annotation(find_source(function))
    assert codes(error) == ("E104",)


@pytest.mark.parametrize(
    ("signature", "code"),
    [
        ("", "E106"),
        ("v: ebb.float32", "E105"),
        ("v: 3", "E105"),
        ("v, x: float", "E105"),
        ("v, *args", "E110"),
        ("v, **kwargs", "E110"),
        ("v, *, x", "E110"),
    ],
)
def test_signatures_that_kernels_lack(signature, code):
    source = find_source(define(f"def step({signature}): pass\n")["step"])
    with pytest.raises(ebb.EbbError) as error:
        parameter_types(source)
    assert codes(error) == (code,)
    assert type(error.value) is (ebb.KernelTypeError if code == "E105" else ebb.KernelSyntaxError)


ODDLY_WRITTEN = [
    "def step(v):\n    v.x = 1",
    "x = [\n1]\ndef step(v): v.x = 1\ny = 2",
    "\n\ndef step(v):\n\n# a remark\n    v.x = 1\n    # another\n\n    v.x = 2\n\n# not its own\nx = 1\n",
    "def step(v):\n    '''\nin column 0\n#\n  '''\n    v.x = (\n1,\n2)\nx = 1\n",
    "def step(v):\n    v.x = 1 + \\\n2\n    v.x = '\\\n'\nx = 1\n",
    "if True:\n\tdef step(v):\n\t\tv.x = 1\n\t\tif v.x:\n\t\t\treturn\n\tx = 1\n",
    "if True:\n\tdef step(v):\n            v.x = 1\n            v.x = 2\nx = 3\n",
    "def passed(*of):\n    return lambda f: f\n\n@passed(\n  1)\n# between\n@passed(\n'''\n'''\n)\n"
    "def step(\n  v\n):\n    v.x = 1\nx = 1\n",
    "def step(v):\n    v.x = 1\n\x0c\n    v.x = 2\nx = 1\n",
    "def step(v):\n    '''\n" + "a line\n" * 20 + "    '''\n    v.x = 'ä'; v.x = 1\ndef other(): pass\n",
    "class Holder:\n    def step(v): v.x = 1\n    def other(): pass\nstep = Holder.step\n",
]


@pytest.mark.parametrize("text", ODDLY_WRITTEN)
def test_a_function_is_cut_out_of_its_file_as_it_stands_there(text):
    """Its own tree, to the last column, is what the tree of the whole file has."""
    name = f"<odd {hash(text)}>"
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    namespace = {}
    exec(compile(text, name, "exec"), namespace)
    found = find_source(namespace["step"])
    (whole,) = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef) and node.name == "step"]
    assert ast.dump(found.node, include_attributes=True) == ast.dump(whole, include_attributes=True)
    assert found.source.text == text


def test_what_is_wrong_elsewhere_in_an_edited_file_does_not_matter():
    name = "<edited below>"
    text = "def step(v):\n    v.x = 1\n"
    namespace = {}
    exec(compile(text, name, "exec"), namespace)
    linecache.cache[name] = (1, None, [*text.splitlines(keepends=True), "def (\n"], name)
    assert find_source(namespace["step"]).node.lineno == 1
