"""Kernels have no more operations than the table of them says."""

import llvmlite
import pytest
from support.cases import sweep
from support.operations import SCHEMES, SYSTEMS, all_operations, table

MADE_WITH, TABLE = table()


@pytest.mark.skipif(
    f"llvmlite {llvmlite.__version__}" != MADE_WITH, reason="counts of another LLVM"
)
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
@pytest.mark.parametrize("system", sweep(sorted(SYSTEMS)))
def test_no_kernel_has_more_operations_than_before(system, scheme):
    """A table that is written anew, by ``python -m support.operations``, shows what changed."""
    found = all_operations(system, scheme)
    assert found.keys() == TABLE.get((system, scheme), {}).keys()
    more = {name: count for name, count in found.items() if count > TABLE[system, scheme][name]}
    assert not more
