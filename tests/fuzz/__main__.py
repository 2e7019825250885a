"""Fuzz the library and print what came of it: ``python -m tests.fuzz [FACTOR] [KIND]``.

Makes FACTOR inputs (1000) times the weight of each kind.

Every input is made from its kind and a number, so that a failure can be run again.
"""

from __future__ import annotations

import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from tests.fuzz.claims import check
from tests.fuzz.kinds import KINDS


def main() -> int:
    """Print the table; 1 if a claim does not hold."""
    factor = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    only = sys.argv[2:]
    print(
        "| kind | inputs | what came of them | broken claims | seconds |\n| --- | --- | --- | --- | --- |", flush=True
    )
    total = broken = 0
    with tempfile.TemporaryDirectory() as root:
        for kind in KINDS:
            if only and kind.name not in only:
                continue
            outcomes: Counter[str] = Counter()
            failures, start = 0, time.monotonic()
            for seed in range(factor * kind.weight):
                try:
                    outcomes[check(kind, seed, Path(root))] += 1
                except BaseException as error:
                    if type(error) is KeyboardInterrupt:
                        raise
                    failures += 1
                    if failures <= 5:
                        traceback.print_exc()
            listed = ", ".join(f"{name} {count}" for name, count in outcomes.most_common())
            seconds = time.monotonic() - start
            print(f"| {kind.name} | {factor * kind.weight} | {listed} | {failures} | {seconds:.0f} |", flush=True)
            total += factor * kind.weight
            broken += failures
    print(f"\n{total} inputs, {broken} broken claims")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
