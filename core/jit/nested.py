"""Kernels that kernels call: compiled to LLVM's bitcode alone, and once for all kinds of integers.  Those that Python calls are kept without it.

Numba compiles what a kernel calls as if Python called it, too: with wrappers that take Python's objects apart, optimised, and to machine code
that nobody runs, for the caller contains a copy.  And it does so anew for each literal and each width of an integer.  All that was three fifths
of the time that compiling took.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import llvmlite.binding as llvm
from numba import types
from numba.core import caching, compiler, event, sigutils, targetconfig, typing
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher


class _Bitcode(JITCodeLibrary):
    """A library that others take in: no machine code is made of it, and who takes it in optimises it, but for what makes it smaller."""

    def _optimize_final_module(self):
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=self._codegen._opt_level, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


def _result(target_context, library: JITCodeLibrary, fndesc, environment, signature, environments, **rest) -> compiler.CompileResult:
    """What a compilation has led to, but for what only those who look at it need."""
    given = {"entry_point": None, "reload_init": ()} | rest
    return compiler.CompileResult(
        typing_context=target_context.typing_context, target_context=target_context, typing_error=None, type_annotation="", signature=signature,
        objectmode=False, lifted=(), fndesc=fndesc, library=library, call_helper=None, environment=environment, metadata=None,
        referenced_envs=environments, **given,
    )  # fmt: skip


class EntryImpl(caching.CompileResultCacheImpl):
    """How a kernel that Python calls is kept in a file: its machine code and the names of its symbols.

    Numba keeps its bitcode, too, for other kernels to take in, which here have their own; to read it was half of what loading
    kernels took.
    """

    def reduce(self, cres):
        cres.fndesc.typemap = cres.fndesc.calltypes = None  # as `CompileResult._reduce` has it
        library, module = cres.library, cres.library._final_module
        symbols = [thing.name for things in (module.functions, module.global_variables) for thing in things if not thing.is_declaration]
        code = library.name, library._get_compiled_object(), tuple(symbols)
        environments = tuple(cres._find_referenced_environments())
        return code, cres.fndesc, cres.environment, cres.signature, tuple(cres.reload_init), environments

    def rebuild(self, target_context, payload):
        (name, code, symbols), fndesc, environment, signature, reload_init, environments = payload
        for prepare in reload_init:
            prepare()
        codegen = target_context.codegen()
        library = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(symbols)
        entry = target_context.get_executable(library, fndesc, environment)
        for other in environments:
            codegen.set_env(other.env_name, other)
        return _result(target_context, library, fndesc, environment, signature, environments, entry_point=entry, reload_init=reload_init)


class _BitcodeImpl(caching.CompileResultCacheImpl):
    """How the result of a nested compilation is kept in a file."""

    def get_filename_base(self, fullname, abiflags):
        return super().get_filename_base(fullname, abiflags) + ".nested"

    def reduce(self, cres):
        cres.fndesc.typemap = cres.fndesc.calltypes = None  # as `CompileResult._reduce` has it
        environments = tuple(cres._find_referenced_environments())
        return cres.library.name, cres.library._final_module.as_bitcode(), cres.fndesc, cres.environment, cres.signature, environments

    def rebuild(self, target_context, payload):
        name, bitcode, *rest = payload
        library = _Bitcode(target_context.codegen(), name)
        library._final_module = llvm.parse_bitcode(bitcode)
        library._finalize_final_module()
        return _result(target_context, library, *rest)


class NestedCache(caching.FunctionCache):
    """Keeps what a `Kernel` compiles for other kernels."""

    _impl_class = _BitcodeImpl


def _widened(kind: types.Type) -> types.Type:
    """The type for which a nested kernel is compiled: a literal's own, and int64 for all signed integers."""
    kind = types.unliteral(kind)
    return types.int64 if isinstance(kind, types.Integer) and kind.signed else kind


class Kernel(CPUDispatcher):
    """A dispatcher that compiles apart what other kernels call.

    caches: makes where its code, and that for other kernels, is kept; None for nowhere.  They are made when something is first compiled: a process
    imports far more kernels than it uses, and hundreds of caches take .4 s.
    """

    def __init__(self, *args, caches: tuple[Callable, Callable] | None = None, **options):
        self._caches, self._kept = caches, None
        super().__init__(*args, **options)
        self._nested: dict[tuple, compiler.CompileResult] = {}  # by the types of the arguments

    @property
    def _cache(self):
        """Where Numba keeps code."""
        if self._kept is None:
            self._kept = self._caches[0](self.py_func) if self._caches else caching.NullCache()
        return self._kept

    @_cache.setter
    def _cache(self, _nothing: caching.NullCache):
        """What Numba sets at first."""

    @functools.cached_property
    def nested_cache(self) -> NestedCache | None:
        """Where code for other kernels is kept."""
        return self._caches[1](self.py_func) if self._caches else None

    def compile(self, sig):
        """As Numba's: for Python."""
        known = len(self.overloads)
        entry = super().compile(sig)
        if len(self.overloads) > known:
            # What a nested kernel keeps in its environment is now the caller's.
            result = next(reversed(self.overloads.values()))
            for environment in result._find_referenced_environments():
                result.library.codegen.set_env(environment.env_name, environment)
        return entry

    def get_call_template(self, args, kws):
        """What type inference asks when another kernel calls this one."""
        pysig, args = self._compiler.fold_argument_types(args, kws)
        args = tuple(_widened(arg) for arg in args)
        name, result = self.py_func.__name__, self._for_kernels(args)
        return typing.make_concrete_template(f"CallTemplate({name})", key=name, signatures=[result.signature]), pysig, args, {}

    def get_overload(self, sig):
        """The key by which other kernels find the function, or its address, where Python alone calls it."""
        args = tuple(sigutils.normalize_signature(sig)[0])
        return (self._nested.get(args) or self.overloads[args]).entry_point

    @global_compiler_lock
    def _for_kernels(self, args: tuple) -> compiler.CompileResult:
        # Never what was compiled for Python: a caller's bits must not hang on what was called before.
        found = self._nested.get(args)
        if found is None:
            with self._compiling_counter:  # by which Numba knows recursion
                found = self.nested_cache.load_overload(args, self.targetctx) if self.nested_cache else None
                if found is None:
                    with event.trigger_event("numba:compile", data={"dispatcher": self, "args": args, "return_type": None}):
                        found = self._compiled_for_kernels(args)
                    if self.nested_cache:
                        self.nested_cache.save_overload(args, found)
            found = self._nested[args] = found._replace(entry_point=object())
            self.targetctx.insert_user_function(found.entry_point, found.fndesc, [found.library])
        return found

    def _compiled_for_kernels(self, args: tuple) -> compiler.CompileResult:
        parts = self._compiler
        flags = compiler.Flags()
        parts.targetdescr.options.parse_as_flags(flags, parts.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = _Bitcode(self.targetctx.codegen(), self.py_func.__qualname__)
        return compiler.compile_extra(
            self.typingctx, self.targetctx, self.py_func,
            args=args, return_type=None, flags=flags, locals=parts.locals, library=library, pipeline_class=parts.pipeline_class,
        )  # fmt: skip


def _equal(self, other):
    if not isinstance(other, targetconfig.TargetConfig):
        return NotImplemented
    return self is other or self._values == other._values or self.values() == other.values()


@functools.cache
def _hash_of_options(kind: type) -> int:
    return hash(tuple(sorted(kind.options)))


# Numba compares the flags of each call with those of all calls before, by way of two new dictionaries: a tenth of its time.  The values are the same.
targetconfig.TargetConfig.__eq__ = _equal
targetconfig.TargetConfig.__hash__ = lambda self: _hash_of_options(type(self))
