"""From Python functions to LLVM bitcode, by numba.

numba compiles a kernel and the functions it calls; of the result is kept what a C function needs, and nothing else:

    entry      the C function, which calls what numba made of the kernel
    internal   all other functions and constants; what nobody refers to is dropped
    external   functions of libmujoco and libm, and `symbols.PROVIDED`

Memory management, Python's exceptions, or any other part of numba's runtime cannot be in it, which `emit` checks:
kernels neither allocate nor raise.
"""

from __future__ import annotations

import functools
import gc
import pickle
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba.core import cgutils, compiler, sigutils, types
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from mjslq.native.declare import OPTIONS, emission

_RUNTIME = ("NRT_", "numba_", "Py", "_Py", "_ZN", "numba.")
"""How names of numba's runtime and Python's begin."""

_NO_COUNTS = "".join(
    f"define weak_odr void @NRT_{what}(ptr %of) alwaysinline {{ ret void }}\n" for what in ("incref", "decref")
)

_PROCESSORS = {"x86_64": "x86-64-v3", "amd64": "x86-64-v3"}
"""Processors for which bitcode is optimized: with vectors of four numbers, which others take in pieces."""


_RAISED = "numba_raised"
"""What the C function calls where the kernel has raised an exception: this must not be left when all is optimized."""


class Code(NamedTuple):
    """A kernel as LLVM has it."""

    bitcode: bytes
    symbols: tuple[str, ...]
    """Names of the functions it calls that are not in it."""


class _Library(JITCodeLibrary):
    """LLVM code, of which no machine code is made, without counts of references.

    Arrays of kernels own no memory, so that there is nothing to count.
    """

    def __init__(self, codegen: Any, name: str):
        super().__init__(codegen, name)
        self._final_module.link_in(llvm.parse_assembly(_NO_COUNTS))  # first: numba's own are then left out

    def finalize(self) -> None:
        """Nothing: the code of a kernel is put together and optimized once."""
        self._finalized = True

    def whole(self) -> Any:
        """LLVM's module with the code of all libraries that this one needs, directly or not."""
        waiting, seen = list(self._linking_libraries), set()
        while waiting:
            library = waiting.pop()
            if library not in seen:
                seen.add(library)
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
                if isinstance(library, _Library):
                    waiting += library._linking_libraries
        self._link_what_is_missing(seen)
        self._verify_declare_only_symbols()
        return self._final_module

    def _link_what_is_missing(self, libraries: set[Any]) -> None:
        """Link libraries again whose functions LLVM left out, because nothing had called them yet."""
        while True:
            missing = {f.name for f in self._final_module.functions if f.is_declaration}
            before = len(missing)
            for library in libraries:
                module = library._get_module_for_linking()
                if any(f.name in missing and not f.is_declaration for f in module.functions):
                    self._final_module.link_in(module, preserve=True)
            if sum(f.is_declaration for f in self._final_module.functions) >= before:
                return


class _Portable(JITCPUCodegen):
    """LLVM's optimizer for processors of a time, not for this one: what it makes is the same everywhere."""

    _library_class = _Library

    def _get_host_cpu_name(self) -> str:
        return _PROCESSORS.get(platform.machine().lower()) or str(super()._get_host_cpu_name())

    def _get_host_cpu_features(self) -> str:
        return "" if platform.machine().lower() in _PROCESSORS else str(super()._get_host_cpu_features())


@functools.cache
def _portable() -> Any:
    return _Portable("mjslq")


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerOnly(NativeLowering):
    """numba's last pass, without machine code for a function that only compiled functions call."""

    _name = "mjslq_lower_only"

    def run_pass(self, state: Any) -> bool:
        state.flags.no_compile = True
        state.library = _Library(_portable(), state.func_id.func_qualname)
        super().run_pass(state)
        made = state["cr"]
        callee: Any = [].append  # any function of C that is no other's: numba keeps what it made under it
        state.targetctx.insert_user_function(callee, made.fndesc, [state.library])
        state["cr"] = made._replace(cfunc=callee)
        return True


class _Emitter(compiler.CompilerBase):
    def define_pipelines(self) -> list[Any]:
        manager = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [
            (_LowerOnly, text) if made is NativeLowering else (made, text) for made, text in manager.passes
        ]
        manager.finalize()
        return [manager]


def emitter(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """The function as numba compiles it for calls from other compiled functions."""
    return numba.njit(pipeline_class=_Emitter, no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)


def emit(function: Callable[..., Any], signature: str, entry: str) -> Code:
    """Compile `function` to a C function of the name `entry`; the signature is in numba's words.

    Raises TypeError when it allocates memory, raises exceptions, or needs Python in another way.
    """
    arguments, result = sigutils.normalize_signature(signature)
    with global_compiler_lock, emission(), _no_garbage_collection():
        dispatcher = emitter(function, OPTIONS)
        dispatcher.compile(tuple(arguments))
        made = dispatcher.overloads[tuple(arguments)]
        library = _with_entry(made, arguments, result, entry)
        module = library.whole()
        _optimize(module, entry)
    symbols = sorted(f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm."))
    foreign = [name for name in symbols if name.startswith(_RUNTIME)]
    raised = _exceptions(str(module))
    if foreign or raised:
        raise TypeError(
            f"the kernel {entry} needs Python: it calls {', '.join(foreign) or 'nothing of it'}, and may raise "
            f"{'; '.join(raised) or 'nothing'}"
        )
    return Code(module.as_bitcode(), tuple(symbols))


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """A context without it: numba makes millions of objects that stay, and it takes a fifth of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _with_entry(made: Any, arguments: tuple[Any, ...], result: Any, entry: str) -> Any:
    """A library with what numba made, and a C function that calls it."""
    context = made.target_context
    library = _Library(_portable(), entry)
    module = library.create_ir_module(entry)
    given = [context.get_value_type(kind) for kind in arguments]
    returned = ir.VoidType() if result is types.none else context.get_value_type(result)
    function = ir.Function(module, ir.FunctionType(returned, given), entry)
    builder = ir.IRBuilder(function.append_basic_block())
    kind = context.call_conv.get_function_type(made.fndesc.restype, made.fndesc.argtypes)
    callee = cgutils.get_or_insert_function(module, kind, made.fndesc.llvm_func_name)
    status, value = context.call_conv.call_function(
        builder, callee, made.fndesc.restype, made.fndesc.argtypes, function.args
    )
    raised = cgutils.get_or_insert_function(module, ir.FunctionType(ir.VoidType(), [status.excinfoptr.type]), _RAISED)
    with builder.if_then(status.is_error):
        builder.call(raised, [status.excinfoptr])
    if result is types.none:
        builder.ret_void()
    else:
        builder.ret(context.cast(builder, value, made.fndesc.restype, result))
    library.add_ir_module(module)
    library.add_linking_library(made.library)
    library.finalize()
    return library


def _optimize(module: Any, entry: str) -> None:
    """Keep the entry and what it refers to, and optimize as numba does."""
    module.name = entry
    for thing in [*module.functions, *module.global_variables]:
        if not thing.is_declaration and thing.name != entry:
            thing.linkage = "internal"
    codegen = _portable()
    inlining, builder = codegen._module_pass_manager(
        loop_vectorize=codegen._loopvect, slp_vectorize=False, opt=codegen._opt_level, cost="cheap"
    )
    inlining.add_global_dead_code_eliminate_pass()
    inlining.run(module, builder)
    whole, builder = codegen._module_pass_manager()
    whole.run(module, builder)
    rest = llvm.create_new_module_pass_manager()
    rest.add_ipsccp_pass()
    rest.add_dead_arg_elimination_pass()
    rest.add_global_opt_pass()
    rest.add_global_dead_code_eliminate_pass()
    rest.run(module, builder)
    module.verify()


def _exceptions(text: str) -> list[str]:
    """What code may raise, and where: numba keeps its exceptions, pickled, in constants."""
    found = set()
    for escaped in re.findall(r'@\.const\.pickledata\.[0-9a-f.]+ =[^\n]*? c"((?:[^"\\]|\\.)*)"', text):
        data = re.sub(rb"\\([0-9A-Fa-f]{2})", lambda m: bytes([int(m[1], 16)]), escaped.encode("latin-1"))
        error, arguments, place = pickle.loads(data)
        found.add(f"{error.__name__}{arguments or ()} at {place}")
    if not found and "pickle" in text:
        found.add("something")
    return sorted(found)
