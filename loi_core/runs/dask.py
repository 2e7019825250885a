"""Executor for a Dask cluster."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, Final, ParamSpec, TypeVar

from loi_core.errors import ExecutorError
from loi_core.support.installed import how_to_install
from loi_core.support.wording import described, shown

__all__ = ["DaskExecutor"]

CONNECT_TIMEOUT_S: Final = 10.0
ArgumentsT = ParamSpec("ArgumentsT")
ResultT = TypeVar("ResultT")


class DaskExecutor(Executor):
    """Executor over the workers of a Dask cluster; needs the extra ``dask``.

    Each thread of a worker executes one run at a time. The scheduler restarts the runs of a lost worker elsewhere, a
    few times. The scheduler and all workers need this library, and the files of the runs under the same paths.

    Parameters
    ----------
    cluster : str or distributed.Client
        Address of the scheduler, such as "tcp://10.0.0.1:8786", or a client, which stays open.

    Raises
    ------
    ExecutorError
        If ``distributed`` is not installed, or no scheduler answers.
    """

    def __init__(self, cluster: Any) -> None:
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            msg = f"runs on Dask need the package {error.name}: {how_to_install('dask')}"
            raise ExecutorError(msg) from None
        self._closes_client = not isinstance(cluster, Client)
        try:
            self._client: Any = (
                Client(cluster, timeout=CONNECT_TIMEOUT_S, set_as_default=False) if self._closes_client else cluster
            )
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            msg = f"no Dask scheduler answers at {shown(cluster)} ({described(error)})"
            raise ExecutorError(msg) from None
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(
        self, fn: Callable[ArgumentsT, ResultT], /, *args: ArgumentsT.args, **kwargs: ArgumentsT.kwargs
    ) -> Future[ResultT]:
        """Call a function on a worker."""
        return self._executor.submit(fn, *args, **kwargs)

    def call_on_all_workers(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function once on every worker that answers."""

        def call() -> None:
            with contextlib.suppress(Exception):  # the cluster may have shut down
                self._client.run(function, *arguments, on_error="ignore")

        thread = threading.Thread(target=call, daemon=True)
        thread.start()
        thread.join(CONNECT_TIMEOUT_S)  # a suspended worker would block forever

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002 - the base's
        """Stop accepting runs, and close the client unless it was passed in."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        if self._closes_client:
            self._client.close()
