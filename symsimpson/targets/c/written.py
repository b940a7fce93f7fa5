"""The files of a stepper in C: their names, and that they are written whole."""

from __future__ import annotations

import os
import re
from pathlib import Path

from symsimpson.errors import InputError
from symsimpson.program.program import Program
from symsimpson.support.files import read_path, write_text
from symsimpson.targets.c.source import written_c
from symsimpson.targets.c.statements import WORDS

#: Names of C, but for those that belong to the compiler.
NAME = re.compile("[A-Za-z][A-Za-z0-9_]*", re.ASCII)


def write_files(program: Program, path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Write the header and the source file of a stepper; raises InputError or StorageError."""
    place = read_path("path", path)
    name = place.name.removesuffix(".c").removesuffix(".h")
    if not NAME.fullmatch(name) or name in {*WORDS, "math"}:
        raise InputError(
            f"path is {os.fspath(path)!r}, and {name!r} begins no name of C.\n"
            "Take letters and digits, and a letter first: 'firmware/top'."
        )
    texts = written_c(program, name)
    paths = place.with_name(f"{name}.h"), place.with_name(f"{name}.c")
    for target, text in zip(paths, texts, strict=True):
        write_text(target, text, "C file")
    return paths
