"""Many runs, side by side: each in a process that can be ended, over any executor, and each on record once.

Nothing here knows what a run is. :mod:`loi_core.sweeps` makes them of scene files.
"""

from loi_core.runs.on_dask import DaskExecutor
from loi_core.runs.records import read_record, write_record
from loi_core.runs.workers import Ended, Workers

__all__ = ["DaskExecutor", "Ended", "Workers", "read_record", "write_record"]
