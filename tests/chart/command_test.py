"""`tessera chart` as a user runs it, at a size that takes seconds."""

import json
import os
import pathlib
import stat
import subprocess
import tempfile
import unittest

from tessera_chart import measures

TESSERA, SCENES = os.environ["TESSERA"], pathlib.Path(os.environ["SCENES"])
SMALL = ("--size", "32x18", "--spp", "1,2", "--seeds", "1", "--reference", "8", "--threads", "2")


def tessera(*arguments, program=None) -> subprocess.CompletedProcess:
    environment = dict(os.environ, PYTHONPATH="")
    if program:
        arguments = (*arguments, "--tessera", program)
    return subprocess.run([TESSERA, *map(str, arguments)], capture_output=True, text=True,
                          env=environment, check=False)


def chart_alone(*arguments) -> subprocess.CompletedProcess:
    """Without tessera in between, whose start costs more than all that bad input does."""
    command = [pathlib.Path(TESSERA).parent / "tessera-chart", *arguments, "--tessera", TESSERA]
    return subprocess.run([str(a) for a in command], capture_output=True, text=True, check=False)


class Chart(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.out = self.folder / "out"

    def chart(self, *arguments, code=0, program=None):
        done = tessera("chart", SCENES / "cornell.glb", "-o", self.out, *SMALL, *arguments,
                       program=program)
        self.assertEqual(done.returncode, code, done.stderr)
        return done

    def methods(self) -> set:
        points = json.loads((self.out / "points.json").read_text(encoding="utf-8"))["points"]
        # Rendering so little may cost no more than starting does.
        self.assertTrue(all(p["rel_mse"] > -1 and p["total_cpu_s"] >= 0 for p in points))
        self.assertTrue(all(p["filter_cpu_s"] > 0 for p in points if p["method"] != "raw"))
        return {p["method"] for p in points}

    def test_writes_points_charts_and_a_page_that_needs_no_network(self):
        done = self.chart("--methods", "raw,regression")
        self.assertIn("cornell: of CPU seconds", done.stdout)
        self.assertEqual(self.methods(), {"raw", "regression"})
        self.assertEqual(len((self.out / "points.csv").read_text().splitlines()), 1 + 2 * 2)
        for name in ("cornell.svg", "cornell.png", "all-scenes.svg", "multipliers.svg"):
            self.assertGreater((self.out / "charts" / name).stat().st_size, 1000)
        page = (self.out / "report.html").read_text(encoding="utf-8")
        self.assertNotRegex(page, r"""(src|href)=["']?(https?:)?//""")
        for word in ("regression", "difference", "reference"):
            self.assertIn(word, page)

    def test_every_filter_of_the_program_is_a_method(self):
        listed = json.loads(tessera("denoise", "--list", "--json").stdout)["denoisers"]
        done = tessera("chart", SCENES / "cornell.glb", "-o", self.out, "--methods", "x")
        self.assertEqual(done.returncode, 2)
        for entry in listed:
            self.assertIn("raw" if entry["name"] == "none" else entry["name"], done.stderr)

    def test_goes_on_where_it_was_stopped(self):
        # This program sends the chart Ctrl-C when it is called for the eighth time.
        stopping, calls = self.folder / "stopping", self.folder / "calls"
        stopping.write_text(f"#!/bin/sh\necho x >> {calls}\n"
                            f"[ $(wc -l < {calls}) -eq 8 ] && kill -INT $PPID\n"
                            f"exec {TESSERA} \"$@\"\n")
        stopping.chmod(stopping.stat().st_mode | stat.S_IXUSR)
        some = ("--methods", "raw,bilateral")
        done = self.chart(*some, code=4, program=stopping)
        self.assertIn("goes on from here", done.stderr)
        before = {p: p.stat().st_mtime_ns for p in self.out.glob("work/*/*.json")}
        self.assertGreater(len(before), 0)
        self.chart(*some, program=stopping)
        self.assertEqual(self.methods(), {"raw", "bilateral"})
        for path, time in before.items():
            self.assertEqual(path.stat().st_mtime_ns, time, path)

    def test_bad_input_is_one_line_and_code_2(self):
        for bad, word in ((["--spp", "4,x"], "--spp"), (["--size", "3"], "--size"),
                          (["--reference", "no.exr"], "no.exr"), (["--oidn", "no-such"], "no-such"),
                          (["--look-from", "1,2"], "--look-from")):
            done = chart_alone(SCENES / "cornell.glb", "-o", self.out, *SMALL, *bad)
            self.assertEqual(done.returncode, 2, bad)
            self.assertIn(word, done.stderr)
            self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        done = chart_alone(f"a={SCENES / 'cornell.glb'} --spp 4", "-o", self.out)
        self.assertEqual(done.returncode, 2)
        self.assertIn("--spp", done.stderr)


class Measures(unittest.TestCase):
    def test_agree_with_the_other_implementation(self):
        with tempfile.TemporaryDirectory() as folder:
            paths = [pathlib.Path(folder) / f"{seed}.exr" for seed in range(3)]
            for seed, path in enumerate(paths):
                tessera("render", SCENES / "cornell.glb", "-o", path, "--size", "64x36", "--spp",
                        1 if seed == 0 else 16, "--seed", seed, "--denoiser", "none", "--layers",
                        "final")
            for references in (paths[1:], paths[1:2]):
                theirs = json.loads(tessera("compare", paths[0], *references, "--json").stdout)
                ours = measures.Reference(*map(measures.read_rgb, references)).errors(
                    measures.read_rgb(paths[0]))
                # The other one encodes display values in float.
                for name in ("rel_mse", "rel_mse_trimmed", "flip"):
                    self.assertAlmostEqual(getattr(ours, name) / theirs[name], 1, 4, name)


if __name__ == "__main__":
    unittest.main()
