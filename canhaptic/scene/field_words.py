"""Descriptions of a parameter model and of each of its fields, from the source."""

import ast
import inspect
import re

from canhaptic.units import Parameters


def words_of(model: type[Parameters]) -> dict[str, str]:
    """Description of each field: the string below it, or its entry under `Attributes:`."""
    found: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if not issubclass(owner, Parameters) or owner is Parameters:
            continue
        [body] = [
            node
            for node in ast.walk(ast.parse(inspect.cleandoc("\n" + inspect.getsource(owner))))
            if isinstance(node, ast.ClassDef)
        ][:1]
        found.update(_attributes(inspect.cleandoc(ast.get_docstring(body) or "")))
        for field, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return found


def _attributes(docstring: str) -> dict[str, str]:
    _, _, listed = docstring.partition("Attributes:\n")
    entries = re.split(r"\n    (?=\w+: )", "\n" + listed.split("\n\n")[0])
    pairs = [entry.split(": ", 1) for entry in entries if ": " in entry]
    return {name.strip(): " ".join(text.split()) for name, text in pairs}
