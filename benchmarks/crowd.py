"""Pretend workers of a Dask cluster: many in one process, which speak a worker's protocol and compute nothing.

``python -m benchmarks.crowd tcp://127.0.0.1:8786 --workers 1000 --seconds 2`` joins a scheduler as a thousand
workers of one thread. Each has an address and a connection of its own, takes one task at a time, and says after some
two seconds that it is done. The scheduler gets over the network what it gets of real workers, and heartbeats at their
intervals. Two things differ: heartbeats share a few connections, where a worker has one for its own, and all workers
share this process.

Prints one line of JSON once all have joined, and ends with its standard input.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import pickle
import random
import sys
import time
import traceback
from collections import deque
from typing import Any, Final

from distributed.batched import BatchedSend
from distributed.comm import connect
from distributed.core import Server, Status
from distributed.protocol import to_serialize
from distributed.scheduler import heartbeat_interval
from distributed.system_monitor import SystemMonitor
from distributed.versions import get_versions
from tornado.ioloop import IOLoop

from loi_core.runs.reply import Reply

__all__ = ["SPREAD", "main"]

AT_ONCE: Final = 32  # workers that join at the same time
HEARTBEATS: Final = 32  # connections for them
SPREAD: Final = 0.5
"""Fits differ by as much from their mean, relative to it. If all ended at once, that would be what is measured."""
FIT: Final = {  # what a sweep keeps of a fit
    "objective": "loi",
    "verdict": "converged",
    "psnr": 48.123456789012345,
    "psnr_initial": 9.123456789012345,
    "value": 1.23456789012345e-05,
    "errors": {"positions": 0.0123456789012345},
    "best_step": 199,
    "steps": 200,
    "seconds": 1.23456789012345,
    "cause": "",
}
DONE: Final = Reply(pickle.dumps(FIT))
ALLOWED: Final = Reply(pickle.dumps(""))  # what there is to say against a scene that is allowed
CHECK: Final = b"refusal"  # the function that looks for something


class Crowd:
    """The workers, and what they share.

    Parameters
    ----------
    scheduler : str
        Its address.
    count : int
        How many workers.
    seconds : float
        What they take for a fit, in the mean: from half of it to half as much again.
    """

    def __init__(self, scheduler: str, count: int, seconds: float) -> None:
        self.scheduler, self.count, self.seconds = scheduler, count, seconds
        self.random = random.Random(0)  # noqa: S311 - nothing is kept secret by it
        self.results: dict[Any, Reply] = {}
        self.most_bytes = 0  # of a task
        self._server = Server({"get_data": self._get_data, "run": self._run}, connection_limit=HEARTBEATS)
        self._monitor = SystemMonitor()
        self._looked = 0.0
        self._workers: list[Worker] = []

    async def join(self) -> None:
        """Have all of them join; they beat from then on."""
        await self._server.listen("tcp://0.0.0.0:0")
        port = self._server.port
        versions = get_versions()
        waiting = iter(range(self.count))
        # From the start: it takes minutes until thousands have joined, and a scheduler drops who is not heard of.
        self._beating = [asyncio.create_task(self._beat(part)) for part in range(HEARTBEATS)]

        async def some() -> None:
            for index in waiting:
                address = f"tcp://127.{1 + index // 62500}.{index // 250 % 250}.{1 + index % 250}:{port}"
                worker = Worker(self, address)
                await worker.join(versions, self.metrics())
                self._workers.append(worker)

        await asyncio.gather(*(some() for _ in range(AT_ONCE)))

    def metrics(self) -> dict[str, Any]:
        """What a worker tells of itself."""
        if time.monotonic() > self._looked + 1.0:  # it counts the open files, of which there are thousands
            self._monitor.update()
            self._looked = time.monotonic()
        counts = ("bytes", "count", "count_total")
        transfers = [f"{way}_{count}" for way in ("incoming", "outgoing") for count in counts]
        return {
            "task_counts": {"executing": 1},
            "bandwidth": {"total": 100000000, "workers": {}, "types": {}},
            "digests_total_since_heartbeat": {("execute", "watch", "thread-cpu", "seconds"): 0.01, "latency": 0.001},
            "managed_bytes": 0,
            "spilled_bytes": {"memory": 0, "disk": 0},
            "transfer": dict.fromkeys(transfers, 0),
            "event_loop_interval": 0.02,
            **self._monitor.recent(),
        }

    async def _beat(self, part: int) -> None:
        """The heartbeats of some workers, one after another, each as often as the scheduler wants them."""
        while True:
            own = self._workers[part::HEARTBEATS]
            pause = heartbeat_interval(len(self._workers)) / max(1, len(own))
            if not own:
                await asyncio.sleep(pause)
            for worker in own:
                await asyncio.sleep(pause)
                started = time.time()
                running = {} if worker.running is None else {worker.running: started - worker.begun}
                await self._server.rpc(self.scheduler).heartbeat_worker(
                    address=worker.address, now=started, metrics=self.metrics(), executing=running, extensions={}
                )

    # Its arguments are those of the method that it replaces.
    async def _get_data(self, comm: Any, keys: Any, who: Any = None, serializers: Any = None) -> Status:  # noqa: ARG002
        data = {key: to_serialize(self.results[key]) for key in keys if key in self.results}
        await comm.write({"status": "OK", "data": data}, serializers=serializers)
        await comm.read(deserializers=serializers)
        return Status.dont_reply

    # Its arguments are those of the method that it replaces.
    async def _run(self, comm: Any, function: Any, args: Any = (), kwargs: Any = None, wait: bool = True) -> Any:  # noqa: ARG002, FBT001, FBT002
        """Told to all: there are no processes to end."""
        return {"status": "OK", "result": to_serialize(None)}


class Worker:
    """One of them.

    Parameters
    ----------
    crowd : Crowd
    address : str
        Where it says that it can be reached.
    """

    def __init__(self, crowd: Crowd, address: str) -> None:
        self.address = address
        self.running: Any = None  # the key of a task
        self.begun = 0.0
        self._crowd = crowd
        self._waiting: deque[dict[str, Any]] = deque()
        self._out = BatchedSend(interval="2ms", loop=IOLoop.current())

    async def join(self, versions: Any, metrics: dict[str, Any]) -> None:
        """Become a worker of the scheduler."""
        self._comm = await connect(self._crowd.scheduler, timeout=300, deserialize=False)
        await self._comm.write(
            {
                "op": "register-worker",
                "reply": False,
                "address": self.address,
                "status": "running",
                "nthreads": 1,
                "name": self.address,
                "now": time.time(),
                "resources": {},
                "memory_limit": 2**32,
                "local_directory": "",
                "services": {},
                "nanny": None,
                "pid": os.getpid(),
                "versions": versions,
                "metrics": metrics,
                "extra": {},
                "stimulus_id": f"worker-connect-{time.time()}",
                "server_id": f"Worker-{self.address}",
            },
            serializers=["msgpack"],
        )
        answer = await self._comm.read(deserializers=["msgpack"])
        if answer["status"] != "OK":
            raise RuntimeError(str(answer))
        self._out.start(self._comm)
        self._listening = asyncio.create_task(self._listen())
        self._listening.add_done_callback(_end_if_failed)

    async def _listen(self) -> None:
        with contextlib.suppress(OSError):  # the scheduler has ended
            while True:
                for message in await self._comm.read():
                    self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        match message["op"]:
            case "compute-task":
                self._waiting.append(message)
                self._begin()
            case "steal-request":
                mine = any(one["key"] == message["key"] for one in self._waiting)
                state = "ready" if mine else "executing" if message["key"] == self.running else None
                self._drop({message["key"]})
                self._say("steal-response", key=message["key"], state=state, stimulus_id=message["stimulus_id"])
            case "free-keys" | "remove-replicas":
                self._drop(set(message["keys"]))
                for key in message["keys"]:
                    self._crowd.results.pop(key, None)
            case "cancel-compute":
                self._drop({message["key"]})

    def _drop(self, keys: set[Any]) -> None:
        self._waiting = deque(one for one in self._waiting if one["key"] not in keys)

    def _begin(self) -> None:
        if self.running is not None or not self._waiting:
            return
        message = self._waiting.popleft()
        self.running, self.begun = message["key"], time.time()
        payload = message["run_spec"].args[1]  # of `loi_core.runs.processes.watch`
        self._crowd.most_bytes = max(self._crowd.most_bytes, len(payload))
        check = CHECK in payload
        later = asyncio.get_running_loop().call_later
        seconds = 0.0 if check else self._crowd.seconds * self._crowd.random.uniform(1.0 - SPREAD, 1.0 + SPREAD)
        later(seconds, self._end, message, ALLOWED if check else DONE)

    def _end(self, message: dict[str, Any], result: Reply) -> None:
        self._crowd.results[message["key"]] = result
        self._say(
            "task-finished",
            key=message["key"],
            run_id=message["run_id"],
            stimulus_id=f"task-finished-{time.time()}",
            nbytes=len(result.value or b""),
            type=pickle.dumps(Reply),
            typename="loi_core.runs.reply.Reply",
            metadata={},
            thread=1,
            startstops=[{"action": "compute", "start": self.begun, "stop": time.time()}],
            status="OK",
        )
        self.running = None
        self._begin()

    def _say(self, op: str, **content: Any) -> None:
        with contextlib.suppress(OSError):  # the scheduler has ended
            self._out.send({"op": op, **content})


def _end_if_failed(task: asyncio.Task[None]) -> None:
    """Nobody waits for what workers do, so nobody would hear of it."""
    if not task.cancelled() and task.exception() is not None:
        traceback.print_exception(task.exception())
        os._exit(1)


async def _serve(options: argparse.Namespace) -> None:
    started = time.perf_counter()
    crowd = Crowd(options.scheduler, options.workers, options.seconds)
    await crowd.join()
    print(json.dumps({"workers": options.workers, "seconds": time.perf_counter() - started}), flush=True)
    await asyncio.to_thread(sys.stdin.read)
    print(json.dumps({"most bytes of a task": crowd.most_bytes}), flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Join a scheduler, and stay until standard input ends."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crowd", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scheduler", help="its address, such as tcp://127.0.0.1:8786")
    parser.add_argument("--workers", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=1.0, help="that a fit takes")
    asyncio.run(_serve(parser.parse_args(arguments)))
    return 0


if __name__ == "__main__":
    sys.stdout.flush()
    code = main()
    sys.stdout.flush()
    os._exit(code)  # closing thousands of connections in good order takes longer than all else
