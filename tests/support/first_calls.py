"""Print what a first compile and a first integrate execute: run in a process of its own.

Functions and files of the package, as JSON, and the modules that are loaded afterwards.
"""

import json
import sys
from pathlib import Path

import symsimpson as ss

PACKAGE = str(Path(ss.__file__).parent)


def executed(call):
    """Return the functions and files of the package that a call executes, and its result."""
    seen = set()

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
            seen.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    sys.setprofile(note)
    try:
        result = call()
    finally:
        sys.setprofile(None)
    return [len(seen), len({file for file, _ in seen})], result


if __name__ == "__main__":
    system = ss.systems.double_pendulum()
    compiling, stepper = executed(lambda: ss.compile(system, "simpson"))
    running, _ = executed(lambda: stepper.integrate([1.0, 0.5], v0=[0.0, 0.0], h=0.01, steps=10))
    loaded = sum(name.split(".")[0] == "symsimpson" for name in sys.modules)
    print(json.dumps([*compiling, *running, loaded]))
