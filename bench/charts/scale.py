"""How cost grows with the work: workers, resolution, triangles, lights."""

import contextlib
import csv
import os
import pathlib
import re
import subprocess
import time

from matplotlib import pyplot

from charts import failures, memory
from tessera_chart import drawing, measures, programs
from tessera_chart.store import Store

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


@contextlib.contextmanager
def _farm(bin_folder: pathlib.Path, num_workers: int, log: pathlib.Path, used: dict):
    """A server and workers of one thread each on loopback; afterwards their CPU seconds in `used`.

    Errors: RuntimeError with the log's path if the server does not start.
    """
    children = []
    ports = log.with_suffix(".ports")
    ports.unlink(missing_ok=True)
    with log.open("w", encoding="utf-8") as file:

        def start(*command):
            children.append(subprocess.Popen([str(c) for c in command],
                                             stdout=subprocess.DEVNULL, stderr=file))

        try:
            start(bin_folder / "tessera-server", "--listen", "127.0.0.1:0", "--http", "off",
                  "--port-file", ports)
            while "GRPC=" not in (text := ports.read_text() if ports.is_file() else ""):
                if children[0].poll() is not None:
                    raise RuntimeError(f"tessera-server did not start, see {log}")
                time.sleep(0.05)
            port = re.search(r"GRPC=(\d+)\n", text).group(1)
            for _ in range(num_workers):
                start(bin_folder / "tessera-worker", "--server", f"127.0.0.1:{port}", "--threads", 1)
            yield f"127.0.0.1:{port}"
        finally:
            used["cpu_s"] = 0.0
            for child in reversed(children):
                child.terminate()
            for child in children:
                if child.returncode is None:
                    _, status, usage = os.wait4(child.pid, 0)
                    child.returncode = os.waitstatus_to_exitcode(status)
                    used["cpu_s"] += usage.ru_utime + usage.ru_stime


def _wait_for_workers(tessera, address: str, count: int) -> None:
    for _ in range(120):
        found, _ = tessera.run("workers", "--server", address)
        if len(found["workers"]) >= count:
            return
        time.sleep(0.5)  # asking costs half as much itself
    raise RuntimeError(f"of {count} workers only {len(found['workers'])} came")


def measure_workers(tessera, bin_folder, scene, store: Store, quick: bool) -> list[dict]:
    """The same job on farms of 1 to 4 workers; the CPU is of server and workers, of a long job less
    a short one, so that starting and connecting do not count."""
    size, few, many = ("64x36", 2, 4) if quick else ("320x180", 2, 34)
    rows = []
    for count in (1,) if quick else (1, 2, 3, 4):
        key = f"workers.{count}"
        row = store.get(key)
        if row is None:
            times = {}
            # The quick run has the long job alone: its times say nothing anyway.
            for spp in (many,) if quick else (few, many):
                used: dict = {}
                with _farm(bin_folder, count, store.path("farm.log"), used) as address:
                    _wait_for_workers(tessera, address, count)
                    figures, _ = tessera.run(
                        "render", scene, "-o", store.path("farm.exr"), "--layers", "final", "--size",
                        size, "--spp", spp, "--denoiser", "none", "--server", address, "--quiet")
                times[spp] = (used["cpu_s"], figures)
            row = {"x": count, "seconds": times[many][1]["seconds"]["render"],
                   "cpu_s": times[many][0] - (0.0 if quick else times[few][0]),
                   "bytes": times[many][1]["bytes"]["deltas"], "digest": times[many][1]["digest"]}
            store.put(key, row)
        rows.append({**row, "quantity": "workers"})
    return rows


def _render(tessera, scene, size: str, spp: int, store: Store, seed: int = 1) -> dict:
    out = store.path("scale.exr")
    figures, cpu_s = tessera.run("render", scene, "-o", out, "--layers", "final", "--size", size,
                                 "--spp", spp, "--denoiser", "none", "--quiet", "--seed", seed)
    return {"figures": figures, "cpu_s": cpu_s, "picture": out}


def _cost(tessera, scene, size: str, few: int, many: int, store: Store) -> dict:
    """CPU microseconds of a sample, by the difference of two runs."""
    short, long = (_render(tessera, scene, size, spp, store) for spp in (few, many))
    samples = long["figures"]["samples"] - short["figures"]["samples"]
    return {"us_per_sample": max(0.0, long["cpu_s"] - short["cpu_s"]) / samples * 1e6,
            "load_s": long["figures"]["seconds"]["load"],
            "rays_per_sample": long["figures"]["rays"] / long["figures"]["samples"],
            "bytes_per_pixel": short["figures"]["bytes"]["deltas"]
                               / (short["figures"]["width"] * short["figures"]["height"])}


def measure_growth(tessera, folder: pathlib.Path, store: Store, quick: bool) -> list[dict]:
    few, many = (1, 3) if quick else (4, 20)
    small = "32x18" if quick else "160x90"
    rows = []

    def add(quantity, x, scene, size=small, longest=many):
        key = f"{quantity}.{x}"
        row = store.get(key)
        if row is None:
            row = {"x": x, **_cost(tessera, scene, size, few, longest, store)}
            store.put(key, row)
        rows.append({**row, "quantity": quantity})

    plain = failures.write(failures.plain(), folder / "plain.glb")
    # The quick run has lights alone, which go through all that the others do.
    for width in () if quick else (80, 160, 320, 640, 1280):
        height = width * 9 // 16
        # The fewer the pixels the more samples, so that the difference is long enough to be timed.
        add("pixels", width * height, plain, f"{width}x{height}",
            many if quick else max(12, 20 * 160 ** 2 // width ** 2))
    for count in () if quick else (100, 1000, 10000, 100000, 1000000):
        add("triangles", count,
            failures.write(failures.triangles(count), folder / f"triangles_{count}.glb"))
    for count in (10,) if quick else (1, 10, 100, 1000, 10000):
        scene = failures.write(failures.lights(count), folder / f"lights_{count}.glb")
        add("lights", count, scene)
        rows[-1]["rel_mse_trimmed"] = _light_error(tessera, scene, count, small, store, quick)
    return rows


def _light_error(tessera, scene, count: int, size: str, store: Store, quick: bool) -> float:
    """relMSE of 16 raw samples, trimmed: the rims of the lamps themselves would decide it."""
    key = f"lights.{count}.error"
    found = store.get(key)
    if found is None:
        references = [measures.read_rgb(_render(tessera, scene, size, 4 if quick else 96, store,
                                                seed)["picture"]) for seed in (1001, 1002)]
        picture = measures.read_rgb(_render(tessera, scene, size, 2 if quick else 16, store)["picture"])
        errors = measures.Reference(*references).errors(picture)
        found = {"rel_mse_trimmed": errors.rel_mse_trimmed}
        store.put(key, found)
    return found["rel_mse_trimmed"]


def simulate_workers(bench: pathlib.Path, store: Store, quick: bool) -> list[dict]:
    """Real coordinator and sessions, simulated network, renderers and clock."""
    found = store.get("simulated")
    if found is None:
        said = programs.run([str(bench), "4" if quick else "1000"]).stdout
        found = {"rows": [{k: float(v) for k, v in row.items()}
                          for row in csv.DictReader(said.splitlines())]}
        store.put("simulated", found)
    return [{"quantity": "simulated workers", "x": row["workers"], "seconds": row["seconds"],
             "ideal_seconds": row["ideal_seconds"]} for row in found["rows"]]


def _draw_workers(axes, rows: list[dict]) -> None:
    one = rows[0]
    for index, (values, label) in enumerate((
            ([one["cpu_s"] / r["cpu_s"] for r in rows], "CPU of one worker / CPU"),
            ([one["seconds"] / r["seconds"] for r in rows], "time of one worker / time"),
            ([r["bytes"] / one["bytes"] for r in rows], "bytes / bytes of one worker"))):
        axes.plot([r["x"] for r in rows], values, marker="o", markersize=4, color=COLORS[index],
                  label=label)
    axes.axhline(os.cpu_count(), color="black", linewidth=0.8, linestyle="--",
                 label=f"{os.cpu_count()} cores")
    axes.set_xticks([r["x"] for r in rows])
    axes.set_ylim(0, os.cpu_count() + 0.5)
    axes.set_title("workers, real", fontsize=10)
    axes.set_xlabel("workers of one thread on one machine")


def _draw_simulated(time_axes, efficiency_axes, rows: list[dict]) -> None:
    workers = [r["x"] for r in rows]
    time_axes.plot(workers, [r["seconds"] for r in rows], marker="o", markersize=4, color=COLORS[3],
                   label="seconds of one job")
    time_axes.plot(workers, [r["ideal_seconds"] for r in rows], color="black", linewidth=0.8,
                   linestyle="--", label="work / workers")
    efficiency_axes.plot(workers, [r["ideal_seconds"] / r["seconds"] for r in rows], marker="o",
                         markersize=4, color=COLORS[3], label="efficiency")
    efficiency_axes.set_ylim(0, 1.05)
    drawing.log_axes(time_axes)
    drawing.log_axes(efficiency_axes, y=False)
    for axes in (time_axes, efficiency_axes):
        axes.set_title("workers, SIMULATED", fontsize=10)
        axes.set_xlabel("workers of one thread")


def _draw_memory(axes, rows: list[dict]) -> None:
    for index, name in enumerate(dict.fromkeys(r["method"] for r in rows)):
        found = [r for r in rows if r["method"] == name]
        axes.plot([r["x"] for r in found], [r["peak_bytes"] / 1e6 for r in found], label=name,
                  **drawing.style("raw" if name == "none" else name, index))
    drawing.log_axes(axes)
    axes.set_title("peak memory of filtering a film", fontsize=10)
    axes.set_xlabel("pixels")
    axes.set_ylabel("MB")


def draw(rows: list[dict], path: pathlib.Path) -> None:
    """One panel a quantity."""
    figure, grid = pyplot.subplots(2, 4, figsize=(15, 7))
    grid = grid.ravel()

    def of(quantity):
        return [r for r in rows if r["quantity"] == quantity]

    def line(axes, quantity, column, label, index):
        found = of(quantity)
        axes.plot([r["x"] for r in found], [r[column] for r in found], marker="o", markersize=4,
                  label=label, color=COLORS[index])

    _draw_workers(grid[0], of("workers"))
    if of("simulated workers"):
        _draw_simulated(grid[1], grid[2], of("simulated workers"))
    for axes, quantity, column, label in zip(
            grid[3:6], ("pixels", "triangles", "lights"),
            ("bytes_per_pixel", "load_s", "rel_mse_trimmed"),
            ("bytes a pixel, few samples", "load, s", "relMSE of 16 samples, trimmed")):
        if not of(quantity):
            continue
        line(axes, quantity, "us_per_sample", "CPU us a sample", 0)
        line(axes, quantity, column, label, 1)
        axes.set_title(quantity, fontsize=10)
        axes.set_xlabel(quantity)
        drawing.log_axes(axes)
    _draw_memory(grid[6], of("memory"))
    grid[7].set_visible(False)
    for axes in (a for a in grid[:7] if a.get_legend_handles_labels()[0]):
        axes.legend(fontsize=7)
    figure.tight_layout()
    drawing.save(figure, path, png=False)


def make(run) -> None:
    """Errors: RuntimeError if farms of different sizes gave different pictures."""
    folder, quick = run.work / "scale", run.quick
    measured = run.digest("tessera", "tessera-server", "tessera-worker", "simulated_scale")
    store = Store(folder / f"work-{measured}")
    rows = measure_growth(run.tessera, folder / "scenes", store, quick)
    plain = failures.write(failures.plain(), folder / "scenes" / "plain.glb")
    rows += measure_workers(run.tessera, run.build / "bin", plain, store, quick)
    if run.bin("simulated_scale").is_file():
        rows += simulate_workers(run.bin("simulated_scale"), store, quick)
    rows += memory.measure(run.tessera, plain, store, quick)
    if len({r["digest"] for r in rows if "digest" in r}) != 1:
        raise RuntimeError("farms of different sizes gave different pictures")
    columns = ["quantity", "x", "seconds", "ideal_seconds", "efficiency", "cpu_s", "us_per_sample",
               "load_s", "rays_per_sample", "bytes", "bytes_per_pixel", "rel_mse_trimmed", "method",
               "peak_bytes"]
    with (run.made / "scale.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})
    draw(rows, run.made / "scale")
