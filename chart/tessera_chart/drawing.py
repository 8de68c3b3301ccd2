"""Charts with matplotlib, as SVG and PNG; the same bytes for the same points."""

import io
import pathlib
import re

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.ticker import LogFormatterSciNotation, LogLocator

from tessera_chart import curves, results

# Colours that the colour-blind tell apart (Okabe & Ito 2008), with a marker each.
STYLES = {
    "raw": ("#777777", "o", ":"), "regression": ("#0072B2", "o", "-"),
    "regression-preview": ("#56B4E9", "o", "--"), "bilateral": ("#009E73", "s", "-"),
    "bilateral-preview": ("#80CFB9", "s", "--"), "geometric": ("#D55E00", "^", "-"),
    "geometric-best": ("#F0A060", "^", "--"), "nlm": ("#CC79A7", "D", "-"),
    "nlm-preview": ("#E0B0CC", "D", "--"), "welch": ("#B8A800", "v", "-"),
    "welch-preview": ("#DDD480", "v", "--"), "oidn": ("#000000", "P", "-"),
    "oidn-hq": ("#8C8C8C", "P", "--"),
    "adaptive": ("#4B0092", "X", "-."), "cycles": ("#994F00", "*", ":")}
SPARE = ("#1A85FF", "#D41159", "#40B0A6", "#E1BE6A", "#5D3A9B")

pyplot.rcParams.update({
    "svg.fonttype": "none", "svg.hashsalt": "tessera", "font.size": 9, "axes.grid": True,
    "grid.color": "#dddddd", "grid.linewidth": 0.5, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "figure.facecolor": "white", "font.family": "DejaVu Sans"})

COSTS = (("total_cpu_s", "CPU seconds, render + filter"), ("total_s", "seconds, render + filter"),
         ("own_spp", "samples per pixel"), ("bytes", "bytes from the workers"))
ERRORS = (("rel_mse", "relMSE"), ("flip", "FLIP"))


def style(method: str, index: int = 0) -> dict:
    color, marker, line = STYLES.get(method, (SPARE[index % len(SPARE)], "h", "-"))
    return {"color": color, "marker": marker, "linestyle": line, "markersize": 4, "linewidth": 1.2}


class _FewDecades(LogFormatterSciNotation):
    """Plain numbers where an axis spans less than two decades; else powers of ten."""

    def __init__(self, is_minor: bool):
        super().__init__()
        self._is_minor = is_minor

    def __call__(self, x, pos=None):
        low, high = sorted(self.axis.get_view_interval())
        if low > 0 and high / low < 100:
            return f"{x:g}"
        return "" if self._is_minor else super().__call__(x, pos)


def log_axes(axes, x: bool = True, y: bool = True) -> None:
    """Decades have labels; where there are few of them, so have 2 and 5."""
    for chosen, axis, scale in ((x, axes.xaxis, axes.set_xscale), (y, axes.yaxis, axes.set_yscale)):
        if chosen:
            scale("log")
            axis.set_minor_locator(LogLocator(subs=(2, 5)))
            axis.set_major_formatter(_FewDecades(is_minor=False))
            axis.set_minor_formatter(_FewDecades(is_minor=True))
            axis.set_tick_params(which="minor", labelsize=7)


def save(figure, path: pathlib.Path, png: bool = True) -> None:
    """PATH.svg, and PATH.png."""
    svg = io.StringIO()
    figure.savefig(svg, format="svg", bbox_inches="tight",
                   metadata={"Date": None, "Creator": "tessera chart"})
    # Viewers without this font take a similar one; no white space at line ends.
    text = svg.getvalue().replace("'DejaVu Sans'", "'DejaVu Sans', sans-serif")
    path.with_suffix(".svg").write_text(re.sub(r"[ \t]+\n", "\n", text), encoding="utf-8")
    if png:
        figure.savefig(path.with_suffix(".png"), bbox_inches="tight", dpi=130,
                       metadata={"Software": "tessera chart"})
    pyplot.close(figure)


def draw_curves(axes, by_method: dict, cost: str, error: str, floor: float | None) -> None:
    """One line a method with the range of its seeds, the Pareto front, the references' noise."""
    everything = []
    for index, (method, points) in enumerate(by_method.items()):
        points = [p for p in points if p.values[error] > 0 and cost in p.values]
        if not points:
            continue
        xs, ys = results.column(points, cost), results.column(points, error)
        # A range that reaches below zero (an error within the references' noise) ends at the axis.
        low = [y - max(p.low[error], y / 100) for p, y in zip(points, ys)]
        high = [p.high[error] - y for p, y in zip(points, ys)]
        axes.errorbar(xs, ys, yerr=[low, high], label=method, elinewidth=0.8, capsize=1.5,
                      **style(method, index))
        if not method.endswith("-best") and method != "cycles":
            everything += zip(xs, ys)
    log_axes(axes)
    front = [everything[i] for i in curves.pareto_front(everything)]
    if front and cost != "own_spp":
        axes.plot(*zip(*front), color="#ffd400", linewidth=6, alpha=0.5, zorder=0,
                  solid_capstyle="round", label="Pareto front")
    if floor and error == "rel_mse":
        axes.axhline(floor, color="#999999", linewidth=0.8, linestyle=(0, (1, 2)),
                     label="noise of the references")


def shared_legend(figure, axes_list, **placing) -> None:
    found = {}
    for axes in axes_list:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), **placing)


def draw_scene(by_method: dict, title: str, floor: float, path: pathlib.Path,
               png: bool = True) -> None:
    """All costs by all errors of one scene."""
    figure, grid = pyplot.subplots(len(ERRORS), len(COSTS), figsize=(15, 6.6), sharey="row",
                                   sharex="col")
    for row, (error, error_text) in enumerate(ERRORS):
        for at, (cost, cost_text) in enumerate(COSTS):
            draw_curves(grid[row][at], by_method, cost, error, floor)
            if row == len(ERRORS) - 1:
                grid[row][at].set_xlabel(cost_text)
        grid[row][0].set_ylabel(error_text)
    figure.suptitle(title, fontsize=11, y=0.94)
    shared_legend(figure, [a for row in grid for a in row], loc="center left",
                  bbox_to_anchor=(0.91, 0.5))
    save(figure, path, png)


SCENES_A_LINE = 3  # of a scene_grid: as many as a page shows legibly


def scene_grid(scenes: list[str], sharey: bool):
    """A figure of small charts, one a scene: the figure, and the charts in the scenes' order."""
    columns = min(SCENES_A_LINE, len(scenes))
    lines = -(-len(scenes) // columns)
    figure, grid = pyplot.subplots(lines, columns, figsize=(1.6 + 3.3 * columns, 0.5 + 2.8 * lines),
                                   squeeze=False, sharey=sharey)
    charts = [axes for line in grid for axes in line]
    for axes in charts[len(scenes):]:
        axes.set_visible(False)
    return figure, charts[:len(scenes)]


def finish_grid(figure, charts: list, x_text: str, y_text: str) -> None:
    """The outer labels and the legend of a scene_grid."""
    columns = min(SCENES_A_LINE, len(charts))
    for axes in charts[len(charts) - columns:]:
        axes.set_xlabel(x_text)
    for axes in charts[::columns]:
        axes.set_ylabel(y_text)
    figure.tight_layout(rect=(0, 0, 0.99, 1))
    shared_legend(figure, charts, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_main(rows: list[dict], scenes: list[str], floors: dict, path: pathlib.Path,
              png: bool = True) -> None:
    """relMSE against CPU seconds, one small chart a scene."""
    figure, used = scene_grid(scenes, sharey=False)
    for axes, scene in zip(used, scenes):
        draw_curves(axes, results.means_of(rows, scene), "total_cpu_s", "rel_mse", floors[scene])
        axes.set_title(scene, fontsize=10)
    finish_grid(figure, used, "CPU seconds, render + filter", "relMSE")
    save(figure, path, png)


def draw_multipliers(rows: list[dict], scenes: list[str], path: pathlib.Path,
                     png: bool = True) -> None:
    """Equivalent samples against samples; above 1 a filter is worth its name."""
    figure, used = scene_grid(scenes, sharey=True)
    for axes, scene in zip(used, scenes):
        found: dict[str, list] = {}
        for method, spp, times in results.multipliers(results.means_of(rows, scene)):
            found.setdefault(method, []).append((spp, times))
        for index, (method, points) in enumerate(found.items()):
            axes.plot(*zip(*points), label=method, **style(method, index))
        axes.axhline(1, color="black", linewidth=0.8)
        axes.axhline(4, color="#D55E00", linewidth=0.8, linestyle=(0, (1, 2)),
                     label="the talk's claim: 4")
        log_axes(axes)
        axes.set_title(scene, fontsize=10)
    finish_grid(figure, used, "samples per pixel", "equivalent samples / samples")
    save(figure, path, png)
