"""What an installation says of itself."""

import numba
import pytest

import symsimpson as ss


def test_config_is_told_and_printed(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(tmp_path))  # which others do not write to
    found = ss.show_config("dicts")
    assert found["versions"]["numba"] == numba.__version__
    assert found["machine"]["threads"] >= 1
    assert found["machine"]["vector bits"] in (128, 256, 512)
    assert ss.show_config() is None
    printed = capsys.readouterr().out
    for group in found.values():
        assert all(str(value) in printed for value in group.values())
    with pytest.raises(ss.InputError, match="'stdout' to print"):
        ss.show_config("json")
