"""`inner_njit`: compiles functions that only other compiled functions call.

Numba optimizes every function and translates it to machine code before it links the function into its
callers, which are then optimized again: a function six calls deep is compiled six times. `inner_njit` links
inner functions into their callers without optimization. Only the outermost function is optimized and
translated, once, together with all functions that it calls.
"""

# pyright: reportIncompatibleMethodOverride=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Any

from numba import njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.typed_passes import NativeLowering


class _LinkedLibrary(JITCodeLibrary):
    """Numba code library of a function that only other compiled functions call. Numba links this library into
    the callers' libraries and produces no machine code for this library alone.
    """

    def _optimize_final_module(self) -> None:
        pass  # the outermost caller's library is optimized

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=False, analysis_only=False)
class _OfferToCallers(LoweringPass):
    """Compiler pass for Numba that makes an inner function available to compiled code only; a call from
    Python raises an error.
    """

    _name = "offer_to_callers"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        name = state.func_id.func_qualname.replace(".", " ")
        # Numba needs a builtin that takes positional and named arguments, and finds the function by its
        # identity. The `format` of a new string is one; Python's calls raise a KeyError with the text.
        entry_point = f"{{only compiled functions can call {name}}}".format
        lowered = state["cr"]
        state.library.finalize()
        state.targetctx.insert_user_function(entry_point, lowered.fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        state["cr"] = lowered._replace(cfunc=entry_point)
        return True


class _InnerCompiler(CompilerBase):
    """Numba compiler for inner functions. Other compiled functions can call an inner function, but Python
    code cannot.

    It compiles in nopython mode to LLVM code, without optimization, Python wrappers or machine code. The
    code is optimized and translated as a part of the outermost caller.
    """

    def define_pipelines(self) -> list:
        state = self.state
        flags = state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        state.library = _LinkedLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        pipeline = DefaultPassBuilder.define_nopython_pipeline(state)
        pipeline.add_pass_after(_OfferToCallers, NativeLowering)
        pipeline.finalize()
        return [pipeline]


def inner_njit(function: Any = None, **options: Any) -> Any:
    """Compile a function like `numba.njit`, but only for calls from other compiled functions.

    The result is not cached on disk: it becomes a part of its callers, which are cached.
    """
    return njit(function, pipeline_class=_InnerCompiler, **options)
