"""What the path tracer costs around Embree, when it loads, and for each triangle."""

import pathlib
import re
import shutil
import subprocess

from peers import renderers

RUNS = 3


def _bench(program: pathlib.Path, view, scene: pathlib.Path, size: str, spp: int) -> list[str]:
    command = [str(program), str(scene), "--size", size, "--spp", str(spp), "--threads", "1",
               "--fov-y", str(view.fov_y_degrees)]
    for flag, v in (("--look-from", view.position), ("--look-at", view.target)):
        command += [flag, ",".join(map(str, v))]
    return [*command, "--sky", f"{view.sky},{view.sky},{view.sky}"]


def outside_over_inside(program: pathlib.Path, view, scene: pathlib.Path,
                        folder: pathlib.Path) -> list[float] | None:
    """CPU time of the rendering thread outside Embree over that inside, ascending, by sampling the
    processor's clock in several runs with the job's own number of branches; None without `perf`."""
    if shutil.which("perf") is None:
        return None
    ratios = []
    for _ in range(RUNS):
        data = folder / "perf.data"
        renderers.run(["perf", "record", "-q", "-e", "cpu-clock", "-F", "2000", "-o", str(data),
                       *_bench(program, view, scene, "192x108", 48)], folder / "perf.log")
        samples = subprocess.run(["perf", "script", "-i", str(data), "-F", "tid,ip,dso"],
                                 stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                                 check=True).stdout
        inside: dict[str, list[bool]] = {}
        for line in samples.splitlines():
            thread, *rest = line.split()
            inside.setdefault(thread, []).append(any("libembree" in word for word in rest))
        of_thread = max(inside.values(), key=len)  # the others load and build
        ratios.append((len(of_thread) - sum(of_thread)) / max(1, sum(of_thread)))
    return sorted(ratios)


def loading(program: pathlib.Path, view, scene: pathlib.Path,
            folder: pathlib.Path) -> tuple[float, float]:
    """Milliseconds from the file's name to the first sample, the best of several runs, and bytes a
    triangle beside those that Embree needs."""
    best, attributes = float("inf"), 0.0
    for _ in range(RUNS):
        _, text = renderers.run(_bench(program, view, scene, "16x9", 1), folder / "loading.log")
        load, build = re.search(r"load ([0-9.]+) s, build ([0-9.]+) s", text).groups()
        best = min(best, 1000 * (float(load) + float(build)))
        attributes = float(re.search(r"attributes ([0-9.]+) B/triangle", text).group(1))
    return best, attributes
