"""The machine: its threads, its lanes, the versions of libraries for reports of bugs."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Literal, overload

import llvmlite.binding as llvm

from symsimpson.errors import reject

VARIABLE = "SYMSIMPSON_VECTOR_BITS"
#: The widths that machines have, by the feature that tells of them.
_WIDTHS = {"avx512f": 512, "avx": 256}
_NARROW = 128
#: Of so many members, whose workspaces have so few rows that the nearest cache has room for them,
#: two registers full stand side by side: what one waits for is hidden by the other, a sixth to a
#: fourth of the time. For others that is nothing, and costs a second of compilation.
MANY, FEW_ROWS = 1024, 256


def vector_bits() -> int:
    """Return the bits of a vector: the most that this machine has, or fewer if that is wanted.

    Raises InputError if the environment asks for what no machine has.
    """
    wanted = os.environ.get(VARIABLE)
    if wanted is None:
        return _widest()
    widths = sorted([_NARROW, *_WIDTHS.values()])
    if wanted not in map(str, widths):
        reject(
            f"${VARIABLE} is {wanted!r}, and vectors have {', '.join(map(str, widths))} bits.",
            remedy="Set it to one of them, or take it away for the widest that the machine has.",
        )
    return min(int(wanted), _widest())


@cache
def _widest() -> int:
    features = llvm.get_host_cpu_features()
    return next((bits for name, bits in _WIDTHS.items() if features.get(name)), _NARROW)


@cache
def lanes_of_machine() -> int:
    """Return the number of lanes of a block: two vector registers where they are short."""
    return 8 if llvm.get_host_cpu_features().get("avx") else 4


def lanes_for(rows: int, members: int) -> int:
    """Return the number of lanes of a block of an ensemble, with so many rows in a workspace."""
    two_registers = 2 * vector_bits() // 64
    small = members >= MANY and rows <= FEW_ROWS
    return max(lanes_of_machine(), two_registers) if small else lanes_of_machine()


def available_threads() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
        reject(f"mode is {mode!r}.", remedy="Pass 'stdout' to print, or 'dicts' to be given it.")
    from symsimpson.program.cache import cache_folder, usage

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
