"""``python -m symsimpson``."""

from symsimpson.cli import main

raise SystemExit(main())
