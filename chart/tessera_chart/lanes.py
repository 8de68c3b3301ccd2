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
    programs.resume()
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

    threads = [threading.Thread(target=lane) for _ in range(num_lanes)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except KeyboardInterrupt:
        waiting.clear()
        programs.stop()
        for thread in threads:
            thread.join()
        raise
    if errors:
        raise errors[0]
