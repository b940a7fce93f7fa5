"""Vectors are as wide as the machine has them, or as is asked for."""

import re

import llvmlite.binding as llvm
import numpy as np
import pytest
from support.workspace import walked

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.program.configuration import VARIABLE, vector_bits

WIDE = llvm.get_host_cpu_features().get("avx512f", False)


def iteration(bits, monkeypatch):
    """The assembly of an iteration whose nodes fill one register of 512 bits."""
    monkeypatch.setenv(VARIABLE, bits)
    text = source(ss.systems.double_pendulum(), "gauss16")
    return walked(text, ["iterate"], bits=int(bits))["iterate"]._library.get_asm_str()


@pytest.mark.skipif(not WIDE, reason="this machine has no vectors of 512 bits")
def test_all_registers_are_used_unless_others_are_asked_for(monkeypatch):
    wide_text, narrow = (iteration(bits, monkeypatch) for bits in ("512", "256"))
    packed = r"\bv(?:add|mul|sub|div|fn?m(?:add|sub)\w*)pd\b.*%zmm"
    assert len(re.findall(packed, wide_text)) > 60
    assert "%zmm" not in narrow


def test_widths_are_read(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    most = vector_bits()
    assert most == (512 if WIDE else most)
    monkeypatch.setenv(VARIABLE, "128")
    assert vector_bits() == 128
    monkeypatch.setenv(VARIABLE, "512")
    assert vector_bits() == most  # no more than there are
    for wrong in ("wide", "64", ""):
        monkeypatch.setenv(VARIABLE, wrong)
        with pytest.raises(ss.InputError, match="128, 256, 512"):
            vector_bits()


@pytest.mark.slow
def test_states_differ_by_rounding_alone(monkeypatch):
    ends = []
    for bits in ("128", "512"):
        monkeypatch.setenv(VARIABLE, bits)
        stepper = ss.compile(ss.systems.double_pendulum(), "gauss16")
        ends.append(stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.05, steps=20, every=None).q[0])
    assert np.abs(ends[0] - ends[1]).max() < 1e-14
