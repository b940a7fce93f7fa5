"""Properties of the machine (vector width, threads), and versions of libraries."""

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
#: Vector widths in bits, by the CPU feature that indicates them.
_WIDTHS = {"avx512f": 512, "avx": 256}
_NARROW = 128
#: Ensembles of at least MANY members and at most FEW_ROWS rows, which fit into the L1 cache, fill
#: two vector registers. One register hides the latency of the other, which saves 1/6 to 1/4 of the
#: time. Other ensembles gain nothing, and would compile one second longer.
MANY, FEW_ROWS = 1024, 256


def vector_bits() -> int:
    """Return the vector width in bits: the widest of this machine, or a smaller wanted width.

    Raises InputError if the environment variable has any other value.
    """
    wanted = os.environ.get(VARIABLE)
    if wanted is None:
        return _widest()
    widths = sorted([_NARROW, *_WIDTHS.values()])
    if wanted not in map(str, widths):
        reject(
            f"${VARIABLE} is {wanted!r}, which is no vector width in bits.",
            remedy=f"Set it to one of {', '.join(map(str, widths))}, or unset it to use the widest "
            "vectors of the machine.",
        )
    return min(int(wanted), _widest())


@cache
def _widest() -> int:
    features = llvm.get_host_cpu_features()
    return next((bits for name, bits in _WIDTHS.items() if features.get(name)), _NARROW)


@cache
def lanes_of_machine() -> int:
    """Return the default number of lanes of a block: 8 with AVX, 4 without."""
    return 8 if llvm.get_host_cpu_features().get("avx") else 4


def lanes_for(rows: int, members: int) -> int:
    """Return the number of lanes of a block, for a number of workspace rows and of members."""
    two_registers = 2 * vector_bits() // 64
    small = members >= MANY and rows <= FEW_ROWS
    return max(lanes_of_machine(), two_registers) if small else lanes_of_machine()


def available_threads() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


#: Required packages, on which results depend; then optional packages.
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
        "stdout" (default) prints the configuration, and "dicts" returns it.

    Returns
    -------
    dict or None
        The groups "versions", "machine" and "compiled code", each a dict. None for "stdout".

    Raises
    ------
    InputError
        If the mode is neither of these.

    Examples
    --------
    >>> import symsimpson as ss
    >>> list(ss.show_config("dicts"))
    ['versions', 'machine', 'compiled code']
    """
    if mode not in ("stdout", "dicts"):
        reject(
            f"mode is {mode!r}, which is unknown.",
            remedy="Pass 'stdout' to print the configuration, or 'dicts' to get it as a dict.",
        )
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
    """Return the versions of the installed packages among ``names``."""
    versions = {}
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions
