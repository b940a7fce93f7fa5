"""Versions and settings of this installation, for reports of bugs."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from typing import Literal, overload

from symsimpson.errors import InputError

#: What results depend on; then what is only used where it is there.
_NEEDED = ("symsimpson", "sympy", "numpy", "numba", "llvmlite", "mpmath")
_OPTIONAL = ("scipy", "matplotlib", "plotly", "xarray", "zarr", "dask", "heyoka")

Config = dict[str, Mapping[str, str | int]]


@overload
def show_config(mode: Literal["stdout"] = ...) -> None: ...


@overload
def show_config(mode: Literal["dicts"]) -> Config: ...


def show_config(mode: str = "stdout") -> Config | None:
    """Print versions, processor, vector width, threads, and the cache of compiled code.

    Parameters
    ----------
    mode : {"stdout", "dicts"}
        Print it, or return it.

    Returns
    -------
    dict or None
        By group: "versions", "machine", "compiled code".

    Raises
    ------
    InputError
        If there is no such mode.

    Examples
    --------
    >>> import symsimpson as ss
    >>> list(ss.show_config("dicts"))
    ['versions', 'machine', 'compiled code']
    """
    if mode not in ("stdout", "dicts"):
        raise InputError(f"mode is {mode!r}.\nPass 'stdout' to print, or 'dicts' to be given it.")
    # only who asks waits for the compiler
    import llvmlite.binding as llvm

    from symsimpson.program.cache import cache_folder
    from symsimpson.program.cache_contents import usage
    from symsimpson.program.machine import MANY, available_threads, lanes_for, vector_bits

    folder = cache_folder()
    entries, size = usage(folder)
    config: Config = {
        "versions": {
            "python": platform.python_version(),
            **dict.fromkeys(_NEEDED, "no package metadata"),
            **versions_of((*_NEEDED, *_OPTIONAL)),
        },
        "machine": {
            "system": platform.platform(),
            "processor": llvm.get_host_cpu_name(),
            "threads": available_threads(),
            "vector bits": vector_bits(),
            "members side by side": f"{lanes_for(0, 1)}, {lanes_for(0, MANY)} of many small ones",
        },
        "compiled code": {
            "folder": str(folder),
            "entries": entries,
            "size": f"{size / 1e6:.1f} MB",
        },
    }
    if mode == "dicts":
        return config
    for group, values in config.items():
        print(group)
        width = max(map(len, values))
        for name, value in values.items():
            print(f"  {name:{width}}  {value}")
    return None


def versions_of(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of those packages that are installed."""
    versions = {}
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions
