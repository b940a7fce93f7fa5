"""Where the folders of the repository are."""

from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
DATA = TESTS / "data"
GENERATED = ROOT / "generated"
NOTEBOOKS = ROOT / "notebooks"
PACKAGE = ROOT / "symsimpson"
