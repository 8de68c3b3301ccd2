"""Points of all seeds and what follows from them: means and ranges, multipliers, sentences."""

import csv
import dataclasses
import json
import pathlib

from tessera_chart import curves, methods

COLUMNS = ("scene", "method", "spp", "own_spp", "seed", "rel_mse", "rel_mse_trimmed", "flip",
           "blotches", "bias",
           "render_s", "filter_s", "total_s", "render_cpu_s", "filter_cpu_s", "total_cpu_s", "bytes")
BUDGETS_S = (1, 10, 60)


@dataclasses.dataclass(frozen=True)
class Mean:
    """One method at one sample count of one scene, over seeds."""

    method: str
    spp: float
    num_seeds: int
    values: dict[str, float]  # the mean of each column
    low: dict[str, float]  # the least and the greatest of the seeds
    high: dict[str, float]


def rounded(row: dict) -> dict:
    """As written to files: six significant digits say all there is to say."""
    return {c: float(f"{row[c]:.6g}") if isinstance(row.get(c), float) else row.get(c)
            for c in COLUMNS}


def write_csv(rows: list[dict], path: pathlib.Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(rounded, rows))


def write_points(rows: list[dict], settings: dict, folder: pathlib.Path) -> None:
    """points.csv and points.json, the latter with the settings of the run."""
    write_csv(rows, folder / "points.csv")
    points = [{**rounded(r), **({"options": r["options"]} if "options" in r else {})} for r in rows]
    (folder / "points.json").write_text(
        json.dumps({"settings": settings, "points": points}, indent=1) + "\n", encoding="utf-8")


def read_points(path: pathlib.Path) -> list[dict]:
    """The rows of points.json."""
    return json.loads(path.read_text(encoding="utf-8"))["points"]


def read_settings(path: pathlib.Path) -> dict:
    """Those of the run that wrote points.json."""
    return json.loads(path.read_text(encoding="utf-8"))["settings"]


def means_of(rows: list[dict], scene: str) -> dict[str, list[Mean]]:
    """By method, in the rows' order, by ascending samples."""
    grouped: dict[str, dict[float, list[dict]]] = {}
    for row in rows:
        if row["scene"] == scene:
            grouped.setdefault(row["method"], {}).setdefault(row["spp"], []).append(row)
    found = {}
    for method, by_spp in grouped.items():
        found[method] = []
        for spp, same in sorted(by_spp.items()):
            columns = [c for c in COLUMNS[3:] if c != "seed" and same[0].get(c) is not None]
            values = {c: [row[c] for row in same] for c in columns}
            found[method].append(Mean(
                method, spp, len(same), {c: sum(v) / len(v) for c, v in values.items()},
                {c: min(v) for c, v in values.items()}, {c: max(v) for c, v in values.items()}))
    return found


def column(points: list[Mean], name: str) -> list[float]:
    return [p.values[name] for p in points]


def multipliers(by_method: dict[str, list[Mean]]) -> list[tuple[str, float, float]]:
    """(method, samples, equivalent-sample multiplier) of every filter, by raw's fitted curve."""
    raw = by_method.get(methods.RAW, [])
    rows = []
    for method, points in by_method.items():
        if method in (methods.RAW, methods.CYCLES):
            continue
        for p in points:
            times = curves.multiplier([r.spp for r in raw], column(raw, "rel_mse"),
                                      p.values["own_spp"], p.values["rel_mse"])
            if times is not None:
                rows.append((method, p.spp, times))
    return rows


def sentence(scene: str, by_method: dict[str, list[Mean]], cost: str = "total_cpu_s",
             uncertainty: float = 0.0) -> str:
    """Who has the least relMSE at 1 s, 10 s and 60 s; oracles and other renderers do not compete.

    `uncertainty`: standard error of relMSE by the references' noise; below twice that nothing is
    said about who is first.
    """
    competing = {m: (column(p, cost), column(p, "rel_mse")) for m, p in by_method.items()
                 if not m.endswith(methods.ORACLE_SUFFIX) and m != methods.CYCLES}
    parts, beyond_all = [], []
    for budget in BUDGETS_S:
        won = curves.winner(competing, budget)
        if won is None:
            beyond_all.append(str(budget))
            continue
        name, error, beyond, second, second_error = won
        if error < 2 * uncertainty:
            parts.append(f"at {budget} s more than one within the references' noise ({name} first)"
                         if second and second_error < 2 * uncertainty else
                         f"at {budget} s {name} (within the references' noise)")
            continue
        text = f"at {budget} s {name} (relMSE {error:.2g}"
        if second:
            text += f"; next {second}, {second_error / error:.2f} times that"
        parts.append(text + (", extrapolated)" if beyond else ")"))
    if beyond_all:
        reach = [x for costs, _ in competing.values() for x in costs]
        parts.append(f"at {', '.join(beyond_all)} s unknown (measured {min(reach, default=0):.2g} "
                     f"to {max(reach, default=0):.2g} s)")
    unit = "CPU seconds" if cost == "total_cpu_s" else "seconds"
    return f"{scene}: of {unit} for render and filter together, " + ", ".join(parts) + "."
