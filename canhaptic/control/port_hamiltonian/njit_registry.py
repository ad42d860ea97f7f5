"""The functions that index and loop and nothing else: they run on lists, and compiled as they are for arrays."""

import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any, Final

from canhaptic.control.port_hamiltonian import discrete_gradient as tables
from canhaptic.control.port_hamiltonian import equation
from canhaptic.control.port_hamiltonian import gauss as elimination
from canhaptic.control.port_hamiltonian import newton as step

MODULES: Final[tuple[ModuleType, ...]] = (tables, elimination, equation, step)


def plain_functions() -> list[Callable[..., Any]]:
    """Returns the functions of these modules, each after those that it calls."""
    waiting = {
        function.__name__: function
        for module in MODULES
        for function in vars(module).values()
        if inspect.isfunction(function)
        and function.__module__ == module.__name__
        and function is not equation.new_workspace
    }
    order: list[Callable[..., Any]] = []

    def visit(function: Any) -> None:
        if waiting.pop(function.__name__, None) is not None:
            for name in function.__code__.co_names:
                if name in waiting:
                    visit(waiting[name])
            order.append(function)

    for function in list(waiting.values()):
        visit(function)
    return order
