"""Blender's Cycles on a view of ours, by the peers of bench/. Its materials are others than ours, so
it is measured against two references of its own."""

import functools
import hashlib
import pathlib
import time

from tessera_chart import measures, methods, programs
from tessera_chart.errors import BadInput

REFERENCE_SEEDS = (1001, 1002)
# What Cycles is given of a view; any other flag would make it another picture.
KNOWN_FLAGS = {"--look-from", "--look-at", "--fov-y", "--env", "--sky", "--max-depth"}


def check(view) -> None:
    """Errors: BadInput if blender or the peers' modules are missing, or the view is not for it."""
    try:
        from peers import renderers, views
    except ImportError as error:
        raise BadInput("--methods cycles: the folder peers of bench/ is not there") from error
    if not renderers.Cycles.available():
        raise BadInput("--methods cycles: blender is not installed "
                       "(apt-get install --no-install-recommends blender)")
    if views.is_compressed(_plain(view.file)):
        raise BadInput(f"{view.file}: its mesh compression is unknown to Blender; put a plain copy "
                       "into a folder plain/ beside it, or leave cycles out")
    unknown = [f for f in view.flags if f.startswith("--") and f not in KNOWN_FLAGS]
    if unknown:
        raise BadInput(f"{view.name}: cycles cannot be given {unknown[0]}: leave one of them out")
    sky = view.flag("--sky")
    if sky and len(set(sky.split(","))) != 1:
        raise BadInput(f"{view.name}: cycles is given grey skies only: --sky {sky}")


def _plain(file: pathlib.Path) -> pathlib.Path:
    plain = file.parent / "plain" / file.name
    return plain if plain.is_file() else file


@functools.lru_cache(maxsize=None)
def _blender() -> str:
    """Its version, and what it is told to do."""
    from peers import renderers
    script = pathlib.Path(renderers.__file__).with_name("cycles.py")
    return programs.run(["blender", "--version"]).stdout + programs.digest_of(script)


def identity(view) -> str:
    """Another one for another Blender or another file of the view. Errors: BadInput."""
    text = _blender() + programs.digest_of(_plain(view.file))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


class Cycles:
    """Its pictures of one view."""

    def __init__(self, plan, view, store):
        from peers import renderers, views
        self._renderer, self._store, self._plan = renderers.Cycles(), store, plan
        self._identity = identity(view)
        self._scene = _plain(view.file).resolve()
        numbers = lambda flag: tuple(map(float, view.flag(flag).split(","))) if view.flag(flag) else None
        env, sky = view.flag("--env"), numbers("--sky")
        self._view = views.View(
            view.name, str(self._scene), numbers("--look-from"), numbers("--look-at"),
            float(view.flag("--fov-y")) if view.flag("--fov-y") else None,
            str(pathlib.Path(env).resolve()) if env else None, sky[0] if sky else None)
        width, height = map(int, plan.size.split("x"))
        self._frame = renderers.Frame(width, height, int(view.flag("--max-depth") or 8),
                                      plan.threads or 2)

    def render(self, spp: int, seed: int) -> tuple[pathlib.Path, float, float]:
        """The picture, CPU and wall-clock seconds of the whole process. Errors: BadInput."""
        # Its job file lies beside its picture, which must not be taken for a result.
        out = self._store.path(f"{seed}.{spp}.cycles.picture.exr").resolve()
        start = time.monotonic()
        try:
            cpu_s = self._renderer.render(self._view, self._scene, self._frame, spp, seed, out)
        except (RuntimeError, FileNotFoundError) as error:
            raise BadInput(f"cycles: {error}") from error
        return out, cpu_s, time.monotonic() - start

    def reference(self) -> measures.Reference:
        """Of its own, rendered where it is not there yet."""
        spp = self._plan.reference_spp
        for seed in REFERENCE_SEEDS:
            key = self._reference_key(seed)
            if self._store.get(key) is None:
                out, cpu_s, _ = self.render(spp, seed)
                out.rename(self._store.path(key + ".exr"))
                self._store.put(key, {"process_cpu_s": cpu_s})
        paths = [self._store.path(self._reference_key(s) + ".exr") for s in REFERENCE_SEEDS]
        return measures.Reference(*map(measures.read_rgb, paths))

    def _reference_key(self, seed: int) -> str:
        return f"reference.{self._plan.reference_spp}.{seed}.cycles-{self._identity}"


def proportional_times(ladder, row: dict) -> dict:
    """Render times in proportion to samples, by the difference of the longest and shortest run."""
    few, many = ladder.plan.spp[0], ladder.plan.spp[-1]
    ends = [ladder.store.get(ladder.key(methods.CYCLES, row["seed"], n)) for n in (few, many)]
    times = {}
    for ours, theirs in (("render_s", "process_s"), ("render_cpu_s", "process_cpu_s")):
        if None in ends or few == many:
            times[ours] = row[theirs]
        else:
            times[ours] = max(0.0, ends[1][theirs] - ends[0][theirs]) / (many - few) * row["spp"]
    return times
