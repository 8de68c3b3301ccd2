"""What is taken up by a later run, and what is not because another setting decides it."""

import contextlib
import io
import os
import pathlib
import tempfile
import types
import unittest
from unittest import mock

import numpy
import OpenImageIO as oiio

from charts import adaptive, filters, sweeps
from tessera_chart import command, errors, ladder, methods, oidn, peers_of, programs, views
from tessera_chart.store import Store

SCENES = pathlib.Path(os.environ["SCENES"])
RAW = methods.Method(methods.RAW, "none")
REGRESSION = methods.Method("regression", "regression")
ADAPTIVE = methods.Method(methods.ADAPTIVE)


class FakeTessera:
    """Writes pictures of noise, and says that each sample sends a byte."""

    def __init__(self, identity="1.0, abc"):
        self.calls, self._identity = [], identity

    def identity(self) -> str:
        return self._identity

    def version(self) -> str:
        return self._identity

    def run(self, *arguments):
        words = [str(a) for a in arguments]
        self.calls.append(words)
        value = lambda flag: words[words.index(flag) + 1]
        noise = numpy.random.default_rng(len(self.calls)).uniform(0.4, 0.6, (18, 32, 3))
        picture = oiio.ImageBuf(oiio.ImageSpec(32, 18, 3, oiio.FLOAT))
        picture.set_pixels(oiio.ROI(0, 32, 0, 18, 0, 1, 0, 3), noise.astype(numpy.float32))
        picture.write(value("-o"))
        figures = {"seconds": {"load": 1.0, "render": 1.0, "filter": 1.0},
                   "cpu_seconds": {"filter": 1.0}}
        if words[0] == "render":
            spp = int(value("--spp"))
            before = int(value("--continue").split(".")[-3]) if "--continue" in words else 0
            figures |= {"spp": spp, "stopped_by": "spp", "bytes": {"deltas": spp - before}}
        return figures, 1.0


class Base(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def ladder(self, spp, chosen=(RAW,), tessera=None, folder="work", **settings):
        plan = ladder.Plan(tessera or FakeTessera(), list(chosen), spp, [1], "32x18", 8, [],
                           settings.pop("threads", 2), **settings)
        view = views.View("cornell", SCENES / "cornell.glb", ())
        return ladder.Ladder(plan, view, self.folder / folder)

    def climb(self, each):
        for task in each.tasks():
            task.run()
        return each.points()


class StepsBetween(Base):
    def test_refining_a_list_gives_what_a_fresh_list_gives(self):
        tessera = programs.Tessera(os.environ["TESSERA"])
        self.climb(self.ladder([1, 4], tessera=tessera, is_timed=False))
        refined = self.climb(self.ladder([1, 2, 4], tessera=tessera, is_timed=False))
        fresh = self.climb(self.ladder([1, 2, 4], tessera=tessera, folder="new", is_timed=False))
        for name in ("spp", "rel_mse"):
            self.assertEqual([r[name] for r in refined], [r[name] for r in fresh], name)
        for one, other in zip(refined, fresh):
            # Of the same render a byte more or less may be sent.
            self.assertAlmostEqual(one["bytes"] / other["bytes"], 1, delta=0.01)

    def test_a_step_is_one_from_where_it_went_on(self):
        self.climb(self.ladder([2, 32]))
        tessera = FakeTessera()
        rows = self.climb(self.ladder([2, 8, 32], tessera=tessera))
        self.assertEqual([r["bytes"] for r in rows], [2, 8, 32])
        steps = [c for c in tessera.calls if c[0] == "render"]
        self.assertEqual([c[c.index("--spp") + 1] for c in steps], ["8", "32"])

    def test_a_process_without_samples_is_one_of_the_first_step(self):
        self.climb(self.ladder([2, 32]))
        tessera = FakeTessera()
        self.climb(self.ladder([1, 32], tessera=tessera))
        continued = [c[c.index("--continue") + 1] for c in tessera.calls if "--continue" in c]
        self.assertEqual([pathlib.Path(c).name for c in continued], ["1.1.film.exr"] * 2)


class OtherSettings(Base):
    def test_times_are_those_of_threads_and_jobs(self):
        folder = lambda **settings: self.ladder([4], **settings).store.folder
        self.assertEqual(folder(), folder(threads=2, jobs=1))
        self.assertNotEqual(folder(), folder(threads=1))
        self.assertNotEqual(folder(), folder(jobs=2))
        self.assertEqual(folder(is_timed=False), folder(is_timed=False, threads=1, jobs=2))

    def test_another_program_of_the_same_version_is_another_program(self):
        program = self.folder / "tessera"
        found = set()
        for text in ("one", "another"):
            program.write_text(f"#!/bin/sh\n# {text}\necho tessera 1.0\n", encoding="utf-8")
            program.chmod(0o755)
            tessera = programs.Tessera(str(program))
            each = self.ladder([4], tessera=tessera)
            found |= {each.store.folder, each.shared.folder}
        self.assertEqual(tessera.version(), "tessera 1.0")
        self.assertEqual(len(found), 4)

    def test_a_digest_is_that_of_the_content(self):
        file = self.folder / "file"
        file.write_text("one", encoding="utf-8")
        before = programs.digest_of(file)
        self.assertEqual(programs.digest_of(file), before)
        file.write_text("another", encoding="utf-8")
        self.assertNotEqual(programs.digest_of(file), before)

    def test_adaptive_sampling_has_the_longest_step_as_its_limit(self):
        chosen = (RAW, REGRESSION, ADAPTIVE)
        for spp in ([4, 16], [4, 16, 64]):
            tessera = FakeTessera()
            with mock.patch.object(ladder.Ladder, "_measured",
                                   return_value={"rel_mse": 0.1, "bias": 0.0}):
                self.climb(self.ladder(spp, chosen, tessera))
            limits = [c[c.index("--spp") + 1] for c in tessera.calls if "--target-error" in c]
            self.assertEqual(limits, [str(spp[-1])] * (len(spp) - 1))

    def test_networks_are_those_of_program_and_weights(self):
        program = self.folder / "program"
        program.write_text("one", encoding="utf-8")
        for name in sum(oidn.WEIGHTS.values(), ()):
            (self.folder / f"{name}.tza").write_text("one", encoding="utf-8")
        each = self.ladder([4], oidn=str(program), oidn_weights=self.folder)
        keys = lambda: {each.key(m, 1, 4) for m in oidn.WEIGHTS}
        first = keys()
        self.assertEqual(keys(), first)
        (self.folder / "rt_hdr_alb_nrm.tza").write_text("another", encoding="utf-8")
        self.assertEqual(len(first & keys()), 1)  # the other network's
        program.write_text("another", encoding="utf-8")
        self.assertFalse(first & keys())

    def test_another_blender_gives_other_pictures(self):
        each, found = self.ladder([4]), set()
        for version in ("Blender 3.4", "Blender 4.2"):
            with mock.patch.object(peers_of, "_blender", return_value=version):
                found.add(each.key(methods.CYCLES, 1, 4))
        self.assertEqual(len(found), 2)

    def test_adaptive_counts_are_those_of_target_and_limit(self):
        plan = types.SimpleNamespace(tessera=FakeTessera(), size="32x18")
        each = types.SimpleNamespace(plan=plan, store=Store(self.folder),
                                     view=types.SimpleNamespace(file="x.glb", flags=()))
        goals = (("--target-error", 0.1, "--spp", 8), ("--target-error", 0.2, "--spp", 8),
                 ("--target-error", 0.1, "--spp", 16))
        with mock.patch.object(adaptive, "_raw_mean", return_value=1.0):
            for _ in range(2):
                for goal in goals:
                    self.assertEqual(adaptive._render(each, "adaptive", 1, goal)["spp"], goal[3])
        self.assertEqual(len(plan.tessera.calls), len(goals))


class AdaptiveNeedsItsTarget(Base):
    def points(self, *, rel_mse=0.1, without=None):
        """Of a finished run, whose results of regression are then lost if `without`."""
        each = self.ladder([4, 16], (RAW, REGRESSION, ADAPTIVE))
        with mock.patch.object(ladder.Ladder, "_measured",
                               return_value={"rel_mse": rel_mse, "bias": 0.0}):
            self.climb(each)
        if without:
            each.store.path(each.key("regression", 1, 4) + ".json").unlink()
        return each, [r["method"] for r in each.points() if r["spp"] == 4]

    def test_comes_after_all_filters_in_whatever_order_they_are_named(self):
        denoisers = [{"name": n, "halo_px": {"preview": 1, "final": 1}, "options": []}
                     for n in ("none", "regression", "nlm")]
        for text in ("adaptive,regression", "adaptive,all", "regression,adaptive,nlm"):
            chosen = [m.name for m in methods.choose(text, denoisers, False)]
            self.assertEqual(chosen[-1], methods.ADAPTIVE, text)
        with self.assertRaises(errors.BadInput):
            methods.choose("adaptive,oidn", denoisers, False)

    def test_is_a_point_where_its_target_is(self):
        each, found = self.points()
        self.assertEqual(found, ["raw", "regression", "adaptive"])
        self.assertEqual(each.left_out, [])

    def test_is_left_out_and_told_where_its_target_is_missing(self):
        each, found = self.points(without=True)
        self.assertEqual(found, ["raw"])
        self.assertEqual(len(each.left_out), 1)
        self.assertIn("no result of regression", each.left_out[0])
        said = io.StringIO()
        with (contextlib.redirect_stderr(said),
              mock.patch.object(command.results, "write_points", side_effect=KeyboardInterrupt),
              self.assertRaises(KeyboardInterrupt)):
            command.write_all([each], each.plan, self.folder)
        self.assertIn(each.left_out[0], said.getvalue())

    def test_is_left_out_and_told_where_the_target_is_noise(self):
        each, found = self.points(rel_mse=-1e-9)
        self.assertEqual(found, ["raw", "regression"])
        self.assertIn("within the references' noise", each.left_out[0])


class SweepCharts(Base):
    def test_a_lamp_is_in_view_in_one_sweep(self):
        failure = sweeps.FAILURES["rim of a lamp"]
        self.assertEqual((failure.spp, min(failure.values), max(failure.values)), (4, 10, 10000))
        for value in failure.values:
            self.assertGreater(len(failure.scene(value).encode()), 1000)

    def test_every_failure_has_a_panel(self):
        rows = [{"failure": name, "severity": value, "method": method, "ratio": 0.5, "least": 0.4,
                 "greatest": 0.6} for name, failure in sweeps.FAILURES.items()
                for value in failure.values for method in ("raw", "regression")]
        with mock.patch.object(filters.drawing, "save") as save:
            filters.draw_sweeps(rows, self.folder / "chart")
        titles = [axes.get_title() for axes in save.call_args.args[0].axes]
        self.assertEqual([t for t in titles if t], list(sweeps.FAILURES))


if __name__ == "__main__":
    unittest.main()
