"""What is hard for filters, swept over its severity: what METHODS of failing there are, and the
measuring of each. Errors are over raw's of the same samples."""

import dataclasses
import math
import pathlib

from charts import failures
from tessera_chart import ladder, lanes, methods, views

SPP = 16
REFERENCE_SPP = 256
SEEDS = 3
SIZE = "96x54"


@dataclasses.dataclass(frozen=True)
class Failure:
    """A way to fail. Without `scene` the severity is the number of samples of `fixed`."""

    text: str  # of the axis
    values: tuple
    scene: object = None  # of a value
    flags: object = None  # of a value
    fixed: object = failures.plain
    spp: int = SPP
    reference_spp: int = REFERENCE_SPP
    num_seeds: int = SEEDS
    same_as: str = ""  # failure whose pictures these are too
    error: str = "rel_mse"  # a column of tessera_chart.measures.Errors


FAILURES = {
    "firefly": Failure("lamp radiance", (100, 1000, 10000, 100000), failures.firefly),
    "rim of a lamp": Failure("radiance of a lamp in view; 4 samples", (10, 100, 1000, 10000),
                             failures.rim_of_lamp, spp=4),
    "rare light": Failure("side of the hole, m; 4 samples", (0.4, 0.2, 0.1, 0.05),
                          failures.rare_light, spp=4, reference_spp=1024, num_seeds=6),
    "mean-correlated": Failure("samples a pixel, rare light", (2, 8, 32, 128),
                               fixed=lambda: failures.rare_light(0.1), reference_spp=1024,
                               num_seeds=6),
    "light size": Failure("side of the lamp, m", (1.5, 0.5, 0.15, 0.05), failures.light_size),
    "caustic": Failure("side of the lamp, m", (1.5, 0.5, 0.15, 0.05), failures.caustic),
    "thin wires": Failure("width, pixels", (2, 1, 0.5, 0.25), failures.wire_width),
    "depth of field": Failure("lens radius, m", (0.01, 0.03, 0.1, 0.3),
                              lambda _: failures.aperture(),
                              lambda r: ("--lens-radius", f"{r:g}", "--focus-distance", "4")),
    "reflection": Failure("roughness", (0.02, 0.1, 0.3, 0.6), failures.roughness),
    "texture": Failure("checkers on 4 m", (8, 32, 64, 128), failures.texture),
    "sample count": Failure("samples a pixel", (1, 4, 16, 64, 256), reference_spp=1024),
    "blotches": Failure("samples a pixel; low frequencies only", (1, 4, 16, 64, 256),
                        reference_spp=1024, same_as="sample count", error="blotches"),
    "tile size": Failure("pixels", (8, 16, 32, 64), lambda _: failures.plain(),
                         lambda n: ("--tile-size", f"{n:g}")),
}
QUICK_FAILURES = ("rare light", "blotches")


class Sweep:
    """One failure: a ladder for each severity, or one with all sample counts."""

    def __init__(self, name: str, run, chosen: list, folder: pathlib.Path):
        self.name, self.failure = name, FAILURES[name]
        failure, quick = self.failure, run.quick
        is_swept = failure.scene is not None
        self.values = failure.values[:1 if is_swept else 2] if quick else failure.values
        spp = [2 if quick else failure.spp] if is_swept else [int(v) for v in self.values]
        seeds = list(range(1, (1 if quick else failure.num_seeds) + 1))
        plan = ladder.Plan(run.tessera, chosen, spp, seeds, "32x18" if quick else SIZE,
                           8 if quick else failure.reference_spp, [], 1, run.oidn,
                           run.oidn_weights, is_timed=False)
        self.ladders = []
        for value in self.values if is_swept else ("fixed",):
            made = failure.scene(value) if is_swept else failure.fixed()
            stem = (failure.same_as or name).replace(" ", "_") + (f"_{value:g}" if is_swept else "")
            file = failures.write(made, folder / "scenes" / f"{stem}.glb")
            flags = tuple(failure.flags(value)) if failure.flags else ()
            self.ladders.append(ladder.Ladder(plan, views.View(stem, file, flags), folder / "work"))

    def ladder_of(self, at: int) -> tuple[ladder.Ladder, int]:
        """The ladder of the severity with index `at`, and its samples per pixel."""
        each = self.ladders[min(at, len(self.ladders) - 1)]
        return each, each.plan.spp[at if len(each.plan.spp) > 1 else 0]

    def rows(self) -> list[dict]:
        """By method and severity: errors of the seeds over raw's, and what the filter adds to the
        mean (relative to the reference's; raw's own error, which it shares, is taken off)."""
        found = []
        for at, value in enumerate(self.values):
            each, spp = self.ladder_of(at)
            points = {(p["method"], p["seed"]): p for p in each.points() if p["spp"] == spp}
            column = lambda method, name: [points[method, s][name] for s in each.plan.seeds]
            raw = column(methods.RAW, self.failure.error)
            for method in each.plan.methods:
                errors = column(method.name, self.failure.error)
                ratios = [e / r for e, r in zip(errors, raw)]
                added = [b - a for b, a in zip(column(method.name, "bias"),
                                               column(methods.RAW, "bias"))]
                mean, error = mean_and_error(added)
                found.append({
                    "failure": self.name, "severity": value, "method": method.name,
                    "error": sum(errors) / len(errors), "raw": sum(raw) / len(raw),
                    "ratio": sum(errors) / sum(raw), "least": min(ratios), "greatest": max(ratios),
                    "bias": mean, "bias_error": error})
        return found


def mean_and_error(values: list[float]) -> tuple[float, float]:
    """Of independent values: their mean and its standard error; infinite for a single one."""
    mean = sum(values) / len(values)
    if len(values) < 2:
        return mean, math.inf
    variance = sum((v - mean) ** 2 for v in values) / (len(values) - 1)
    return mean, math.sqrt(variance / len(values))


def measure(run) -> list[Sweep]:
    """All failures, measured; two at once, for nothing here is timed."""
    chosen = [m for m in methods.filters_of(run.tessera.denoisers())
              if m.quality == "final" and not m.searched]
    if run.quick:
        chosen = chosen[:2]
    if run.has_oidn():
        chosen.append(methods.Method(methods.OIDN))
    folder = run.work / "filters"
    sweeps = [Sweep(name, run, chosen, folder)
              for name in (QUICK_FAILURES if run.quick else FAILURES)]
    # One store, one lane: failures that share a ladder do not meet.
    distinct = {each.store.folder: each for sweep in sweeps for each in sweep.ladders}

    def climb(each: ladder.Ladder) -> None:
        for task in each.tasks():
            task.run()

    lanes.run([lambda e=each: climb(e) for each in distinct.values()], 1 if run.quick else 2)
    return sweeps
