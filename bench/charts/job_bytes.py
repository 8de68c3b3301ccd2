"""What the deltas of a whole job weigh, by delta and by quantity: chart and table of
docs/model-by-need.md, from what job_bytes_bench prints."""

import csv

import numpy
from matplotlib import pyplot

from charts import pages
from tessera_chart import drawing, programs
from tessera_chart.store import Store

SCENES = ("still_life", "window_room", "cornell", "many_lights")
# Columns of job_bytes_bench that are drawn as one, and their colour.
PARTS = {"radiance mean": ("#0072B2", ["radiance mean"]),
         "radiance msd": ("#56B4E9", ["radiance msd"]),
         "albedo": ("#D55E00", ["albedo mean", "albedo msd"]),
         "normal": ("#009E73", ["normal mean", "normal msd"]),
         "depth, hits, ids": ("#777777", ["depth mean", "depth msd", "hits and ids"])}


def measure(run) -> list[dict]:
    """The bench's rows, measured or taken up."""
    store = Store(run.work / "job_bytes" / run.digest("job_bytes_bench"))
    if store.get("done") is None:
        scenes = [str(run.build / "scenes" / f"{name}.glb") for name in SCENES]
        text = programs.run([str(run.bin("job_bytes_bench")), *scenes, "--size",
                             "32x32" if run.quick else "96x64"]).stdout
        store.path("rows.txt").write_text(text, encoding="utf-8")
        store.put("done", {"version": run.version})
    lines = store.path("rows.txt").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("| ").split("|")]
             for line in lines if line.startswith("|")]
    return [dict(zip(cells[0], row)) for row in cells[1:]]


def draw(rows: list[dict], path) -> None:
    figure, grid = pyplot.subplots(1, len(SCENES), figsize=(11, 3.2), sharey=True)
    for axes, scene in zip(grid, SCENES):
        found = [r for r in rows if r["scene"] == scene and r["samples"] != "all"]
        bottom = numpy.zeros(len(found))
        for label, (color, columns) in PARTS.items():
            heights = numpy.array([sum(float(r[c]) for c in columns) for r in found])
            axes.bar(range(len(found)), heights, bottom=bottom, color=color, label=label)
            bottom += heights
        axes.set_xticks(range(len(found)), [r["samples"] for r in found], rotation=60, fontsize=7)
        axes.set_title(scene, fontsize=9)
    grid[0].set_ylabel("bytes a pixel and delta")
    figure.tight_layout()
    drawing.shared_legend(figure, grid.ravel(), loc="center left", bbox_to_anchor=(1.0, 0.5))
    drawing.save(figure, path, png=False)


def table(rows: list[dict]) -> str:
    lines = []
    for row in rows:
        if row["samples"] == "all":
            job, everything = float(row["all"]), float(row["all planes always"])
            lines.append([row["scene"], f"{everything:.0f}", f"{job:.0f}", f"{job / everything:.2f}"])
    ratios = [float(line[3]) for line in lines]
    lines.append(["geometric mean", "", "", f"{numpy.exp(numpy.mean(numpy.log(ratios))):.2f}"])
    return pages.table(["scene", "all planes always", "the job", "ratio"], lines)


def make(run) -> None:
    rows = measure(run)
    with (run.made / "job-bytes.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    draw(rows, run.made / "job-bytes")
    run.add_part("model-by-need.md", "bytes", table(rows))
