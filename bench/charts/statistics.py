"""Charts and table of docs/stability.md, from what statistics_stability prints."""

import csv
import math
import pathlib
import shutil

import numpy
from matplotlib import pyplot
from matplotlib.colors import LogNorm

from charts import pages
from tessera_chart import drawing, programs
from tessera_chart.store import Store

MEAN_LIMIT, VARIANCE_LIMIT = 1e-6, 1e-3  # what the film promises from MANY samples on
MANY = 1e6
# Below, shares of the statistical errors: of the mean's standard error (of streams of mean/sd 1,
# whose errors are relative to twice the sd), and of the variance's relative one.
MEAN_SHARE, VARIANCE_SHARE = 1 / 8, 1 / 2
# Cells outside of what the film promises, and why.
NOT_PROMISED = {"denormals": "below 1e-19 a variance is no float"}
RATIO_MAX = 1e3  # greatest mean/sd for which the variance is promised
STYLES = {"sums float": ("#D55E00", "^"), "sums double": ("#E69F00", "v"),
          "talk float": ("#CC79A7", "X"), "Welford float": ("#009E73", "s"),
          "Welford double": ("#777777", "D"), "film": ("#0072B2", "o")}
LEAST_SHOWN = 1e-16


def measure(run) -> pathlib.Path:
    """stability.csv, measured or taken up."""
    store = Store(run.work / "statistics" / run.digest("statistics_stability"))
    if store.get("done") is None:
        text = programs.run([str(run.bin("statistics_stability")),
                             "1000000" if run.quick else "1000000000"]).stdout
        store.path("stability.csv").write_text(text, encoding="utf-8")
        store.put("done", {"version": run.version})
    return store.path("stability.csv")


def read(path: pathlib.Path) -> list[dict]:
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["mean_error"], row["variance_error"] = float(row["mean_error"]), float(row["variance_error"])
    return rows


def _of(rows: list[dict], experiment: str) -> dict[str, list[dict]]:
    found: dict[str, list[dict]] = {}
    for row in rows:
        if row["experiment"] == experiment:
            found.setdefault(row["method"], []).append(row)
    return found


def limits_at(count: float) -> tuple[float, float]:
    """What the film promises of mean and variance after so many samples of mean/sd 1."""
    if count >= MANY:
        return MEAN_LIMIT, VARIANCE_LIMIT
    return (MEAN_LIMIT + MEAN_SHARE / math.sqrt(count) / 2,
            VARIANCE_LIMIT + VARIANCE_SHARE * math.sqrt(2 / count))


def draw_curves(rows: list[dict], path: pathlib.Path) -> None:
    figure, grid = pyplot.subplots(2, 2, figsize=(10, 6.4), sharex="col", sharey="row")
    for column, (experiment, text) in enumerate((("samples", "samples (mean/sd 1)"),
                                                 ("mean/sd", "mean / sd (2^20 samples)"))):
        for line, (error, label) in enumerate((
                ("mean_error", "error of the mean / (|mean| + sd)"),
                ("variance_error", "error of the variance / variance"))):
            axes = grid[line][column]
            for method, found in _of(rows, experiment).items():
                color, marker = STYLES[method]
                # At 1e8 the samples are one float all over: no variance to be relative to.
                shown = [r for r in found if not (experiment == "mean/sd" and r["x"] == "1e8")]
                axes.plot([float(r["x"]) for r in shown],
                          [max(r[error], LEAST_SHOWN) for r in shown], color=color, marker=marker,
                          markersize=4, linewidth=1.2, label=method)
            xs = [float(r["x"]) for r in _of(rows, experiment)["film"]]
            counts = sorted({*xs, MANY * 0.999, MANY}) if experiment == "samples" else xs
            axes.plot(counts, [limits_at(n if experiment == "samples" else MANY)[line]
                               for n in counts],
                      color="black", linewidth=0.8, linestyle="--", label="what the film promises")
            drawing.log_axes(axes)
            if line == 1:
                axes.set_xlabel(text)
            if column == 0:
                axes.set_ylabel(label)
    figure.tight_layout()
    drawing.shared_legend(figure, grid.ravel(), loc="center left", bbox_to_anchor=(1.0, 0.5))
    drawing.save(figure, path, png=False)


def cell_of(row: dict) -> tuple[float, str]:
    """How many times the limit the worse of both errors is, and a word for it."""
    over = max(row["mean_error"] / MEAN_LIMIT, row["variance_error"] / VARIANCE_LIMIT)
    if math.isinf(over):
        return over, "cannot" if "merge" in row["x"] else "not finite"
    if row["negative"] == "1":
        return max(over, 1.01), "negative variance" if over <= 1 else f"negative, {over:.2g}x"
    return over, f"{over:.2g}x" if over >= 0.1 else "ok"


def cases(rows: list[dict]) -> tuple[list[str], list[str], dict]:
    """Names of the cases, of the methods, and rows by both."""
    chosen = {(r["x"], r["method"]): r for r in rows if r["experiment"] == "case"}
    for row in rows:
        if row["experiment"] == "mean/sd" and row["x"] in ("1e1", "1e3", "1e6"):
            chosen[(f"mean/sd {row['x']}", row["method"])] = row
    counts = [r["x"] for r in _of(rows, "samples")["film"]]
    for row in rows:
        if row["experiment"] == "samples" and row["x"] == counts[-1]:
            chosen[(f"{row['x']} samples", row["method"])] = row
    names = list(dict.fromkeys(name for name, _ in chosen))
    return names, list(STYLES), chosen


def draw_cases(rows: list[dict], path: pathlib.Path) -> None:
    names, methods, chosen = cases(rows)
    over = numpy.array([[cell_of(chosen[n, m])[0] for m in methods] for n in names])
    figure, axes = pyplot.subplots(figsize=(8.5, 0.3 * len(names) + 1))
    axes.imshow(numpy.clip(over, 1e-4, 1e4), norm=LogNorm(1e-4, 1e4), cmap="RdYlGn_r", alpha=0.75,
                aspect="auto")
    for y, name in enumerate(names):
        for x, method in enumerate(methods):
            axes.text(x, y, cell_of(chosen[name, method])[1], ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(methods)), methods)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.grid(False)
    axes.set_title("worse error over its limit (mean 1e-6, variance 1e-3); ok: below a tenth",
                   fontsize=9)
    drawing.save(figure, path, png=False)


def is_promised(name: str) -> bool:
    """Whether the film promises its limits in this case."""
    ratio = name.removeprefix("mean/sd ")
    return name not in NOT_PROMISED and (ratio == name or float(ratio) <= RATIO_MAX)


def _breaks_its_limits(row: dict) -> bool:
    mean_limit, variance_limit = limits_at(float(row["x"]))
    return row["mean_error"] > mean_limit or row["variance_error"] > variance_limit


def failing_cells_of_film(rows: list[dict]) -> list[str]:
    """Where the film breaks what it promises."""
    names, _, chosen = cases(rows)
    failing = [n for n in names if is_promised(n) and cell_of(chosen[n, "film"])[0] > 1]
    everything = [r for r in rows if r["method"] == "film" and r["experiment"] != "spread"]
    failing += [f"{r['x']}: negative" for r in everything if r["negative"] == "1"]
    failing += [f"{r['experiment']} {r['x']}" for r in everything
                if r["experiment"] == "samples" and _breaks_its_limits(r)]
    return failing


def table(rows: list[dict]) -> str:
    names, methods, chosen = cases(rows)
    lines = []
    for name in names:
        cells = []
        for method in methods:
            over, text = cell_of(chosen[name, method])
            cells.append(text if over <= 1 else f"**{text}**")
        if not is_promised(name):
            name += " (not promised)"
        lines.append([name, *cells])
    return pages.table(["case", *methods], lines)


def make(run) -> None:
    """Errors: RuntimeError if the film breaks what it promises."""
    made = pathlib.Path(shutil.copy(measure(run), run.made))
    rows = read(made)
    draw_curves(rows, run.made / "stability")
    draw_cases(rows, run.made / "stability-cases")
    run.add_part("stability.md", "cases", table(rows))
    failing = failing_cells_of_film(rows)
    if failing:
        raise RuntimeError("the film breaks its promise: " + "; ".join(failing))
