"""Time the import of the core beside NumPy: ``python -m benchmarks.importing``.

Prints medians of processor time in fresh processes.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Final

import numpy as np

TIMES: Final = 11
CODE: Final = """
import time
start = time.process_time()
import numpy
between = time.process_time()
import loi_core
print(between - start, time.process_time() - between)
"""


def seconds() -> tuple[float, float]:
    """Seconds to import NumPy, and the core after it; a first process, which compiles the modules, is not counted."""
    runs = [subprocess.run([sys.executable, "-c", CODE], capture_output=True, check=True) for _ in range(TIMES + 1)]
    numpys, cores = np.median([np.array(run.stdout.split(), dtype=np.float64) for run in runs[1:]], axis=0)
    return float(numpys), float(cores)


def main() -> int:
    """Print the table."""
    numpys, cores = seconds()
    print("| import | ms | over NumPy |\n| --- | --- | --- |")
    print(f"| NumPy | {1e3 * numpys:.0f} | 1 |\n| loi_core after it | {1e3 * cores:.0f} | {cores / numpys:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
