"""Where filters fail: sweeps over the severity of what is hard for them, charted against raw."""

import concurrent.futures
import csv
import pathlib

import numpy
from matplotlib import pyplot
from matplotlib.colors import LogNorm

from charts import failures, pages
from tessera_chart import drawing, ladder, methods, views

SPP = 16
REFERENCE_SPP = 256
SEEDS = [1, 2, 3]
SIZE = "96x54"

# name -> (what the severity is, its values, the scene of a value, the flags of a value)
SWEEPS = {
    "firefly": ("lamp radiance", (100, 1000, 10000, 100000), failures.firefly, None),
    "light size": ("side of the lamp, m", (1.5, 0.5, 0.15, 0.05), failures.light_size, None),
    "thin wires": ("width, pixels", (2, 1, 0.5, 0.25), failures.wire_width, None),
    "depth of field": ("lens radius, m", (0.01, 0.03, 0.1, 0.3), lambda _: failures.aperture(),
                       lambda r: ("--lens-radius", f"{r:g}", "--focus-distance", "4")),
    "reflection": ("roughness", (0.02, 0.1, 0.3, 0.6), failures.roughness, None),
    "texture": ("checkers on 4 m", (8, 32, 64, 128), failures.texture, None),
    "sample count": ("samples per pixel", (1, 4, 16, 64), None, None),
    "tile size": ("pixels", (8, 16, 32, 64), lambda _: failures.plain(),
                  lambda n: ("--tile-size", f"{n:g}")),
}
QUICK_SWEEPS = ("thin wires", "sample count")


class Sweep:
    """One failure: a ladder for each severity, or one with all sample counts."""

    def __init__(self, name: str, tessera, chosen: list, folder: pathlib.Path, quick: bool):
        self.name = name
        self.text, values, scene, flags = SWEEPS[name]
        self.values = values[:2] if quick else values
        spp = [int(v) for v in self.values] if scene is None else [2 if quick else SPP]
        plan = ladder.Plan(tessera, chosen, spp, SEEDS[:1] if quick else SEEDS,
                           "32x18" if quick else SIZE, 8 if quick else REFERENCE_SPP, [], 1)
        self.ladders = []
        for value in self.values if scene else self.values[:1]:
            stem = name.replace(" ", "_") + (f"_{value:g}" if scene else "")
            made = scene(value) if scene else failures.plain()
            file = failures.write(made, folder / "scenes" / f"{stem}.glb")
            view = views.View(stem, file, tuple(flags(value)) if flags else ())
            self.ladders.append(ladder.Ladder(plan, view, folder / "work"))

    def rows(self) -> list[dict]:
        """By method and severity: errors of the seeds over raw's."""
        found = []
        for at, value in enumerate(self.values):
            each = self.ladders[min(at, len(self.ladders) - 1)]
            spp = each.plan.spp[at if len(each.plan.spp) > 1 else 0]
            points = {(p["method"], p["seed"]): p for p in each.points() if p["spp"] == spp}
            raw = [points[methods.RAW, s]["rel_mse"] for s in each.plan.seeds]
            for method in each.plan.methods:
                errors = [points[method.name, s]["rel_mse"] for s in each.plan.seeds]
                ratios = [e / r for e, r in zip(errors, raw)]
                found.append({
                    "failure": self.name, "severity": value, "method": method.name,
                    "rel_mse": sum(errors) / len(errors), "raw": sum(raw) / len(raw),
                    "ratio": sum(errors) / sum(raw), "least": min(ratios), "greatest": max(ratios)})
        return found


def measure(tessera, folder: pathlib.Path, quick: bool) -> list[dict]:
    chosen = [m for m in methods.filters_of(tessera.denoisers())
              if m.quality == "final" and not m.searched]
    if quick:
        chosen = chosen[:3]
    sweeps = [Sweep(name, tessera, chosen, folder, quick) for name in (QUICK_SWEEPS if quick else SWEEPS)]

    def work(each: ladder.Ladder) -> None:
        for task in each.tasks():
            task.run()

    # Nothing is timed here, so two views at once.
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(work, each) for s in sweeps for each in s.ladders]:
            done.result()
    return [row for sweep in sweeps for row in sweep.rows()]


def write_csv(rows: list[dict], path: pathlib.Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})


def _methods(rows: list[dict]) -> list[str]:
    return [m for m in dict.fromkeys(r["method"] for r in rows) if m != methods.RAW]


def _failures(rows: list[dict]) -> list[str]:
    return list(dict.fromkeys(r["failure"] for r in rows))


def draw_sweeps(rows: list[dict], path: pathlib.Path) -> None:
    figure, grid = pyplot.subplots(2, 4, figsize=(13, 6), sharey=True)
    for axes, name in zip(grid.ravel(), _failures(rows)):
        for index, method in enumerate(_methods(rows)):
            found = [r for r in rows if r["failure"] == name and r["method"] == method
                     and r["ratio"] > 0]
            if not found:
                continue
            ratio = [r["ratio"] for r in found]
            low = [max(0, r["ratio"] - max(r["least"], 1e-3)) for r in found]
            high = [max(0, r["greatest"] - r["ratio"]) for r in found]
            axes.errorbar([r["severity"] for r in found], ratio, yerr=[low, high], label=method,
                          elinewidth=0.8, capsize=1.5, **drawing.style(method, index))
        axes.axhline(1, color="black", linewidth=0.8)
        drawing.log_axes(axes)
        values = sorted({r["severity"] for r in rows if r["failure"] == name})
        axes.set_xticks(values, [f"{v:g}" for v in values])
        axes.minorticks_off()
        axes.set_title(name, fontsize=10)
        axes.set_xlabel(SWEEPS[name][0])
    for line in grid:
        line[0].set_ylabel("relMSE / raw's")
    figure.tight_layout()
    drawing.shared_legend(figure, grid.ravel(), loc="center left", bbox_to_anchor=(1.0, 0.5))
    drawing.save(figure, path, png=False)


def worst(rows: list[dict], method: str, failure: str) -> dict:
    """The row of the severity with the greatest ratio."""
    return max((r for r in rows if r["method"] == method and r["failure"] == failure),
               key=lambda r: r["ratio"])


def draw_heat_map(rows: list[dict], path: pathlib.Path) -> None:
    chosen, names = _methods(rows), _failures(rows)
    cells = [[worst(rows, m, n) for n in names] for m in chosen]
    ratio = numpy.array([[max(c["ratio"], 1e-2) for c in line] for line in cells])
    figure, axes = pyplot.subplots(figsize=(9.5, 0.45 * len(chosen) + 1))
    axes.imshow(numpy.clip(ratio, 0.05, 20), norm=LogNorm(0.05, 20), cmap="RdYlGn_r", alpha=0.75,
                aspect="auto")
    for y, line in enumerate(cells):
        for x, cell in enumerate(line):
            sure = "" if cell["ratio"] <= 1 else (" !" if cell["least"] > 1 else " ?")
            axes.text(x, y, f"{cell['ratio']:.2f}{sure}\nat {cell['severity']:g}", ha="center",
                      va="center", fontsize=7)
    axes.set_yticks(range(len(chosen)), chosen)
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.grid(False)
    axes.set_title("worst relMSE over raw's, and at which severity; above 1 it harms: "
                   "! with every seed, ? not with every seed", fontsize=9)
    drawing.save(figure, path, png=False)


def table(rows: list[dict]) -> str:
    lines = []
    for method in _methods(rows):
        cells = []
        for name in _failures(rows):
            cell = worst(rows, method, name)
            text = f"{cell['ratio']:.2f} at {cell['severity']:g}"
            cells.append(f"**{text}**" if cell["least"] > 1 else text)
        lines.append([method, *cells])
    return pages.table(["method", *_failures(rows)], lines)


def make(tessera, folder: pathlib.Path, out: pathlib.Path, page: pathlib.Path | None,
         quick: bool) -> None:
    rows = measure(tessera, folder / "filters", quick)
    write_csv(rows, out / "filters.csv")
    draw_sweeps(rows, out / "filters-sweeps")
    draw_heat_map(rows, out / "filters-worst")
    if page:
        pages.replace_part(page, "filters", table(rows))
