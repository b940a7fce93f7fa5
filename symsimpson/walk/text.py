"""The text of a module as the walker takes it: functions to walk, and constants."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from symsimpson.module.definitions import syntax
from symsimpson.module.workspace_layout import rows_of_blocks, scratch

__all__ = ["ARGUMENTS", "Text", "read_text"]

#: What each kernel takes.
ARGUMENTS = ["h", "t", "workspace"]
#: What stands for a compiler in a text.
_COMPILER = ("numba", "numba.extending")


@dataclass(frozen=True, eq=False)
class Text:
    """Functions and constants of a module."""

    functions: Mapping[str, ast.FunctionDef]  #: Kernels, and what they call.
    #: Everything else that has a name, functions of ``math`` among it.
    constants: Mapping[str, Any]
    #: Rows of the blocks of the workspace.
    blocks: Mapping[str, range] = field(default_factory=dict)
    #: Of those in which no kernel leaves anything to others.
    scratch: Mapping[str, range] = field(default_factory=dict)


@lru_cache(maxsize=4)  # kernels of a module are made one after the other
def read_text(text: str) -> Text:
    """Read a module; what makes its tables is executed, so that it must be trusted."""
    functions, others = {}, []
    for node in syntax(text).body:
        match node:
            case ast.FunctionDef(name=name) if _walked(node):
                functions[name] = node
            case ast.ImportFrom(module=module) if module in _COMPILER:
                continue
            case ast.Import() | ast.Assign(targets=[ast.Name(id="compiled")]):
                continue
            case _:
                others.append(node)
    constants: dict[str, Any] = {}
    exec(compile(ast.Module(others, []), "<constants of a module>", "exec"), constants)
    tables = {k: np.asarray(v) for k, v in constants.items() if isinstance(v, list)}
    return Text(functions, constants | tables, rows_of_blocks(constants), scratch(constants))


def _walked(node: ast.FunctionDef) -> bool:
    marks = [mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)]
    return "compiled" in marks or [argument.arg for argument in node.args.args] == ARGUMENTS
