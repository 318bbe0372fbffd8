"""Who runs the blocks of a sweep: this process, others beside it, or the workers of a Dask scheduler."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from workbench.errors import InputError
from workbench.provenance import versions
from workbench.sweeps.design import Point
from workbench.sweeps.job import PASSING, Job

LONGEST, BLOCK = 256, 0.5  # runs of a block, and s that it should take
WAITED = 10.0  # s that a scheduler is waited for


def answered(
    job: Job, todo: Sequence[Point], jobs: int, scheduler: str | None
) -> Iterator[tuple[Sequence[Point], list[Any], float]]:
    """Blocks of points with their answers, in the order in which they are done; blocks grow to BLOCK seconds."""
    if not todo:
        return
    with _workers(jobs, scheduler) as (count, spread):
        size, taken = [1], [0]

        def blocks() -> Iterator[Sequence[Point]]:
            while taken[0] < len(todo):
                own = todo[taken[0] : taken[0] + size[0]]
                taken[0] += len(own)
                yield own

        for block, answers, seconds in spread(job, blocks()):
            fair = max(1, (len(todo) - taken[0]) // (2 * count)) if count > 1 else LONGEST  # the last ones end together
            size[0] = max(1, min(LONGEST, fair, 2 * len(block), round(BLOCK * len(block) / max(seconds, 1e-6))))
            yield block, answers, seconds


@contextmanager
def _workers(jobs: int, scheduler: str | None) -> Iterator[tuple[int, Callable[[Job, Iterable[Sequence[Point]]], Iterable[Any]]]]:
    """How many run side by side, and what sends them blocks and gives the answers."""
    if jobs == 1 and scheduler is None:
        yield 1, lambda job, blocks: (_block(job, block) for block in blocks)
        return
    from joblib import Parallel, delayed, parallel_config

    def spread(job: Job, blocks: Iterable[Sequence[Point]], count: int) -> Iterable[Any]:
        pool: Any = Parallel(n_jobs=count, return_as="generator_unordered", pre_dispatch=f"2 * {count}")
        return pool(delayed(_block)(job, block) for block in blocks)

    if scheduler is None:
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        try:
            yield jobs, partial(spread, count=jobs)
        except TerminatedWorkerError:
            mend = "--resume --jobs 1 goes on, and shows at which run; is there enough memory?"
            raise InputError("a run has ended its whole process", file="sweep", mend=mend) from None
        return
    with _cluster(scheduler) as count, parallel_config(backend="dask"):
        yield count, partial(spread, count=count)


@contextmanager
def _cluster(scheduler: str) -> Iterator[int]:
    """Threads of all workers of a Dask scheduler, which must have this very software, and be asked by joblib from now on."""
    try:
        from distributed import Client
    except ImportError:
        mend = 'python -m pip install "gain-scheduling-workbench[cluster]"'
        raise InputError("Dask is not installed", file=scheduler, mend=mend) from None
    try:
        client: Any = Client(scheduler, timeout=WAITED)
    except (OSError, ValueError, TypeError) as reason:
        mend = "start one with `dask scheduler`, and give the address that it prints: tcp://HOST:8786"
        raise InputError(f"no Dask scheduler: {reason}", file=scheduler, mend=mend) from None
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError("the scheduler has no workers", file=scheduler, mend=f"start some: dask worker {scheduler}")
        for worker, theirs in client.run(versions).items():
            if other := [f"{name} {theirs.get(name)}, here {own}" for name, own in versions().items() if theirs.get(name) != own]:
                mend = "install the same versions there: rows would not be those of one machine"
                raise InputError(f"worker {worker} has {'; '.join(other)}", file=scheduler, mend=mend)
        yield threads


def _block(job: Job, block: Sequence[Point]) -> tuple[Sequence[Point], list[Any], float]:
    """One block, with BLAS on one thread; what goes wrong for all of them is looked for in each by itself."""
    from threadpoolctl import threadpool_limits

    began = time.perf_counter()
    with threadpool_limits(1):
        try:
            answers = job(block)
        except PASSING:
            raise
        except Exception as reason:
            answers = [_alone(job, point) for point in block] if len(block) > 1 else [reason]
    plain = [_said(a) if isinstance(a, Exception) else {k: float(v) for k, v in a.items()} for a in answers]
    return block, plain, time.perf_counter() - began


def _alone(job: Job, point: Point) -> Any:
    try:
        return job([point])[0]
    except PASSING:
        raise
    except Exception as reason:
        return reason


def _said(reason: Exception) -> str:
    text = str(reason) or type(reason).__name__
    return text if isinstance(reason, InputError) else f"{type(reason).__name__}: {text}"
