"""Where filters fail: charts of the sweeps, of what they do to the mean, and of their spectra."""

import csv
import pathlib

import numpy
from matplotlib import pyplot
from matplotlib.colors import LogNorm

from charts import adaptive, pages, sweeps
from tessera_chart import drawing, measures, methods

COLUMNS = 5  # of the sweeps' chart
SPECTRUM_BANDS = 9  # of an octave's half or so each


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
    names = _failures(rows)
    lines = -(-len(names) // COLUMNS)
    figure, grid = pyplot.subplots(lines, COLUMNS, figsize=(16, 2.9 * lines), sharey=True,
                                   squeeze=False)
    for axes in grid.ravel()[len(names):]:
        axes.set_axis_off()
    for axes, name in zip(grid.ravel(), names):
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
        axes.set_xlabel(sweeps.FAILURES[name].text)
    for line in grid:
        line[0].set_ylabel("error / raw's")
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
    ratio = numpy.array([[max(c["ratio"], 1e-3) for c in line] for line in cells])
    figure, axes = pyplot.subplots(figsize=(13.5, 0.45 * len(chosen) + 1))
    axes.imshow(numpy.clip(ratio, 0.01, 100), norm=LogNorm(0.01, 100), cmap="RdYlGn_r", alpha=0.75,
                aspect="auto")
    for y, line in enumerate(cells):
        for x, cell in enumerate(line):
            sure = "" if cell["ratio"] <= 1 else (" !" if cell["least"] > 1 else " ?")
            axes.text(x, y, f"{cell['ratio']:.2g}{sure}\nat {cell['severity']:g}", ha="center",
                      va="center", fontsize=7)
    axes.set_yticks(range(len(chosen)), chosen)
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.grid(False)
    axes.set_title("worst relMSE over raw's (blotches: of low frequencies), and at which severity; "
                   "above 1 it harms: ! with every seed, ? not with every seed", fontsize=9)
    drawing.save(figure, path, png=False)


def table(rows: list[dict]) -> str:
    lines = []
    for method in _methods(rows):
        cells = []
        for name in _failures(rows):
            cell = worst(rows, method, name)
            text = f"{cell['ratio']:.2g} at {cell['severity']:g}"
            cells.append(f"**{text}**" if cell["least"] > 1 else text)
        lines.append([method, *cells])
    return pages.table(["method", *_failures(rows)], lines)


def _bar(row: dict) -> float:
    """1.96 standard errors of the bias, per cent; none of a single seed."""
    return 196 * row["bias_error"] if numpy.isfinite(row["bias_error"]) else 0.0


def _draw_bias(axes, rows: list[dict], failure: str) -> None:
    """What filters add to the frame's mean, with 1.96 standard errors over seeds."""
    for index, method in enumerate(_methods(rows)):
        found = [r for r in rows if r["failure"] == failure and r["method"] == method]
        # Beside each other, so that bars can be told apart.
        shift = 1.04 ** (index - len(_methods(rows)) / 2)
        axes.errorbar([r["severity"] * shift for r in found], [r["bias"] * 100 for r in found],
                      yerr=[_bar(r) for r in found], label=method, elinewidth=0.8, capsize=1.5,
                      **drawing.style(method, index))
    _severity_axis(axes, failure)
    axes.set_ylabel("added to the mean, %")


def _severity_axis(axes, failure: str) -> None:
    axes.axhline(0, color="black", linewidth=0.8)
    drawing.log_axes(axes, y=False)
    values = sweeps.FAILURES[failure].values
    axes.set_xticks(values, [f"{v:g}" for v in values])
    axes.minorticks_off()
    axes.set_title(failure, fontsize=10)
    axes.set_xlabel(sweeps.FAILURES[failure].text)


def _draw_adaptive(axes, rows: list[dict]) -> None:
    for index, (kind, marker) in enumerate((("uniform", "o"), ("adaptive", "X"))):
        found = [r for r in rows if r["kind"] == kind]
        axes.errorbar([r["severity"] * (0.97, 1.03)[index] for r in found],
                      [r["bias"] * 100 for r in found],
                      yerr=[_bar(r) for r in found], marker=marker, linewidth=1,
                      markersize=5, capsize=2, color=("#777777", "#4B0092")[index],
                      label=f"{kind}, raw mean")
    _severity_axis(axes, "rare light")
    axes.set_title("adaptive counts: --target-error against uniform", fontsize=10)
    axes.set_xlabel("side of the hole, m")
    axes.set_ylabel("mean's distance from the truth, %")
    axes.legend(fontsize=7)


def spectrum(sweep, at: int) -> dict[str, list[tuple[float, float]]]:
    """By method: (frequency, power an octave) of the first seed's relative error, in bands."""
    each, spp = sweep.ladder_of(at)
    found = {}
    for method in each.plan.methods:
        picture = measures.read_rgb(each.picture(method.name, each.plan.seeds[0], spp))
        frequency, power = each.reference().power(picture)
        edges = numpy.geomspace(1 / 64, 0.5, SPECTRUM_BANDS + 1)
        points = []
        for low, high in zip(edges, edges[1:]):
            inside = (frequency > low) & (frequency <= high)
            if inside.any():
                points.append((float(numpy.sqrt(low * high)),
                               float(power[inside].sum() / numpy.log2(high / low))))
        found[method.name] = points
    return found


def _draw_spectrum(axes, sweep, at: int) -> None:
    for index, (method, points) in enumerate(spectrum(sweep, at).items()):
        shown = [p for p in points if p[1] > 0]
        if shown:
            axes.plot(*zip(*shown), label=method, **drawing.style(method, index))
    drawing.log_axes(axes)
    axes.axvline(1 / measures.BLOTCH_PX, color="black", linewidth=0.8, linestyle="--")
    axes.set_title(f"spectrum of the error, {sweep.values[at]} samples, plain room", fontsize=10)
    axes.set_xlabel("cycles a pixel; blotches: left of the line")
    axes.set_ylabel("relMSE an octave")


def draw_bias(rows: list[dict], counts: list[dict], blotches, path: pathlib.Path) -> None:
    figure, grid = pyplot.subplots(2, 2, figsize=(10.5, 7))
    for axes, failure in zip(grid[0], ("rare light", "mean-correlated")):
        _draw_bias(axes, rows, failure)
    _draw_adaptive(grid[1][0], counts)
    _draw_spectrum(grid[1][1], blotches, min(1, len(blotches.values) - 1))
    figure.tight_layout()
    drawing.shared_legend(figure, [*grid[0], grid[1][1]], loc="center left",
                          bbox_to_anchor=(1.0, 0.5))
    drawing.save(figure, path, png=False)


def bias_table(rows: list[dict], counts: list[dict]) -> str:
    """Per cent, +- 1.96 standard errors; bold where that does not reach 0."""
    lines = []

    def cell(row: dict) -> str:
        mean, error = row["bias"] * 100, 1.96 * row["bias_error"] * 100
        text = f"{mean:+.2f} +- {error:.2f}"
        return f"**{text}**" if abs(mean) > error else text

    for failure in ("rare light", "mean-correlated"):
        for method in _methods(rows):
            found = [r for r in rows if r["failure"] == failure and r["method"] == method]
            if found:
                lines.append([failure, method, *map(cell, found)])
    for kind in ("uniform", "adaptive"):
        found = [r for r in counts if r["kind"] == kind]
        lines.append(["rare light", f"{kind} counts, raw", *map(cell, found)])
    columns = max(len(line) for line in lines) - 2
    return pages.table(["sweep", "method", *(f"severity {i + 1}" for i in range(columns))], lines)


def in_words(rows: list[dict]) -> str:
    """For each method its greatest ratio, and where every seed says that it harms."""
    lines = []
    for method in _methods(rows):
        of = [r for r in rows if r["method"] == method]
        most = max(of, key=lambda r: r["ratio"])
        harms = [f"{r['failure']} {r['severity']:g} ({r['ratio']:.2f})" for r in of if r["least"] > 1]
        lines.append(f"- `{method}`: at most {most['ratio']:.2f} of raw's error ({most['failure']}, "
                     f"{most['severity']:g}); above it with every seed: "
                     + (", ".join(harms) if harms else "nowhere") + ".")
    return "\n".join(lines)


def make(run) -> None:
    measured = sweeps.measure(run)
    rows = [row for sweep in measured for row in sweep.rows()]
    write_csv(rows, run.made / "filters.csv")
    draw_sweeps(rows, run.made / "filters-sweeps")
    draw_heat_map(rows, run.made / "filters-worst")
    run.add_part("stability.md", "filters", table(rows) + "\n\n" + in_words(rows))
    by_name = {sweep.name: sweep for sweep in measured}
    counts = adaptive.measure(run, by_name["rare light"])
    write_csv(counts, run.made / "adaptive.csv")
    draw_bias(rows, counts, by_name["blotches"], run.made / "filters-bias")
    run.add_part("stability.md", "bias", bias_table(rows, counts))
