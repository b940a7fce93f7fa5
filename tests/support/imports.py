"""What files of the package import."""

import ast

from support.places import PACKAGE

#: Folders that count as rooms of their own: steps in C are made of a program.
APART = ("targets.c",)


def room_of(module):
    """Return the room in which a module, or a file, of the package stands."""
    if not isinstance(module, str):
        module = ".".join(module.relative_to(PACKAGE).with_suffix("").parts)
    name = module.removeprefix("symsimpson.")
    return next((x for x in APART if name.startswith(f"{x}.")), name.split(".")[0])


def imports(path, *, deferred=True):
    """Yield modules of the package that a file imports, but for types alone.

    Imports inside functions are among them if ``deferred``.
    """
    work = [ast.parse(path.read_text("utf-8"))]
    while work:
        node = work.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in names if name.startswith("symsimpson."))
        if deferred or not isinstance(node, ast.FunctionDef | ast.Lambda):
            work += reversed(list(ast.iter_child_nodes(node)))
