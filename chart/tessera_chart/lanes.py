"""Work in a few lanes side by side, that Ctrl-C ends at once."""

import collections
import threading
from typing import Callable, Iterable

from tessera_chart import programs


def run(work: Iterable[Callable[[], None]], num_lanes: int) -> None:
    """Runs all of `work`, in order, `num_lanes` at once; with one lane in this thread.

    Errors: the first that a piece of work raises, KeyboardInterrupt; both end the children that run
    and leave the rest of the work undone.
    """
    waiting = collections.deque(work)
    if num_lanes == 1:
        for piece in waiting:
            piece()
        return
    errors: list[BaseException] = []

    def lane() -> None:
        while not errors:
            try:
                piece = waiting.popleft()
            except IndexError:
                return
            try:
                piece()
            except programs.Stopped:
                return
            except BaseException as error:
                errors.append(error)
                programs.stop()

    threads: list[threading.Thread] = []
    try:
        for _ in range(num_lanes):
            threads.append(threading.Thread(target=lane))
            threads[-1].start()
        for thread in threads:
            thread.join()
    except KeyboardInterrupt:
        waiting.clear()
        _end(threads)
        raise
    finally:
        programs.resume()
    if errors:
        raise errors[0]


def _end(threads: list[threading.Thread]) -> None:
    """Ends the threads' children and waits for them, however often Ctrl-C comes."""
    while True:
        try:
            programs.stop()
            for thread in threads:
                if thread.is_alive():
                    thread.join()
            return
        except KeyboardInterrupt:
            continue
