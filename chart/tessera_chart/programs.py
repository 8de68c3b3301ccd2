"""Runs programs as children and says what they took. A child dies with the run that started it."""

import dataclasses
import json
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile

from tessera_chart.errors import BadInput


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A child that ended well."""

    stdout: str
    cpu_s: float  # user and system, all its threads


def run(command: list[str]) -> Outcome:
    """Runs `command` to its end. Errors: BadInput with its last line on stderr."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        # A session of its own: Ctrl-C reaches this program alone, which then ends the child.
        child = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True)
        try:
            _, status, usage = os.wait4(child.pid, 0)
        except BaseException:
            child.send_signal(signal.SIGKILL)
            child.wait()
            raise
        child.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        text = out.read().decode("utf-8", errors="replace")
        lines = err.read().decode("utf-8", errors="replace").strip().splitlines()
    if child.returncode != 0:
        said = lines[-1] if lines else f"exit code {child.returncode}"
        raise BadInput(f"{pathlib.Path(command[0]).name} {command[1] if command[1:] else ''}: {said}")
    return Outcome(text, usage.ru_utime + usage.ru_stime)


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

    def version(self) -> str:
        return run([self.path, "--version"]).stdout.strip()

    def denoisers(self) -> list[dict]:
        """The filters: name, halo_px by quality, options."""
        return self.run("denoise", "--list")[0]["denoisers"]
