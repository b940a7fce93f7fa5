"""Operations of kernels, as they are left when their text was walked and LLVM has done its part.

``python -m support.operations``, in tests, writes the table anew.
"""

from __future__ import annotations

import csv
import re
from collections import Counter

import llvmlite
import llvmlite.binding as llvm
from llvmlite import ir

from support.places import DATA
from symsimpson.errors import SchemeError
from symsimpson.lower.pipeline import derive, source
from symsimpson.systems import CATALOGUE, EVERY
from symsimpson.targets.llvm.control_flow import Calls
from symsimpson.targets.llvm.memory import Array, BlockBuilder
from symsimpson.targets.llvm.trees import ARGUMENTS, read_text
from symsimpson.targets.llvm.values import DOUBLE
from symsimpson.targets.llvm.walker import Walker

#: Instructions that are counted, and intrinsics by their names.
COUNTED = re.compile(r"= (?:\w+ )*?(fadd|fsub|fmul|fdiv|call [^@]*@(?:llvm\.)?([a-z]+))")
#: Calls that compute something; others are marks.
CALLED = ("fmuladd", "fma", "sqrt", "exp", "log", "pow", "tan", "sinh", "cosh", "tanh", "erf")


def _of_math(builder, function, arguments):
    """Call a function of ``math`` by its name."""
    module = builder.module
    made = module.globals.get(function.__name__)
    if made is None:
        kind = ir.FunctionType(DOUBLE, [DOUBLE] * len(arguments))
        made = ir.Function(module, kind, function.__name__)
    return builder.call(made, arguments)


def operations(text, name):
    """Count the operations of a kernel on one lane; loops that stay loops are counted once."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = ir.Module("counted")
    module.triple = llvm.get_default_triple()
    kind = ir.FunctionType(ir.VoidType(), [DOUBLE, DOUBLE, DOUBLE.as_pointer()])
    made = ir.Function(module, kind, "kernel")
    builder = BlockBuilder(made.append_basic_block("entry"))
    rows = Array(made.args[2], (None, 1), (1, 1), values=True)
    h, t, _ = made.args
    Walker(read_text(text), Calls(builder), _of_math).kernel(name, h, t, rows, vector=False)
    builder.ret_void()
    parsed = llvm.parse_assembly(str(module))
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.slp_vectorization = options.loop_vectorization = options.loop_unrolling = False
    builder_of_passes = llvm.create_pass_builder(machine, options)
    builder_of_passes.getModulePassManager().run(parsed, builder_of_passes)
    found = Counter()
    for line in str(parsed).splitlines():
        match = COUNTED.search(line)
        if match and (match[2] is None or match[2] in CALLED):
            found[match[2] or match[1]] += 1
    return found.total() + found["fmuladd"] + found["fma"]  # a fused one is two


#: What the table has; a composition stands for all kicks and drifts.
SCHEMES = ("midpoint", "simpson", "lobatto6", "gauss4", "gauss6", "gauss16", "blanes_moan4")
#: The catalogue, systems with constraints and inputs, and one with a time transformation.
SYSTEMS = {
    **CATALOGUE,
    **{name: EVERY[name] for name in ("four_bar", "hanging_chain", "driven_cart_pole")},
    "kepler_retimed": lambda: CATALOGUE["kepler"]().retimed("encounters"),
}
#: Kernels that modules have only if derivatives are wanted.
OF_DERIVATIVES = ("tangent", "adjoint")
TABLE = DATA / "operations.csv"


def all_operations(system, scheme):
    """Count the operations of all kernels of a module; nothing for what has no such steps."""
    declared = SYSTEMS[system]()
    try:
        text = source(declared, scheme)
    except SchemeError:
        return {}
    counts = {name: operations(text, name) for name in kernels(text)}
    try:
        differentiated = derive(declared, scheme, varied=()).text
    except SchemeError:  # of kicks and drifts there are no derivatives
        return counts
    wanted = [name for name in kernels(differentiated) if name in OF_DERIVATIVES]
    return counts | {name: operations(differentiated, name) for name in wanted}


def kernels(text):
    """Return the names of the kernels of a module."""
    functions = read_text(text).functions
    return [k for k, f in functions.items() if [a.arg for a in f.args.args] == ARGUMENTS]


def table():
    """Read the table, and the version of LLVM that it was made with."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        made_with = file.readline().strip("# \n")
        rows = list(csv.DictReader(file))
    found = {}
    for row in rows:
        found.setdefault((row["system"], row["scheme"]), {})[row["kernel"]] = int(row["operations"])
    return made_with, found


if __name__ == "__main__":
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        file.write(f"# llvmlite {llvmlite.__version__}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["system", "scheme", "kernel", "operations"])
        for one in sorted(SYSTEMS):
            for scheme in SCHEMES:
                for kernel, count in all_operations(one, scheme).items():
                    writer.writerow([one, scheme, kernel, count])
