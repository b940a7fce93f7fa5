"""Tables of numbers, and the kinds of files they go to: one set for runs and for ensembles."""

from __future__ import annotations

import os
from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.support.array_types import Reals
from symsimpson.support.extras import library
from symsimpson.support.files import check_folder, read_path, written_beside

__all__ = ["KINDS", "apart", "check_kind", "dataframe", "write"]

#: Tables: what is written cannot be opened as a run again.
TABLES = (".npz", ".csv", ".parquet")
#: All kinds of files; the first two hold everything.
KINDS = (".nc", ".zarr", *TABLES)
#: What a kind needs beside the package.
NEEDS = {
    ".nc": ("xarray", "netCDF4"),
    ".zarr": ("xarray", "zarr"),
    ".npz": (),
    ".csv": (),
    ".parquet": ("pandas", "pyarrow"),
}


def check_kind(place: Path) -> str:
    """Return the kind of a file that results are to be written to.

    Raises InputError if the name ends otherwise, or a library is missing.
    """
    if place.suffix not in KINDS:
        raise InputError(
            f"unsupported file extension {place.suffix!r} of {str(place)!r}.\nUse .nc (netCDF) or "
            ".zarr, which store everything and can be opened again; or .npz, .csv or .parquet for "
            "a table."
        )
    for name in NEEDS[place.suffix]:
        library(name, f"a {place.suffix} file", "parquet" if name == "pyarrow" else "data")
    return place.suffix


def apart(columns: Mapping[str, Reals], taken: Container[str], prefix: str) -> dict[str, Reals]:
    """Return columns for a table that has some: a prefix stands before names that are taken."""
    added = {}
    for given, column in columns.items():
        name = given
        while name in taken:
            name = prefix + name
        added[name] = column
    return added


def dataframe(
    table: Mapping[str, Reals],
    index: str,
    about: dict[str, Any],
    units: Mapping[str, str] | None = None,
) -> Any:
    """Return columns as a ``pandas.DataFrame``, which has their units among its ``attrs``."""
    pandas = library("pandas", "to_pandas", "data")
    frame = pandas.DataFrame(dict(table)).set_index(index)
    frame.attrs = about | ({"units": dict(units)} if units else {})
    return frame


def write(
    path: str | os.PathLike[str],
    what: str,
    arrays: Callable[[], Mapping[str, Any]],
    table: Callable[[], Mapping[str, Any]],
    dataset: Callable[[], Any],
    *,
    trajectory: Any = None,
) -> None:
    """Write a result into a file of the kind that its ending says.

    Messages say ``what`` is in it. ``arrays`` of any shape go to .npz, the columns of ``table`` to
    .csv and .parquet, and an ``xarray.Dataset`` to netCDF (.nc) and to Zarr, with all metadata in
    one place if ``consolidated``. Errors carry the ``trajectory``, so that it is not lost.

    Raises InputError if the name ends otherwise, a library is missing, or numbers have many
    digits, and StorageError if the file cannot be written.
    """
    place = read_path(f"the {what}'s file", path)
    kind = check_kind(place)
    check_folder(place, what, trajectory=trajectory)  # before anything is computed
    named_arrays = arrays()
    if any(np.asarray(x).dtype == object for x in named_arrays.values()):
        raise InputError(
            "numbers of many digits do not fit into this kind of file.\n"
            "Keep the arrays q and p in a file of your own."
        )
    with written_beside(place, what, trajectory) as whole:
        if kind == ".nc":
            dataset().to_netcdf(whole, engine="netcdf4")
        elif kind == ".zarr":
            dataset().to_zarr(whole, mode="w", zarr_format=2)
        elif kind == ".npz":
            np.savez(whole, **named_arrays)
        elif kind == ".csv":
            head, rows = csv_of(table())
            np.savetxt(whole, rows, delimiter=",", header=head, comments="", fmt="%.17g")
        else:
            library("pandas", "a .parquet file", "data").DataFrame(dict(table())).to_parquet(whole)


def csv_of(table: Mapping[str, Any]) -> tuple[str, Reals]:
    """Return the line of names and the rows of a table."""
    rows = np.column_stack([np.asarray(x, dtype=np.float64) for x in table.values()])
    return ",".join(f'"{x}"' if set(x) & set(',"\n') else x for x in table), rows
