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
    # Not Thread.join: interrupted by Ctrl-C it takes a running thread for one that has ended.
    ended = [threading.Event() for _ in range(num_lanes)]
    started: list[threading.Event] = []

    def next_piece() -> Callable[[], None] | None:
        try:
            return waiting.popleft()
        except IndexError:
            return None

    def lane(end: threading.Event) -> None:
        try:
            while not errors and (piece := next_piece()):
                piece()
        except programs.Stopped:
            pass
        except BaseException as error:
            errors.append(error)
            programs.stop()
        finally:
            end.set()

    try:
        for end in ended:
            started.append(end)
            threading.Thread(target=lane, args=(end,)).start()
        _wait(ended)
    except KeyboardInterrupt:
        waiting.clear()
        _stop_and_wait(started)
        raise
    finally:
        programs.resume()
    if errors:
        raise errors[0]


def _stop_and_wait(ended: list[threading.Event]) -> None:
    """Ends the lanes' children and waits for the lanes, however often Ctrl-C comes."""
    while True:
        try:
            programs.stop()
            _wait(ended)
            return
        except KeyboardInterrupt:
            continue


def _wait(ended: list[threading.Event]) -> None:
    """Waits for all; looks up now and then, for a signal may reach another thread than this."""
    for end in ended:
        while not end.wait(timeout=1):
            pass
