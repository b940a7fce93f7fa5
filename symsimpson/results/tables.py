"""Tables, datasets and files of results."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.program import Program
from symsimpson.support.array_types import Reals
from symsimpson.support.calling import explaining
from symsimpson.support.extras import library
from symsimpson.support.files import check_folder, read_path, written_beside
from symsimpson.text.quantity import QUANTITIES, VECTORS

#: Kinds of files, and the libraries that they need; the first two hold everything.
NEEDS = {
    ".nc": ("xarray", "netCDF4"),
    ".zarr": ("xarray", "zarr"),
    ".npz": (),
    ".csv": (),
    ".parquet": ("pandas", "pyarrow"),
}
#: Tables, which cannot be opened as a run again.
TABLES = (*NEEDS,)[2:]


@dataclass(frozen=True)
class Variable:
    """One quantity of a result, as tables, datasets and files show it."""

    name: str  #: In datasets.
    values: Any
    axes: tuple[str, ...]  #: Dimensions in datasets.
    doc: str = ""  #: Its ``long_name`` in datasets.
    columns: Sequence[str] = ()  #: Names in tables, one for each number of a row.
    prefix: str = ""  #: Precedes the name of a column if that is taken.
    array: str = ""  #: Name in .npz files, "" if these do not have it.


def attribute_name(name: str, identifier: str) -> str:
    """Return a name if attributes of files may have it, else the name in the module."""
    return name if re.fullmatch(r"[^/\x00-\x1f\x7f]*[^/\s\x00-\x1f\x7f]", name) else identifier


def variable_of(
    name: str, values: Any, axes: tuple[str, ...], program: Program, key: str = "", doc: str = ""
) -> Variable:
    """Return the variable of a quantity, an invariant or a point, named as in ``run[name]``.

    The ``key`` names it and its own axes in datasets.
    """
    key, further = key or name, np.ndim(values) - len(axes)
    further_axes, columns, prefix = (f"corner_{key}", f"axis_{key}")[2 - further :], [name], ""
    if name in QUANTITIES:
        columns = QUANTITIES[name].shown(program.names)
        further_axes = ("coord",) if QUANTITIES[name] in VECTORS else further_axes
    elif further:  # a body of several corners is in no table
        axes_of_point, prefix = "xyz"[: values.shape[-1]] * (further == 1), "point_"
        columns = [f"{name}_{x}" for x in axes_of_point]
    return Variable(key, values, (*axes, *further_axes), doc, columns, prefix, array=name)


def table_of(
    index: Mapping[str, Reals], variables: Iterable[Variable], program: Program
) -> dict[str, Reals]:
    """Return the columns of a table, the index first: invariants replace momenta of their name."""
    variables, table = [x for x in variables if x.columns], dict(index)
    rows = len(next(iter(index.values())))
    reserved = [name for vector in VECTORS for name in vector.shown(program.names)]
    taken = {*index, *reserved, *(name for x in variables if not x.prefix for name in x.columns)}
    for variable in variables:
        columns = np.reshape(variable.values, (rows, len(variable.columns)))
        for k, column in enumerate(variable.columns):
            name = column
            while variable.prefix and name in taken:
                name = variable.prefix + name
            taken.add(name)
            if name not in index:
                table[name] = columns[:, k]
    return table


def with_units(data: Any, units: Mapping[str, str]) -> Any:
    """Return an ``xarray.Dataset`` with the units that are known.

    Units of q, p and v are in coordinates named ``units_q`` and so on, and in an attribute where
    all are the same.
    """
    for name, column in data.variables.items():
        numbered = name.startswith(("invariant_", "quantity_"))
        key = column.attrs.get("long_name", name) if numbered else name.removeprefix("point_")
        key = "t" if name == "time" else key
        if key in units and name != "coord":
            data[name].attrs["units"] = units[key]
    for name, prefix in ((vector.name, vector.prefix) for vector in VECTORS):
        unit_names = [units.get(f"{prefix}{q}", "") for q in data["coord"].values.tolist()]
        if name in data and any(unit_names):
            data = data.assign_coords({f"units_{name}": ("coord", unit_names)})
            if len(set(unit_names)) == 1:
                data[name].attrs["units"] = unit_names[0]
    return data


def check_kind(place: Path) -> str:
    """Return the kind of a file that results are to be written to.

    Raises InputError if the name ends otherwise, or a library is missing.
    """
    if place.suffix not in NEEDS:
        reject(
            f"unsupported file extension {place.suffix!r} of {str(place)!r}.",
            remedy="Use .nc (netCDF) or "
            ".zarr, which store everything and can be opened again; or .npz, .csv or .parquet for "
            "a table.",
        )
    for name in NEEDS[place.suffix]:
        library(name, f"a {place.suffix} file", "parquet" if name == "pyarrow" else "data")
    return place.suffix


@explaining()
class Tabular:
    """A result that is a table of pandas and a dataset of xarray."""

    program: Program
    t: Any

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame``, a row for each stored state.

        Its columns are positions, momenta, velocities, energies, invariants and the coordinates of
        points, or the quantities that were saved. The columns of a point "bob" are ``bob_x`` and so
        on, or ``point_bob_x`` if ``bob_x`` is a coordinate. The index is the time. An ensemble has
        the member as index, and columns for its parameters, the results of ``reduce`` and t.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> list(run.to_pandas().columns)
        ['theta', 'p_theta', 'v_theta', 'energy', 'kinetic_energy', 'bob_x', 'bob_y']
        >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, every=10)
        >>> many.to_pandas().shape
        (12, 11)
        """
        table, units = self._table(), self.program.units
        frame = library("pandas", "to_pandas", "data").DataFrame(table).set_index(next(iter(table)))
        frame.attrs = self._about() | ({"units": dict(units)} if units else {})
        return frame

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` with the dimensions time and coord.

        The dataset of an ensemble has the dimension member, too, and parameters as coordinates of
        the members. The states of an ensemble in a store stay there until they are read.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.to_xarray()["q"].dims
        ('time', 'coord')
        >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50)
        >>> many.to_xarray()["q"].dims
        ('member', 'coord')
        """
        xarray = library("xarray", "to_xarray", "data")
        data = self._opened(xarray)
        if data is not None:
            return data
        variables = {
            x.name: (x.axes, x.values, {"long_name": x.doc} if x.doc else {})
            for x in self._variables()
        }
        data = xarray.Dataset(variables, self._axes(), self._about())
        return with_units(data, self.program.units)

    def _opened(self, xarray: Any) -> Any:
        """Return the dataset of a result that is on disk; None of others."""
        return None

    def _variables(self) -> list[Variable]:
        """Return the quantities of the result, without its axes."""
        raise NotImplementedError

    def _axes(self) -> dict[str, Any]:
        """Return the coordinates of a dataset."""
        return {"time": self.t, "coord": list(self.program.coordinates)}

    def _about(self) -> dict[str, Any]:
        """Return the attributes of tables and datasets."""
        return {"system": self.program.system, "scheme": self.program.scheme}

    def _table(self) -> dict[str, Reals]:
        """Return columns by name; the first is the index."""
        return table_of({"t": self.t}, self._variables(), self.program)

    def _arrays(self) -> dict[str, Any]:
        """Return the arrays of .npz files."""
        return {"t": self.t, **{x.array: x.values for x in self._variables() if x.array}}


@explaining()
class Savable(Tabular):
    """A result that can be saved to a file."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the result to a file, in the format of its extension.

        ``.nc`` (netCDF) and ``.zarr`` (a store of Zarr) hold what :meth:`to_xarray` gives.
        ``.csv`` and ``.parquet`` are tables, with the columns of :meth:`to_pandas`. ``.npz`` has
        arrays t, q, p, v, energy and points; of an ensemble t, q, p, status, parameters and the
        results of ``reduce``.

        A ``.nc`` or ``.zarr`` file of a :class:`Trajectory` holds the generated module, too:
        :func:`symsimpson.open_trajectory` gives this trajectory back. It rejects all other files;
        read these with numpy, pandas or xarray.

        Raises
        ------
        InputError
            If there is no such format, a library is missing, or the run has many digits.
        StorageError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.zarr"
        >>> run.save(path)
        >>> ss.open_trajectory(path).steps
        50
        """
        what = self._kind_of_result()
        place = read_path(f"the {what}'s file", path)
        kind = check_kind(place)
        check_folder(place, what, trajectory=self)  # before anything is computed
        arrays = self._arrays()
        if any(np.asarray(x).dtype == object for x in arrays.values()):
            reject(
                "numbers of many digits do not fit into this kind of file.",
                remedy="Keep the arrays q and p in a file of your own.",
            )
        with written_beside(place, what, trajectory=self) as whole:
            self._write(whole, kind, arrays)

    def _write(self, place: Path, kind: str, arrays: Mapping[str, Any]) -> None:
        """Write a file of a kind."""
        if kind == ".nc":
            self._contents().to_netcdf(place, engine="netcdf4")
        elif kind == ".zarr":
            self._contents().to_zarr(place, mode="w", zarr_format=2)
        elif kind == ".npz":
            np.savez(place, **arrays)
        elif kind == ".csv":
            table = self._table()
            rows = np.column_stack([np.asarray(x, dtype=np.float64) for x in table.values()])
            head = ",".join(f'"{x}"' if set(x) & set(',"\n') else x for x in table)
            np.savetxt(place, rows, delimiter=",", header=head, comments="", fmt="%.17g")
        else:
            pandas = library("pandas", "a .parquet file", "data")
            pandas.DataFrame(self._table()).to_parquet(place)

    def _contents(self) -> Any:
        """Return the dataset that goes to files."""
        return self.to_xarray()

    def _kind_of_result(self) -> str:
        """Name the result in messages."""
        return "result"
