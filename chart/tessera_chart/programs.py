"""Runs programs as children and says what they took. A child dies with the run that started it."""

import dataclasses
import functools
import hashlib
import json
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile
import threading

from tessera_chart.errors import BadInput


_lock = threading.Lock()
_running: set[subprocess.Popen] = set()
_stopped = False


class Stopped(Exception):
    """The run was stopped while a child ran, or before it was started."""


def stop() -> None:
    """Ends the children of all threads, and lets none start any more until `resume`."""
    global _stopped
    with _lock:
        _stopped = True
        for child in _running:
            child.send_signal(signal.SIGKILL)


def resume() -> None:
    global _stopped
    _stopped = False


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A child that ended well."""

    stdout: str
    cpu_s: float  # user and system, all its threads
    peak_bytes: int  # of resident memory


def run(command: list[str], variables: dict[str, str] | None = None) -> Outcome:
    """Runs `command` to its end, with `variables` added to the environment; from any thread.

    Errors: BadInput if it cannot be started or fails, with its last line on stderr; Stopped.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        # A session of its own: Ctrl-C reaches this program alone, which then ends the child.
        with _lock:
            if _stopped:
                raise Stopped
            try:
                child = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True,
                                         env=dict(os.environ, **variables) if variables else None)
            except OSError as error:
                raise BadInput(f"{command[0]}: cannot be started: {error.strerror}") from error
            _running.add(child)
        try:
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        except BaseException:
            child.send_signal(signal.SIGKILL)
            child.wait()
            raise
        finally:
            with _lock:
                _running.discard(child)
        if _stopped:
            raise Stopped
        out.seek(0)
        err.seek(0)
        text = out.read().decode("utf-8", errors="replace")
        lines = err.read().decode("utf-8", errors="replace").strip().splitlines()
    if child.returncode != 0:
        said = lines[-1] if lines else f"exit code {child.returncode}"
        raise BadInput(f"{pathlib.Path(command[0]).name} {command[1] if command[1:] else ''}: {said}")
    return Outcome(text, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def digest_of(file: str | pathlib.Path) -> str:
    """Of a file's content; read again only when its time or size has changed. Errors: OSError."""
    status = os.stat(file)
    return _digest_at(os.path.realpath(file), status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=None)
def _digest_at(path: str, _mtime_ns: int, _size: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Tessera:
    """The program tessera."""

    def __init__(self, path: str | None):
        """`path`, or the program of the environment's TESSERA, or that on the PATH.

        Errors: BadInput if there is none.
        """
        self.path = path or os.environ.get("TESSERA") or shutil.which("tessera")
        if self.path is None or not os.access(self.path, os.X_OK):
            raise BadInput(f"--tessera {self.path or ''}: no program tessera; give its path")

    def run(self, *arguments) -> tuple[dict, float]:
        """Runs it with --json; returns its object and the CPU seconds of the process."""
        outcome = run([self.path, *map(str, arguments), "--json"])
        return json.loads(outcome.stdout), outcome.cpu_s

    def peak_bytes(self, *arguments) -> int:
        """Runs it; returns the most resident memory that it had."""
        return run([self.path, *map(str, arguments)]).peak_bytes

    @functools.lru_cache(maxsize=None)
    def version(self) -> str:
        return run([self.path, "--version"]).stdout.strip()

    def identity(self) -> str:
        """Another one for another program. The version alone does not cover all that is compiled
        into it; behind an installed launcher, which is always the same file, it has to do."""
        return f"{self.version()}, {digest_of(self.path)}"

    def denoisers(self) -> list[dict]:
        """The filters: name, halo_px by quality, options."""
        return self.run("denoise", "--list")[0]["denoisers"]
