"""Measures one view: a ladder of sample counts by one run, every method on every film of it.

Each piece of work is a task whose result lies in a Store; a finished one is not done again.
"""

import collections
import dataclasses
import hashlib
import math
import os
import pathlib
import threading
from typing import Callable

from tessera_chart import measures, methods, oidn, peers_of, programs
from tessera_chart.store import Store
from tessera_chart.views import View

REFERENCE_SEEDS = (1001, 1002)
# By folder of references: views that share one must not render it at the same time.
_reference_locks: dict[pathlib.Path, threading.Lock] = collections.defaultdict(threading.Lock)


@dataclasses.dataclass
class Plan:
    """What the run is to do; the same for all views."""

    tessera: programs.Tessera
    methods: list[methods.Method]
    spp: list[int]  # ascending
    seeds: list[int]
    size: str  # WIDTHxHEIGHT
    reference_spp: int  # of each of the two
    references: list[pathlib.Path]  # given instead: one or two
    threads: int | None
    oidn: str | None = None
    oidn_weights: pathlib.Path | None = None
    frame: str | None = None  # times and bytes are said for a frame of this size
    is_timed: bool = True  # else CPU times are not to be used: what only they need is not run
    jobs: int = 1  # views side by side

    def timing_text(self) -> str:
        """Another one for other times; of work that nobody times always the same."""
        if not self.is_timed:
            return "not timed"
        return f"{self.threads or os.cpu_count()} threads, {self.jobs} jobs"

    def reference_text(self) -> str:
        """Another one for other references: errors against them are other errors."""
        digests = [hashlib.sha256(p.read_bytes()).hexdigest() for p in self.references]
        return " ".join(digests) or str(self.reference_spp)


def pixels_of(size: str) -> int:
    width, height = map(int, size.split("x"))
    return width * height


@dataclasses.dataclass(frozen=True)
class Task:
    """A piece of work; `weight` is about the seconds that it takes on two idle cores."""

    label: str
    weight: float
    run: Callable[[], None]


def cpu_times(counts: list[int], process_s: list[float], nothing_s: float) -> tuple[float, float]:
    """CPU seconds of loading, and of one sample per pixel, from those of the ladder's processes.

    `nothing_s` is of a process that takes up a film and adds no sample. The last two steps tell
    loading and samples apart; a ladder of fewer than three steps counts loading with the samples.
    """
    added = [n - before for n, before in zip(counts, [0, *counts])]
    last = max(0.0, process_s[-1] - nothing_s)
    if len(counts) < 3 or added[-1] == added[-2]:
        return 0.0, last / added[-1]
    per_spp = max(0.0, process_s[-1] - process_s[-2]) / (added[-1] - added[-2])
    return max(0.0, last - per_spp * added[-1]), per_spp


class _Costs:
    """Times and bytes of one seed's ladder."""

    def __init__(self, plan: Plan, num_pixels: int, steps: list[dict], nothing_s: float | None):
        self._plan, self._steps = plan, steps
        self._scale = pixels_of(plan.frame) / num_pixels if plan.frame else 1.0
        self._nothing_s = nothing_s
        self.load_s = steps[0]["seconds"]["load"]
        self.load_cpu_s, self._cpu_per_spp = 0.0, 0.0
        if plan.is_timed:
            self.load_cpu_s, self._cpu_per_spp = cpu_times(
                plan.spp, [s["process_cpu_s"] for s in steps], nothing_s)

    def of_step(self, at: int) -> dict:
        """Of all samples up to a step of the ladder."""
        steps = self._steps[:at + 1]
        return {"render_s": self.load_s + sum(s["seconds"]["render"] for s in steps),
                "render_cpu_s": self.load_cpu_s + self._cpu_per_spp * self._plan.spp[at],
                "bytes": sum(s["bytes"]["deltas"] for s in steps)}

    def of_adaptive(self, row: dict, filter_cpu_s: float) -> float:
        """CPU seconds of sampling and filtering until the target: those of the process less those
        of one that does nothing. That one reads and writes a film, which is too much to take off:
        at least its samples and one filtering are charged."""
        least = self.load_cpu_s + self._cpu_per_spp * row["own_spp"] + filter_cpu_s
        return max(least, row["render_cpu_s"] - self._nothing_s)

    def scaled(self, row: dict) -> dict:
        """For the plan's frame: all but loading is in proportion to pixels. With totals."""
        scale = self._scale
        is_ours = row["method"] != methods.CYCLES  # whose times are without loading
        for column, load in (("render_s", self.load_s), ("render_cpu_s", self.load_cpu_s)):
            load = min(load, row[column]) if is_ours else 0.0
            row[column] = load + (row[column] - load) * scale
        for column in ("filter_s", "filter_cpu_s", "bytes"):
            row[column] = row[column] and row[column] * scale
        row["total_s"] = row["render_s"] + row["filter_s"]
        row["total_cpu_s"] = row["render_cpu_s"] + row["filter_cpu_s"]
        return row


class Ladder:
    """One view's work and results."""

    def __init__(self, plan: Plan, view: View, work: pathlib.Path):
        self.plan, self.view = plan, view
        program = plan.tessera.identity()
        measured = view.digest(
            plan.size, ", ".join((program, plan.reference_text(), plan.timing_text())))
        self.store = Store(work / f"{view.name}-{measured}")
        self.shared = Store(work / f"reference-{view.picture_digest(plan.size, program)}")
        self.left_out: list[str] = []  # by the last points(): what is missing, and why
        self._reference: measures.Reference | None = None

    # Work.

    def tasks(self) -> list[Task]:
        """In the order in which they must run."""
        plan, rate = self.plan, 1.2e6  # samples a second, roughly
        todo = []
        if not plan.references:
            weight = 0.3 + self._pixels() * plan.reference_spp / rate
            todo += [Task(f"reference {i + 1}", weight, lambda s=s: self._render_reference(s))
                     for i, s in enumerate(REFERENCE_SEEDS)]
        per_filter = 0.3 + 10e-6 * self._pixels()
        for seed in plan.seeds:
            before = 0
            for spp in plan.spp:
                weight = 0.4 + self._pixels() * (spp - before) / rate
                todo.append(Task(f"{spp} spp", weight,
                                 lambda a=(seed, spp, before): self._render_step(*a)))
                before = spp
            if plan.is_timed:
                todo.append(Task("start-up", 0.4, lambda s=seed: self._render_nothing(s)))
            for spp in plan.spp:
                for method in self.plan.methods:
                    if not self._is_measured(method, seed, spp):
                        continue
                    runner, weight = self._runner(method)
                    if method.searched and seed == plan.seeds[0]:
                        weight = 30
                    todo.append(Task(f"{method.name} at {spp} spp", weight or per_filter,
                                     lambda r=runner, a=(method, seed, spp): r(*a)))
        return todo

    def _pixels(self) -> int:
        """Those that are rendered."""
        region = self.view.flag("--region")
        return math.prod(map(int, region.split(",")[2:])) if region else pixels_of(self.plan.size)

    def _is_measured(self, method: methods.Method, seed: int, spp: int) -> bool:
        """Cycles takes seconds to start, so one seed has to do; adaptive sampling renders at most as
        much as the longest step, whose own error it can therefore not be asked for."""
        if method.name == methods.CYCLES:
            return seed == self.plan.seeds[0]
        return method.name != methods.ADAPTIVE or spp < self.plan.spp[-1] or len(self.plan.spp) == 1

    def _runner(self, method: methods.Method):
        """What measures it, and its weight (0: as a filter)."""
        plan = self.plan
        if method.name == methods.RAW:
            return self._measure_raw, 0.02
        if method.denoiser:
            return self._measure_filter, 0
        at_mean_spp = self._pixels() * sum(plan.spp) / len(plan.spp) / 1e6
        return {methods.OIDN: (self._measure_oidn, 0), methods.OIDN_HQ: (self._measure_oidn, 0),
                methods.ADAPTIVE: (self._measure_adaptive, 1 + at_mean_spp),
                methods.CYCLES: (self._measure_cycles, 3 + at_mean_spp)}[method.name]

    def _render_flags(self, spp: int, seed: int) -> list:
        threads = ["--threads", self.plan.threads] if self.plan.threads else []
        return [self.view.file, *self.view.flags, "--size", self.plan.size, "--spp", spp, "--seed",
                seed, *threads, "--quiet"]

    def _render_reference(self, seed: int) -> None:
        key = f"reference.{self.plan.reference_spp}.{seed}"
        with _reference_locks[self.shared.folder]:
            if self.shared.get(key):
                return
            figures, _ = self.plan.tessera.run(
                "render", *self._render_flags(self.plan.reference_spp, seed), "--denoiser", "none",
                "--layers", "final", "-o", self.shared.path(key + ".exr"))
            self.shared.put(key, figures)

    # Keys of results: each names all that decides the result and that the store's folder does not.

    def key(self, method: str, seed: int, spp: int) -> str:
        name = method
        if method in oidn.WEIGHTS:
            name += "-" + oidn.identity(self.plan.oidn, self.plan.oidn_weights, method)
        elif method == methods.CYCLES:
            name += "-" + peers_of.identity(self.view)
        elif method == methods.ADAPTIVE:
            return f"{seed}.{spp}-{self._adaptive_spp_max(spp)}.{name}"
        return f"{seed}.{spp}.{name}"

    @staticmethod
    def _step_key(seed: int, spp: int, before: int) -> str:
        """Of the samples between two counts; their sum's film is the same whatever the steps."""
        return f"{seed}.{before}-{spp}.render"

    def _nothing_key(self, seed: int) -> str:
        return f"{seed}.{self.plan.spp[0]}.nothing"

    def _adaptive_spp_max(self, spp: int) -> int:
        return self.plan.spp[-1] if len(self.plan.spp) > 1 else 4 * spp

    def _film(self, seed: int, spp: int) -> pathlib.Path:
        return self.store.path(f"{seed}.{spp}.film.exr")

    def _render_step(self, seed: int, spp: int, before: int) -> None:
        key = self._step_key(seed, spp, before)
        if self.store.get(key) and self._film(seed, spp).is_file():
            return
        taken_up = ["--continue", self._film(seed, before)] if before else []
        figures, cpu_s = self.plan.tessera.run(
            "render", *self._render_flags(spp, seed), *taken_up, "--denoiser", "none", "--layers",
            "film", "-o", self._film(seed, spp))
        figures["process_cpu_s"] = cpu_s
        self.store.put(key, figures)

    def _render_nothing(self, seed: int) -> None:
        """What a process costs that takes up a film, adds no sample and writes it."""
        if self.store.get(self._nothing_key(seed)):
            return
        spp = self.plan.spp[0]
        _, cpu_s = self.plan.tessera.run(
            "render", *self._render_flags(spp, seed), "--continue", self._film(seed, spp),
            "--denoiser", "none", "--layers", "film", "-o", self.store.path("nothing.exr"))
        self.store.path("nothing.exr").unlink()
        self.store.put(self._nothing_key(seed), {"process_cpu_s": cpu_s})

    def _measured(self, picture: pathlib.Path, reference: measures.Reference) -> dict:
        return dataclasses.asdict(reference.errors(measures.read_rgb(picture)))

    def _measure_raw(self, method: methods.Method, seed: int, spp: int) -> None:
        """The film's own colour is the raw picture."""
        key = self.key(method.name, seed, spp)
        if not self.store.get(key):
            self.store.put(key, {"filter_s": 0.0, "filter_cpu_s": 0.0,
                                 **self._measured(self._film(seed, spp), self.reference())})

    def _measure_filter(self, method: methods.Method, seed: int, spp: int) -> None:
        key = self.key(method.name, seed, spp)
        if self.store.get(key):
            return
        options, tried = None, 0
        if method.searched:
            options, tried = self._best_options(method, spp)
        picture = self.picture(method.name, seed, spp)
        figures = self._denoise(method, seed, spp, picture, options)
        result = {"filter_s": figures["seconds"]["filter"],
                  "filter_cpu_s": figures["cpu_seconds"]["filter"],
                  **self._measured(picture, self.reference())}
        if options is not None:
            result["options"], result["options_tried"] = options, tried
        if seed != self.plan.seeds[0]:
            picture.unlink()
        self.store.put(key, result)

    def _denoise(self, method, seed, spp, picture, options=None) -> dict:
        return self.plan.tessera.run("denoise", self._film(seed, spp), "-o", picture, "--layers",
                                     "final", *method.flags(options))[0]

    def _best_options(self, method: methods.Method, spp: int) -> tuple[dict, int]:
        """Found on the first seed, used for all."""
        seed = self.plan.seeds[0]
        key = f"{spp}.{method.name}.options"
        found = self.store.get(key)
        if found is None:
            trial = self.store.path("trial.exr")

            def error_of(options):
                self._denoise(method, seed, spp, trial, options)
                return float(self.reference().relative_errors(measures.read_rgb(trial)).mean())

            options, tried = methods.search(method, error_of)
            trial.unlink(missing_ok=True)
            found = {"options": options, "tried": tried}
            self.store.put(key, found)
        return found["options"], found["tried"]

    def _measure_oidn(self, method: methods.Method, seed: int, spp: int) -> None:
        key = self.key(method.name, seed, spp)
        if self.store.get(key):
            return
        picture = self.picture(method.name, seed, spp)
        wall_s, cpu_s = oidn.denoise(self.plan.oidn, self.plan.oidn_weights, method.name,
                                     self._film(seed, spp), picture, self.plan.threads)
        result = self._measured(picture, self.reference())
        if seed != self.plan.seeds[0]:
            picture.unlink()
        self.store.put(key, {"filter_s": wall_s, "filter_cpu_s": cpu_s, **result})

    def _measure_adaptive(self, method: methods.Method, seed: int, spp: int) -> None:
        """Sampling by --target-error, the target being what the same samples everywhere reached."""
        key = self.key(method.name, seed, spp)
        if self.store.get(key):
            return
        uniform = self._uniform(self.plan.seeds[0], spp)
        if uniform is None or uniform["rel_mse"] <= 0:
            return  # points() says so
        target = max(uniform["rel_mse"] ** 0.5, 1e-4)
        picture = self.picture(method.name, seed, spp)
        figures, cpu_s = self.plan.tessera.run(
            "render", *self._render_flags(self._adaptive_spp_max(spp), seed), "--target-error",
            f"{target:.6g}", "--layers", "final", "-o", picture)
        seconds = figures["seconds"]
        self.store.put(key, {"own_spp": figures["spp"], "target": target,
                             "stopped_by": figures["stopped_by"],
                             "render_s": seconds["load"] + seconds["render"],
                             "render_cpu_s": cpu_s, "filter_s": seconds["filter"],
                             "filter_cpu_s": 0.0, "bytes": figures["bytes"]["deltas"],
                             **self._measured(picture, self.reference())})

    def _measure_cycles(self, method: methods.Method, seed: int, spp: int) -> None:
        key = self.key(method.name, seed, spp)
        if self.store.get(key):
            return
        cycles = peers_of.Cycles(self.plan, self.view, self.store)
        picture, cpu_s, wall_s = cycles.render(spp, seed)
        self.store.put(key, {"process_cpu_s": cpu_s, "process_s": wall_s,
                             **self._measured(picture, cycles.reference())})

    # Results.

    def reference(self) -> measures.Reference:
        if self._reference is None:
            paths = self.plan.references or [
                self.shared.path(f"reference.{self.plan.reference_spp}.{s}.exr")
                for s in REFERENCE_SEEDS]
            self._reference = measures.Reference(*map(measures.read_rgb, paths))
        return self._reference

    def picture(self, method: str, seed: int, spp: int) -> pathlib.Path:
        """The EXR; kept for the first seed."""
        if method == methods.RAW:
            return self._film(seed, spp)
        return self.store.path(self.key(method, seed, spp) + ".exr")

    def points(self) -> list[dict]:
        """All that is finished, one row a method, sample count and seed; fills `left_out`."""
        rows = []
        self.left_out = []
        for seed in self.plan.seeds:
            steps = [self.store.get(self._step_key(seed, spp, before))
                     for before, spp in zip([0, *self.plan.spp], self.plan.spp)]
            nothing_s = (self.store.get(self._nothing_key(seed)) or {}).get("process_cpu_s")
            if None in steps or (nothing_s is None and self.plan.is_timed):
                continue
            costs = _Costs(self.plan, self._pixels(), steps, nothing_s)
            for at, spp in enumerate(self.plan.spp):
                shared = {"scene": self.view.name, "seed": seed, "spp": spp, "own_spp": spp,
                          **costs.of_step(at)}
                for method in self.plan.methods:
                    found = self.store.get(self.key(method.name, seed, spp))
                    if method.name == methods.ADAPTIVE and self._is_measured(method, seed, spp):
                        why = self._why_not_adaptive(seed, spp, found is not None)
                        if why:
                            self.left_out.append(f"{self.view.name}: adaptive at {spp} spp, seed "
                                                 f"{seed}, is left out: {why}")
                            continue
                    if found is not None:
                        rows.append(self._row(method.name, shared, found, costs))
        return rows

    def _uniform(self, seed: int, spp: int) -> dict | None:
        """What adaptive sampling is held against."""
        return self.store.get(self.key("regression", seed, spp))

    def _why_not_adaptive(self, seed: int, spp: int, is_there: bool) -> str:
        """Empty if there is a target and the cost of one filtering, or if nothing is there yet."""
        first, own = self._uniform(self.plan.seeds[0], spp), self._uniform(seed, spp)
        if first is not None and first["rel_mse"] <= 0:
            return "regression's error, its target, is within the references' noise"
        if is_there and None in (first, own):
            return "there is no result of regression, its target; run the same command again"
        return ""

    def _row(self, method: str, shared: dict, found: dict, costs: _Costs) -> dict:
        row = {"method": method, "filter_s": 0.0, "filter_cpu_s": 0.0, **shared, **found}
        if method == methods.CYCLES:
            row.update(peers_of.proportional_times(self, row), bytes=None)
        elif method == methods.ADAPTIVE and self.plan.is_timed:
            once = self._uniform(row["seed"], row["spp"])["filter_cpu_s"]
            row["render_cpu_s"] = costs.of_adaptive(row, once)
        return costs.scaled(row)
