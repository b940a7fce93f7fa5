"""A long campaign: python tests/support/fuzz.py --systems 10000.

Each system is held against mpmath.
"""

import argparse
import multiprocessing
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))


def check(seed):
    """Residual and Jacobian against differences of L_d in 60 digits; gives what went wrong."""
    from unit.lower.test_random_systems import check_equations

    try:
        check_equations(seed)
    except Exception as error:  # whatever it is, it is reported with its seed
        return seed, f"{type(error).__name__}: {error}"
    return seed, None


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=1000, help="first seed (default: 1000)")
    parser.add_argument("--processes", type=int, default=None)
    options = parser.parse_args()
    seeds, wrong, begun = range(options.first, options.first + options.systems), 0, time.time()
    # SymPy remembers much: processes are replaced now and then
    with multiprocessing.Pool(options.processes, maxtasksperchild=100) as pool:
        for done, (seed, problem) in enumerate(pool.imap_unordered(check, seeds), 1):
            if problem:
                wrong += 1
                print(f"seed {seed}: {problem[:300]}", flush=True)
            if done % 500 == 0:
                print(f"{done} systems, {wrong} wrong, {time.time() - begun:.0f} s", flush=True)
    print(f"{len(seeds)} systems, {wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
