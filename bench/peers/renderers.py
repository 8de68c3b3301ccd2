"""Runs renderers as child processes and says what CPU time they took."""

import dataclasses
import json
import os
import pathlib
import re
import shutil
import subprocess

EMBREE_SCENE = "/usr/share/doc/embree3/models/cornell_box.xml"


@dataclasses.dataclass(frozen=True)
class Frame:
    """What is common to all renders of a comparison."""

    width: int
    height: int
    max_depth: int  # bounces after the camera hit
    threads: int


def run(command: list[str], log: pathlib.Path) -> tuple[float, str]:
    """Runs `command`; returns its CPU seconds (user and system, all threads) and its output.

    Errors: RuntimeError with the log's path if it fails.
    """
    with log.open("w+", encoding="utf-8", errors="replace") as out:
        child = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    text = log.read_text(encoding="utf-8", errors="replace")
    if child.returncode != 0:
        raise RuntimeError(f"{command[0]} failed, see {log}")
    return usage.ru_utime + usage.ru_stime, text


def environment_path(view, scene: pathlib.Path) -> pathlib.Path:
    """The view's map, beside the scene or beside its folder of uncompressed copies.

    Errors: FileNotFoundError.
    """
    for home in (scene.parent, scene.parent.parent):
        if (home / view.env).is_file():
            return home / view.env
    raise FileNotFoundError(f"{scene.parent / view.env}: no such environment map")


class Tessera:
    """`tessera render`, raw, with the layers that are asked for."""

    name = "tessera"

    def __init__(self, program: pathlib.Path, layers: str = "all"):
        self._program = str(program)
        self._layers = layers

    def render(self, view, scene: pathlib.Path, frame: Frame, spp: int, seed: int,
               out: pathlib.Path) -> float:
        """Writes `out`; returns CPU seconds of the whole process."""
        command = [self._program, "render", str(scene), "-o", str(out), "--denoiser", "none",
                   "--size", f"{frame.width}x{frame.height}", "--spp", str(spp), "--seed",
                   str(seed), "--threads", str(frame.threads), "--max-depth",
                   str(frame.max_depth), "--layers", self._layers, "--quiet"]
        if view.position:
            for flag, v in (("--look-from", view.position), ("--look-at", view.target)):
                command += [flag, ",".join(map(str, v))]
            command += ["--fov-y", str(view.fov_y_degrees)]
        if view.env:
            command += ["--env", str(environment_path(view, scene))]
        elif view.sky is not None:
            command += ["--sky", f"{view.sky},{view.sky},{view.sky}"]
        return run(command, out.with_suffix(".log"))[0]


class Cycles:
    """Blender's Cycles."""

    name = "cycles"

    @staticmethod
    def available() -> bool:
        return shutil.which("blender") is not None

    def render(self, view, scene: pathlib.Path, frame: Frame, spp: int, seed: int,
               out: pathlib.Path) -> float:
        """Writes `out`; returns CPU seconds of the whole process."""
        env = view.env and str(environment_path(view, scene))
        job = {"scene": str(scene), "out": str(out), "width": frame.width,
               "height": frame.height, "spp": spp, "bounces": frame.max_depth, "seed": seed,
               "threads": frame.threads, "position": view.position, "target": view.target,
               "fov_y_degrees": view.fov_y_degrees, "env": env, "sky": view.sky}
        job_file = out.with_suffix(".json")
        job_file.write_text(json.dumps(job), encoding="utf-8")
        script = pathlib.Path(__file__).with_name("cycles.py")
        command = ["blender", "-b", "-t", str(frame.threads), "--python-exit-code", "1", "-P",
                   str(script), "--", str(job_file)]
        seconds, _ = run(command, out.with_suffix(".log"))
        if not out.is_file():
            raise RuntimeError(f"blender wrote no picture, see {out.with_suffix('.log')}")
        return seconds


def embree_samples_per_cpu_second(folder: pathlib.Path, threads: int) -> float | None:
    """Of Embree's tutorial path tracer on its Cornell box, 512x512; None where it is missing.

    The difference of a long and a short run, so that loading does not count.
    """
    if shutil.which("pathtracer") is None or not pathlib.Path(EMBREE_SCENE).is_file():
        return None
    seconds = {}
    for frames in (2, 26):
        command = ["pathtracer", "-i", EMBREE_SCENE, "--size", "512", "512", "--threads",
                   str(threads), "--benchmark", "0", str(frames)]
        seconds[frames] = run(command, folder / f"embree_{frames}.log")[0]
    return 512 * 512 * 24 / (seconds[26] - seconds[2])


def tessera_samples_per_cpu_second(bench: pathlib.Path, scene: pathlib.Path, threads: int,
                                   folder: pathlib.Path) -> float:
    """Of the path tracer alone on the project's Cornell box at the same size and path length; paths
    of one branch, as the tutorial's are."""
    command = [str(bench), str(scene), "--size", "512x512", "--spp", "16", "--threads",
               str(threads), "--max-depth", "7", "--branches", "1"]
    _, text = run(command, folder / "tessera_cornell.log")
    cpu = float(re.search(r"\(CPU ([0-9.]+) s\)", text).group(1))
    return 512 * 512 * 16 / cpu
