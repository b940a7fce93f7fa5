"""Conversion of results to tables, datasets and files."""

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
from symsimpson.support.calling import explain_methods
from symsimpson.support.extras import import_library
from symsimpson.support.files import atomic_path, check_folder, read_path
from symsimpson.text.quantity import QUANTITIES, VECTORS

#: File extensions and the libraries that they need. The first two store whole runs.
NEEDS = {
    ".nc": ("xarray", "netCDF4"),
    ".zarr": ("xarray", "zarr"),
    ".npz": (),
    ".csv": (),
    ".parquet": ("pandas", "pyarrow"),
}
#: Extensions of tables, which do not store whole runs.
TABLES = (*NEEDS,)[2:]


@dataclass(frozen=True)
class Variable:
    """One quantity of a result, with its names in tables, datasets and files."""

    name: str  #: Name in datasets.
    values: Any
    axes: tuple[str, ...]  #: Dimensions in datasets.
    doc: str = ""  #: Attribute ``long_name`` in datasets.
    columns: Sequence[str] = ()  #: Names of its columns in tables; () if tables do not have it.
    prefix: str = ""  #: Prefix of a column whose name another column has.
    array: str = ""  #: Name in .npz files; "" if these files do not have it.


def attribute_name(name: str, identifier: str) -> str:
    """Return a name if attributes of files accept it, else the ``identifier`` in the module."""
    return name if re.fullmatch(r"[^/\x00-\x1f\x7f]*[^/\s\x00-\x1f\x7f]", name) else identifier


def make_variable(
    name: str, values: Any, axes: tuple[str, ...], program: Program, key: str = "", doc: str = ""
) -> Variable:
    """Return the variable of the quantity, invariant or point ``run[name]``.

    The ``key`` is the name of the variable and of its own axes in datasets, by default ``name``.
    """
    key, extra = key or name, np.ndim(values) - len(axes)
    extra_axes, columns, prefix = (f"corner_{key}", f"axis_{key}")[2 - extra :], [name], ""
    if name in QUANTITIES:
        columns = QUANTITIES[name].shown(program.names)
        extra_axes = ("coord",) if QUANTITIES[name] in VECTORS else extra_axes
    elif extra:  # tables have points, but not bodies with several corners
        axes_of_point, prefix = "xyz"[: values.shape[-1]] * (extra == 1), "point_"
        columns = [f"{name}_{x}" for x in axes_of_point]
    return Variable(key, values, (*axes, *extra_axes), doc, columns, prefix, array=name)


def build_table(
    index: Mapping[str, Reals], variables: Iterable[Variable], program: Program
) -> dict[str, Reals]:
    """Return the columns of a table, the index first.

    An invariant replaces the momentum of the same name.
    """
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


def assign_units(data: Any, units: Mapping[str, str]) -> Any:
    """Return an ``xarray.Dataset`` with the known units as attributes.

    The units of q, p and v are also in coordinates named ``units_q`` and so on. Their attribute is
    set only if all units of the vector are equal.
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
    """Return the extension of a result file.

    Raises InputError if the extension is unknown, or a library is missing.
    """
    if place.suffix not in NEEDS:
        reject(
            f"unsupported file extension {place.suffix!r} of {str(place)!r}.",
            remedy="Use .nc (netCDF) or .zarr for a whole run that can be opened again, or .npz, "
            ".csv or .parquet for a table.",
        )
    for name in NEEDS[place.suffix]:
        import_library(name, f"a {place.suffix} file", "parquet" if name == "pyarrow" else "data")
    return place.suffix


@explain_methods()
class Tabular:
    """A result that can be converted to a pandas table and an xarray dataset."""

    program: Program
    t: Any

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row for each stored state.

        The index is the time. The columns are positions, momenta, velocities, energies, invariants
        and coordinates of points, or the saved quantities. The columns of a point "bob" are
        ``bob_x`` and so on, or ``point_bob_x`` if ``bob_x`` is a coordinate.

        The index of an ensemble is the member. The table of an ensemble also has columns for its
        parameters, the results of ``reduce`` and t.

        Returns
        -------
        pandas.DataFrame
            The table. Its attribute ``attrs`` has the system, the scheme and the known units.

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
        frame = (
            import_library("pandas", "to_pandas", "data")
            .DataFrame(table)
            .set_index(next(iter(table)))
        )
        frame.attrs = self._attributes() | ({"units": dict(units)} if units else {})
        return frame

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` with the dimensions time and coord.

        The dataset of an ensemble also has the dimension member, and the parameters as coordinates
        of the members. For an ensemble in a store, xarray reads the states when you use them.

        Returns
        -------
        xarray.Dataset
            The dataset. Its attributes have the system, the scheme and the known units.

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
        xarray = import_library("xarray", "to_xarray", "data")
        data = self._read_dataset(xarray)
        if data is not None:
            return data
        variables = {
            x.name: (x.axes, x.values, {"long_name": x.doc} if x.doc else {})
            for x in self._variables()
        }
        data = xarray.Dataset(variables, self._axes(), self._attributes())
        return assign_units(data, self.program.units)

    def _read_dataset(self, xarray: Any) -> Any:
        """Return the dataset of a result that is on disk; None for results in memory."""
        return None

    def _variables(self) -> list[Variable]:
        """Return the quantities of the result, without time and coordinates."""
        raise NotImplementedError

    def _axes(self) -> dict[str, Any]:
        """Return the coordinates of a dataset."""
        return {"time": self.t, "coord": list(self.program.coordinates)}

    def _attributes(self) -> dict[str, Any]:
        """Return the attributes of tables and datasets."""
        return {"system": self.program.system, "scheme": self.program.scheme}

    def _table(self) -> dict[str, Reals]:
        """Return the columns of the table by name; the first column is the index."""
        return build_table({"t": self.t}, self._variables(), self.program)

    def _arrays(self) -> dict[str, Any]:
        """Return the arrays of .npz files."""
        return {"t": self.t, **{x.array: x.values for x in self._variables() if x.array}}


@explain_methods()
class Savable(Tabular):
    """A result that can be saved to a file."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the result to a file, in the format of its extension.

        - ``.nc`` (netCDF) and ``.zarr`` (a Zarr store) contain the dataset of :meth:`to_xarray`.
        - ``.csv`` and ``.parquet`` are tables with the columns of :meth:`to_pandas`.
        - ``.npz`` has the arrays t, q, p, v, energy and points. For an ensemble, it has t, q, p,
          status, parameters and the results of ``reduce``.

        A ``.nc`` or ``.zarr`` file of a :class:`Trajectory` also contains the generated module.
        :func:`symsimpson.open_trajectory` reads such a file. Read all other files with NumPy,
        pandas or xarray.

        Parameters
        ----------
        path : path
            Path of the file, with one of these extensions.

        Raises
        ------
        InputError
            If the extension is unknown, a library is missing, or the stepper has a ``precision``.
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
        what = self._result_kind()
        place = read_path(f"the {what}'s file", path)
        kind = check_kind(place)
        check_folder(place, what, trajectory=self)  # before anything is computed
        arrays = self._arrays()
        if any(np.asarray(x).dtype == object for x in arrays.values()):
            reject(
                f"a {kind} file cannot store numbers of many digits.",
                remedy="Write the arrays q and p to a file of your own.",
            )
        with atomic_path(place, what, trajectory=self) as whole:
            self._write(whole, kind, arrays)

    def _write(self, place: Path, kind: str, arrays: Mapping[str, Any]) -> None:
        """Write a file of a ``kind``, a key of ``NEEDS``."""
        if kind == ".nc":
            self._file_dataset().to_netcdf(place, engine="netcdf4")
        elif kind == ".zarr":
            self._file_dataset().to_zarr(place, mode="w", zarr_format=2)
        elif kind == ".npz":
            np.savez(place, **arrays)
        elif kind == ".csv":
            table = self._table()
            rows = np.column_stack([np.asarray(x, dtype=np.float64) for x in table.values()])
            head = ",".join(f'"{x}"' if set(x) & set(',"\n') else x for x in table)
            np.savetxt(place, rows, delimiter=",", header=head, comments="", fmt="%.17g")
        else:
            pandas = import_library("pandas", "a .parquet file", "data")
            pandas.DataFrame(self._table()).to_parquet(place)

    def _file_dataset(self) -> Any:
        """Return the dataset to write to files."""
        return self.to_xarray()

    def _result_kind(self) -> str:
        """Return the name of the result for messages."""
        return "result"
