"""Tables of numbers, and the kinds of files they go to: one set for runs and for ensembles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.extras import library
from symsimpson.files import written_beside

if TYPE_CHECKING:
    from symsimpson.runtime.results.quantities import Quantities
    from symsimpson.runtime.results.trajectory import Trajectory

__all__ = ["KINDS", "check_kind", "columns", "dataframe", "write_dataset", "write_table"]

#: Tables: what is written cannot be opened as a run again.
TABLES = (".npz", ".csv", ".parquet")
#: All kinds of files; the first two hold everything.
KINDS = (".nc", ".zarr", *TABLES)
#: What a kind needs beside the package.
NEEDS = {
    ".nc": ("xarray", "netCDF4"), ".zarr": ("xarray", "zarr"), ".npz": (), ".csv": (),
    ".parquet": ("pandas", "pyarrow"),
}  # fmt: skip


def check_kind(place: Path) -> str:
    """Return the kind of a file that results are to be written to.

    Raises
    ------
    InputError
        If the name ends otherwise, or a library is missing.
    """
    if place.suffix not in KINDS:
        raise InputError(
            f"{str(place)!r} names no kind of file that is known.\nEnd it in .nc for netCDF or "
            ".zarr for a store of Zarr, which hold everything and can be opened again; or in .npz, "
            ".csv or .parquet for a table."
        )
    for name in NEEDS[place.suffix]:
        library(name, f"a {place.suffix} file", "parquet" if name == "pyarrow" else "data")
    return place.suffix


def columns(some: Quantities) -> dict[str, NDArray[Any]]:
    """Return q, p, v, the energy, invariants and points by name, in the shape of the energy."""
    names = some._stepper.coordinates
    found = {name: some._named(name) for name in names}
    found |= {f"{x}_{name}": some._named(f"{x}_{name}") for x in "pv" for name in names}
    found |= {"energy": some.energy, **some.invariants}
    for name, place in some.points.items():
        if place.ndim == some.energy.ndim + 1:  # no body of several corners
            axes = "xyz"[: place.shape[-1]]
            found |= {f"{name}_{axis}": place[..., k] for k, axis in enumerate(axes)}
    return found


def dataframe(table: Mapping[str, NDArray[Any]], index: str, about: dict[str, Any]) -> Any:
    """Return columns as a ``pandas.DataFrame``."""
    pandas = library("pandas", "to_pandas", "data")
    frame = pandas.DataFrame(dict(table)).set_index(index)
    frame.attrs = about
    return frame


def write_dataset(
    place: Path, what: str, dataset: Any, *, consolidated: bool | None = None,
    trajectory: Trajectory | None = None,
) -> None:  # fmt: skip
    """Write an ``xarray.Dataset`` to netCDF (.nc), or to a store of Zarr.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    with written_beside(place, what, trajectory) as whole:
        if place.suffix == ".nc":
            dataset.to_netcdf(whole, engine="netcdf4")
        else:
            dataset.to_zarr(whole, mode="w", consolidated=consolidated, zarr_format=2)


def write_table(
    place: Path, what: str, arrays: Mapping[str, Any], table: Callable[[], Mapping[str, Any]],
    *, trajectory: Trajectory | None = None,
) -> None:  # fmt: skip
    """Write arrays of any shape (.npz), or a table of columns (.csv, .parquet).

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    with written_beside(place, what, trajectory) as whole:
        if place.suffix == ".npz":
            np.savez(whole, **arrays)
        elif place.suffix == ".csv":
            made = table()
            rows = np.column_stack([np.asarray(x, dtype=np.float64) for x in made.values()])
            head = ",".join(f'"{x}"' if set(x) & set(',"\n') else x for x in made)
            np.savetxt(whole, rows, delimiter=",", header=head, comments="", fmt="%.17g")
        else:
            library("pandas", "a .parquet file", "data").DataFrame(dict(table())).to_parquet(whole)
