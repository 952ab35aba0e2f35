"""Compiled functions handed to compiled functions by their address.

numba takes a function as an argument, but looks up its machine code anew at each call (50 to 100 microseconds a
function), for longer than a few windows take to simulate; the address of a function that stays is found once.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def address_of(function: Any, kind: types.FunctionType) -> int:
    """Where the machine code of a compiled function of this kind begins; valid while the function is kept."""
    compiled = function.get_compile_result(kind.signature)
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@intrinsic
def function_at(typing: Any, kind: Any, address: Any) -> Any:
    """The first-class function of a kind (`numba.types.FunctionType`) at an address (int64)."""
    function = kind.instance_type

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = cgutils.create_struct_proxy(function)(context, builder)
        made.jit_addr = builder.inttoptr(arguments[1], context.get_value_type(types.voidptr))
        return made._getvalue()

    return function(kind, address), generate
