"""Connection to a Dask cluster."""

from __future__ import annotations

from typing import Any, Final

from loi_core.errors import ExecutorError
from loi_core.support.installed import how_to_install
from loi_core.support.wording import described, shown

__all__ = ["CONNECT_TIMEOUT_S", "connect"]

CONNECT_TIMEOUT_S: Final = 10.0


def connect(cluster: Any) -> Any:
    """Return a ``distributed.Client`` of a cluster, or of the scheduler at an address such as "tcp://10.0.0.1:8786".

    Raises
    ------
    ExecutorError
        If ``distributed`` is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        msg = f"runs on Dask need the package {error.name}: {how_to_install('dask')}"
        raise ExecutorError(msg) from None
    try:
        return Client(cluster, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        msg = f"no Dask scheduler answers at {shown(cluster)} ({described(error)})"
        raise ExecutorError(msg) from None
