"""What files of the package import."""

import ast


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
