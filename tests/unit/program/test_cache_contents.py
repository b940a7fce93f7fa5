"""The cache on disk: its size, and how it is emptied beside files of others and other processes."""

import shutil

import pytest
from filelock import FileLock

import symsimpson as ss
from symsimpson.program import cache
from symsimpson.program.cache import load_or_make, usage

KEY = "newton-4_" + "0123456789abcdef" * 2


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(place))
    monkeypatch.setattr(cache, "_results", {})
    return cache.cache_folder()


def build(folder, key=KEY):
    """Build an entry as a first call does."""
    cache._build(folder, key, "x = 1\n", lambda module, keep: module.x)


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_what_the_package_wrote_is_removed_and_nothing_else(folder):
    others = [
        "thesis.tex",
        "choices/notes.json",
        f"folder_{'0' * 32}/data.txt",
        f"blobs/{'0' * 64}.json",
        ".building-mine/plan.txt",
        f"symsimpson_{'1' * 32}/symsimpson_compiled_symsimpson_{'1' * 32}.py",
        f"symsimpson_{'1' * 32}/notes.txt",
        f"{KEY[:-1]}0/symsimpson_compiled_other.py",
    ]
    for name in others:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("years of work")
    (folder / f"link_{'0' * 32}").symlink_to(folder / "blobs")
    before = files(folder)
    assert usage(folder) == (0, 0)
    assert ss.clear_cache() == 0
    build(folder)
    load_or_make("choices", "which", lambda x: x, lambda: 1, lambda x: x)
    load_or_make("texts", "which", lambda x: x, lambda: 1, lambda x: x)
    left = folder / ".building-left" / f"symsimpson_compiled_{KEY}.py"
    left.parent.mkdir()
    left.write_text("x = 1\n")
    count, size = usage(folder)
    assert count == 1
    config = ss.show_config("dicts")["compiled code"]
    assert config["entries"] == 1
    assert config["size"] == "0.0 MB"
    written = [*(folder / KEY).rglob("*"), left]
    assert size == sum(path.stat().st_size for path in written) + 2 * len("1")
    assert ss.clear_cache() == size
    assert [name for name in files(folder) if not name.startswith(".lock")] == before
    assert ss.clear_cache() == 0


def test_what_another_process_builds_stays_and_nobody_waits(folder):
    building = folder / ".building-now" / f"symsimpson_compiled_{KEY}.py"
    building.parent.mkdir()
    building.write_text("x = 1\n")
    with FileLock(cache.lock_file(folder, KEY)):
        assert ss.clear_cache() == 0
        assert building.exists()
    assert ss.clear_cache() == len("x = 1\n")
    assert not building.parent.exists()


def test_an_entry_that_goes_while_it_is_loaded_is_built_again(folder, monkeypatch):
    build(folder)
    plain = cache._intact

    def intact(entry):
        whole = plain(entry)
        ss.clear_cache()
        return whole

    monkeypatch.setattr(cache, "_intact", intact)
    text, use = "x = 1\n", lambda module, keep: module.x
    assert cache._load_or_build(text, KEY, use) == 1
    shutil.rmtree(folder / KEY)  # it was built again
    assert cache._load_or_build(text, KEY, use) == 1
