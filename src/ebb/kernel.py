"""``@ebb.kernel`` and ``@ebb.func``: from a decorated function to a launch.

Three lifetimes, three objects. A ``Kernel`` is the body: the decorated function. A ``Specialisation`` is what became of
it for one relation and one set of parameter types: KIR, phases, executables. A ``Launch`` is a specialisation on one
set of rows, checked once: what a repeated launch runs (``launch.py``).
"""

from __future__ import annotations

import functools
import inspect
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from types import CodeType, FrameType, FunctionType
from typing import Any, overload

from ebb.backends.backend import ANYWHERE, CheckedKernel, Hints
from ebb.backends.kept_facts import FactsFile
from ebb.backends.select import current_backend
from ebb.compiler.arguments import argument_type, check_argument
from ebb.compiler.elaborate.errors import NotAFunction
from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.guards import Guard
from ebb.compiler.elaborate.parameters import (
    FieldName,
    ParameterType,
    parameter_types,
    plain_signature,
    row_annotation,
)
from ebb.compiler.elaborate.source import Scope, SourceFunction
from ebb.compiler.facts import LaunchFacts, launch_facts
from ebb.compiler.inputs import Inputs
from ebb.compiler.launch_errors import (
    ArgumentCount,
    ArgumentType,
    CaptureChanged,
    NotRows,
    RowsMismatch,
    UnknownStage,
    checked_block_size,
)
from ebb.compiler.scatter.step import OutlinedStep
from ebb.compiler.whole import Whole, make_whole
from ebb.errors import EbbError, KernelSyntaxError, KernelTypeError, trimmed
from ebb.launch import Launch, Specialisation
from ebb.records import field, record, replace
from ebb.relations.relation import Relation
from ebb.relations.subset import RowSet, Subset
from ebb.runtime.collection import uncollected
from ebb.types.types import Type

_BLOCK_SIZE = "block_size"

_Function = Callable[..., None]
_Types = tuple[ParameterType, ...]


@record(eq=False)
class _Compiled:
    """What a kernel keeps for one relation: its specialisations by parameter types, and its launches by row set."""

    specialisations: dict[_Types, list[Specialisation]] = field(default_factory=dict[_Types, list[Specialisation]])
    launches: dict[RowSet, list[Launch]] = field(default_factory=dict[RowSet, list[Launch]])


class Kernel:
    """A function over the rows of a relation, made by ``@ebb.kernel``. Calling it launches it.

    A kernel is checked and compiled at its first launch on a relation, or by ``check``; all of its errors are reported
    at once. A launch runs the function for every row of a relation or subset, in any order, as if at the same time.
    """

    def __init__(
        self, function: _Function, hints: Hints, text: str | None, frame_locals: Mapping[str, Any] | None
    ) -> None:
        if not isinstance(function, FunctionType):
            raise KernelSyntaxError(NotAFunction(function))
        functools.update_wrapper(self, function)
        self._name = function.__name__
        self._scope = Scope(function, text, frame_locals or {})
        self._hints = replace(hints, block_size=checked_block_size(self._name, hints.block_size))
        self._sized: dict[int, Kernel] = {}

    def __repr__(self) -> str:
        return f"<ebb.kernel {self._name}{self._signature}>"

    def __call__(self, rows: Relation | Subset, /, *parameters: Any, **named: Any) -> None:
        """Launches the kernel on every row of ``rows``.

        Args:
            rows: a relation, or a subset of one.
            *parameters: the further parameters of the kernel, in order or by name.
            **named: those by name; ``block_size=`` is for this launch, if the kernel has no parameter of that name.

        Raises:
            EbbError: the kernel is wrong, does not fit the rows or the parameters, or failed for some row.
        """
        try:
            if named:
                meant = self._meant(named)
                if meant is not self:
                    meant(rows, *parameters, **named)
                    return
            else:
                # A launch that has run before, if its inputs have the form that it knows. All else goes the long way.
                for launch in self._known_launches(rows):
                    uniforms = launch.take(parameters)
                    if uniforms is not None:
                        launch.run(uniforms)
                        return
            arguments = self._bind(rows, parameters, named)
            launch = self._find_launch(rows, arguments)
            launch.run(launch.specialisation.uniforms(arguments))
        except EbbError as error:
            raise trimmed(error) from error.__cause__

    def check(self, rows: Relation | Subset, /, *parameters: Any, **named: Any) -> None:
        """Checks the kernel for ``rows`` without running it.

        Raises:
            EbbError: every error of the kernel, at once.
        """
        try:
            self._meant(named)._launch_of(rows, parameters, named)
        except EbbError as error:
            raise trimmed(error) from error.__cause__

    def explain(self, rows: Relation | Subset, /, *parameters: Any, **named: Any) -> str:
        """Prints how the kernel will run on ``rows``: phases, reductions, layout, and bytes and operations a row.

        Returns:
            What it printed, for programs.

        Raises:
            EbbError: as ``check``.
        """
        from ebb.compiler.explain import explain  # here: few programs ask for it

        launch = self._meant(named)._launch_of(rows, parameters, named)
        checked = launch.specialisation.checked
        how = launch.how()
        text = explain(checked.kernel, checked.phases, how.reductions, how.totals, how.order)
        print(text)
        return text

    def inspect(self, rows: Relation | Subset, stage: str, /, *parameters: Any, **named: Any) -> str:
        """The kernel at one stage of its compilation for the current backend.

        Args:
            rows: a relation or subset.
            stage: ``"kir"``, ``"ptx"`` or ``"spirv"``; on compiled backends also ``"lir"`` and ``"llvm"``, on cpu
                ``"asm"``.

        Raises:
            EbbError: as ``check``, or there is no such stage.
        """
        launch = self._meant(named)._launch_of(rows, parameters, named)
        if stage == "kir":
            from ebb.compiler import kir_print  # here: few programs ask for it

            return kir_print.text(launch.specialisation.checked.kernel)
        text = launch.inspect(stage)
        if text is None:
            backend = current_backend()
            stages = dict.fromkeys(("kir", *backend.stages, *ANYWHERE))
            raise KernelTypeError(UnknownStage(self._name, stage, backend.name, tuple(stages)))
        return text

    @functools.cached_property
    def source(self) -> SourceFunction:
        """The kernel's source, found when it is first needed.

        Raises:
            KernelSyntaxError: Python keeps no source of the function, or what it keeps is not this function.
        """
        return self._scope.source()

    @functools.cached_property
    def _signature(self) -> inspect.Signature:
        parameters = list(inspect.signature(self._scope.function).parameters.values())
        return inspect.Signature([p.replace(annotation=inspect.Parameter.empty) for p in parameters[1:]])

    @functools.cached_property
    def _declared(self) -> tuple[tuple[str, Type | type[str] | None], ...]:
        plain = plain_signature(self._scope)
        declared = parameter_types(self.source) if plain is None else plain.parameters
        return tuple(declared.items())

    def _meant(self, named: dict[str, Any]) -> Kernel:
        """The kernel with the block size that a call asks for, which is taken out of ``named``; else this kernel."""
        if _BLOCK_SIZE not in named or _BLOCK_SIZE in self._signature.parameters:
            return self
        size = checked_block_size(self._name, named.pop(_BLOCK_SIZE))
        if size == self._hints.block_size:
            return self
        if size not in self._sized:
            hints = replace(self._hints, block_size=size)
            self._sized[size] = Kernel(self._scope.function, hints, self._scope.text, self._scope.locals)
        return self._sized[size]

    def _launch_of(self, rows: Any, parameters: tuple[Any, ...], named: Mapping[str, Any]) -> Launch:
        return self._find_launch(rows, self._bind(rows, parameters, named))

    def _bind(self, rows: Any, parameters: tuple[Any, ...], named: Mapping[str, Any]) -> tuple[Any, ...]:
        """The further parameters in the order of the signature, defaults filled in."""
        if not isinstance(rows, Relation | Subset):
            raise KernelTypeError(NotRows(self._name, rows))
        if not named and len(parameters) == len(self._declared):
            return parameters
        try:
            bound = self._signature.bind(*parameters, **named)
        except TypeError as error:
            raise KernelTypeError(ArgumentCount(self._name, str(self._signature), str(error))) from None
        bound.apply_defaults()
        return bound.args

    def _types(self, arguments: tuple[Any, ...]) -> _Types:
        """The type of each further parameter: the declared one, else that of its argument."""
        pairs = zip(self._declared, arguments, strict=True)
        return tuple([self._type(name, declared, value) for (name, declared), value in pairs])

    def _type(self, name: str, declared: Type | type[str] | None, value: Any) -> ParameterType:
        named = declared is None or isinstance(declared, type)
        if named and isinstance(value, str):
            return FieldName(value)
        if isinstance(declared, type):
            raise KernelTypeError(ArgumentType(self._name, name, value, "it is declared as the name of a field"))
        if declared is not None:
            check_argument(self._name, name, value, declared)
            return declared
        bare = argument_type(value)
        if bare is None:
            raise KernelTypeError(ArgumentType(self._name, name, value, None))
        return bare

    def _known_launches(self, rows: RowSet) -> Sequence[Launch]:
        """The launches on ``rows`` so far, whatever their parameters; of what is no set of rows there are none."""
        try:
            return rows.storage.compiled[self].launches[rows]
        except (AttributeError, KeyError, TypeError):
            return ()

    def _compiled(self, relation: Relation) -> _Compiled:
        kept = relation.storage.compiled
        found = kept.get(self)
        return kept.setdefault(self, _Compiled()) if found is None else found

    def _find_launch(self, rows: RowSet, arguments: tuple[Any, ...]) -> Launch:
        types = self._types(arguments) if arguments else ()
        launches = self._compiled(rows.relation).launches.setdefault(rows, [])
        for launch in launches:
            if launch.specialisation.types == types and launch.specialisation.holds(arguments):
                return launch
        specialisation = self._find_specialisation(rows.relation, types, arguments)
        specialisation.check_rows(rows)
        launch = Launch(specialisation, rows)
        launches.append(launch)
        return launch

    def _find_specialisation(self, relation: Relation, types: _Types, arguments: tuple[Any, ...]) -> Specialisation:
        plain = plain_signature(self._scope)
        expected = row_annotation(self.source) if plain is None else plain.row
        if expected is not None and expected is not relation:
            raise KernelTypeError(RowsMismatch(self._name, expected.name, relation.name))
        known = self._compiled(relation).specialisations.setdefault(types, [])
        for specialisation in known:
            if specialisation.holds(arguments):
                return specialisation
        with uncollected():
            specialisation = self._specialise(relation, types, arguments)
        known.append(specialisation)
        return specialisation

    def _specialise(self, relation: Relation, types: _Types, arguments: tuple[Any, ...]) -> Specialisation:
        kept = current_backend().facts_cache
        file = None if kept is None else FactsFile(self._scope, relation, types, kept)
        found = None if file is None else file.find(arguments)
        if found is not None:
            return self._known(relation, types, *found)
        whole = make_whole(self.source, relation, types)
        facts = launch_facts(whole)
        if file is not None:
            file.put(whole.trail, whole.guards, facts)
        checked = CheckedKernel(whole.step, self._hints, whole.verify)
        return self._specialisation(checked, facts, whole.guards, types)

    def _known(
        self, relation: Relation, types: _Types, facts: LaunchFacts, guards: tuple[Guard, ...]
    ) -> Specialisation:  # fmt: skip
        """The specialisation of which these facts are known. Its kernel is made when somebody asks for it."""
        made: list[Whole] = []
        scope = self._scope  # not the kernel, which its launches must not hold

        def make() -> Whole:
            if not made:
                whole = make_whole(scope.source(), relation, types)
                if not facts.outline.is_of(whole.step.outline):
                    raise KernelTypeError(CaptureChanged(facts.outline.name))
                made.append(whole)
            return made[0]

        step = OutlinedStep(facts.outline, facts.phases, lambda: make().step)
        return self._specialisation(
            CheckedKernel(step, self._hints, lambda: make().verify()), facts, guards, types
        )  # fmt: skip

    def _specialisation(
        self, checked: CheckedKernel, facts: LaunchFacts, guards: tuple[Guard, ...], types: _Types
    ) -> Specialisation:
        declared = [each for _, each in self._declared]
        pairs = tuple(zip(types, declared, strict=True))
        inputs = Inputs(self._name, pairs, guards, facts.outline.uniforms)
        return Specialisation(checked, facts, guards, types, inputs)


@overload
def kernel(function: _Function, /) -> Kernel: ...
@overload
def kernel(
    *, block_size: int = 64, fastmath: bool = False, source: str | None = None
) -> Callable[[_Function], Kernel]: ...
def kernel(
    function: _Function | None = None,
    /,
    *,
    block_size: int = 64,
    fastmath: bool = False,
    source: str | None = None,
) -> Kernel | Callable[[_Function], Kernel]:
    """Makes a kernel of a function whose first parameter is a row (paper, section 3.1).

    Args:
        function: the function; its first parameter is annotated with a relation, or bare and then typed at each launch.
        block_size: rows a work-group on opencl and cuda, from 1 to 1024. A launch may have its own: ``step(cells,
            block_size=128)``.
        fastmath: takes floats for real numbers: sums are regrouped, functions approximated. NaN and infinity stay.
        source: the text that defines the function, for functions whose source Python does not keep.
    """
    hints = Hints(block_size=block_size, fastmath=fastmath)
    frame_locals = _enclosing_locals(inspect.currentframe())

    def decorate(inner: _Function) -> Kernel:
        return Kernel(inner, hints, source, frame_locals)

    return decorate if function is None else decorate(function)


@overload
def func(function: Callable[..., Any], /) -> Func: ...
@overload
def func(*, source: str | None = None) -> Callable[[Callable[..., Any]], Func]: ...
def func(
    function: Callable[..., Any] | None = None, /, *, source: str | None = None
) -> Func | Callable[[Callable[..., Any]], Func]:
    """Makes a function that kernels call: typed by its arguments at each call, inlined, not recursive.

    Args:
        function: the function; annotations of its parameters are enforced.
        source: the text that defines the function, for functions whose source Python does not keep.
    """
    frame_locals = _enclosing_locals(inspect.currentframe())

    def decorate(inner: Callable[..., Any]) -> Func:
        return Func(inner, source, frame_locals)

    return decorate if function is None else decorate(function)


def _enclosing_locals(decorator: FrameType | None) -> Mapping[str, Any] | None:
    """The locals of the functions that the decorated one is written in, as far as they run; None at module level.

    Annotations that are kept as text (PEP 563) may name locals of those functions which the closure does not hold.
    """
    scopes: list[dict[str, Any]] = []
    frame = decorator.f_back if decorator is not None else None
    inner: CodeType | None = None
    while frame is not None:
        if inner is None or inner in frame.f_code.co_consts:
            if frame.f_locals is frame.f_globals:
                break
            scopes.append(dict(frame.f_locals))
            inner = frame.f_code
        frame = frame.f_back
    return ChainMap(*scopes) if scopes else None
