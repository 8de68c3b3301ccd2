"""Copies of the program for x86-64-v2 and x86-64-v3 make the same bits, and the launcher chooses.

Environment: V2, V3 (programs compiled for each level), LAUNCHER (its executable), COPIES (where it
looks for copies, from its own folder), SCENES (the project's scenes), BUILD (to install), CMAKE.
"""

import json
import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import unittest

LEVELS = {"x86-64-v2": os.environ["V2"], "x86-64-v3": os.environ["V3"]}
SCENES = pathlib.Path(os.environ["SCENES"])
EMULATOR = shutil.which("qemu-x86_64")  # package qemu-user
OLD_PROCESSOR = ["-cpu", "Nehalem-v1"]  # x86-64-v2: SSE4.2 and POPCNT, no AVX
OLDER_PROCESSOR = ["-cpu", "core2duo-v1"]  # not even x86-64-v2
LEAST_SETTINGS = ["--size", "12x8", "--spp", "4", "--max-depth", "3", "--threads", "1"]


def run(command, **settings):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True,
                          check=False, timeout=900, **settings)


def here_runs(isa):
    flags = pathlib.Path("/proc/cpuinfo").read_text().split()
    return {"x86-64-v2": "sse4_2", "x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}[isa] in flags


class PortableTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def render(self, program, scene, settings, runner=()):
        """The film's digest and the bytes of the denoised picture."""
        picture = self.folder / "picture.png"
        done = run([*runner, program, "render", SCENES / f"{scene}.glb", "-o", picture, "--json",
                    "--quiet", *settings])
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)["digest"], picture.read_bytes()

    def install(self, *levels):
        """A prefix whose copies tell their level and arguments; returns the launcher in it."""
        prefix = pathlib.Path(tempfile.mkdtemp(dir=self.folder))
        launcher = prefix / "bin" / "tessera"
        launcher.parent.mkdir()
        shutil.copy(os.environ["LAUNCHER"], launcher)
        for level in levels:
            copy = launcher.parent / os.environ["COPIES"] / level / "tessera"
            copy.parent.mkdir(parents=True)
            copy.write_text(f'#!/bin/sh\necho {level} "$@"\n')
            copy.chmod(0o755)
        return launcher

    def test_copies_make_the_same_bits_within_a_class(self):
        for scene in ["still_life", "window_room", "many_lights"]:
            digests = []
            for isa in filter(here_runs, ["x86-64-v2", "x86-64-v3", "x86-64-v4"]):
                settings = ["--size", "96x54", "--spp", "16", "--isa", isa]
                made = [self.render(program, scene, settings) for program in LEVELS.values()]
                self.assertEqual(made[0][0], made[1][0], f"film of {scene}, {isa}")
                self.assertEqual(made[0][1], made[1][1], f"picture of {scene}, {isa}")
                digests.append(made[0][0])
            # Or the flag would do nothing: Embree's kernels differ in some hits.
            if len(digests) > 1:
                self.assertGreater(len(set(digests)), 1, scene)

    def test_the_launcher_takes_the_fastest_copy(self):
        fastest = max(filter(here_runs, LEVELS))
        for installed, taken in [(LEVELS, fastest), (["x86-64-v2"], "x86-64-v2")]:
            done = run([self.install(*installed), "render", "a scene"])
            self.assertEqual(done.stdout, f"{taken} render a scene\n", done.stderr)

    def test_what_is_installed_runs_and_finds_its_parts(self):
        done = run([os.environ["CMAKE"], "--install", os.environ["BUILD"], "--component",
                    "runtime", "--prefix", self.folder / "prefix"])
        self.assertEqual(done.returncode, 0, done.stderr)
        programs = self.folder / "prefix" / "bin"
        for program in ["tessera", "tessera-server", "tessera-worker"]:
            done = run([programs / program, "--help"])
            self.assertEqual(done.returncode, 0, done.stderr)
        done = run([programs / "tessera", "chart", "no-such-scene.glb", "-o", self.folder / "out"])
        self.assertIn("no-such-scene.glb", done.stderr)
        self.assertNotIn("cannot be started", done.stderr)

    def test_a_prefix_without_copies_is_named(self):
        done = run([self.install(), "list"])
        self.assertEqual(done.returncode, 2)
        self.assertIn("no copy of the program", done.stderr)
        self.assertEqual(len(done.stderr.splitlines()), 1)

    @unittest.skipUnless(EMULATOR, "no qemu-x86_64 (package qemu-user)")
    def test_the_launcher_on_an_old_processor(self):
        done = run([EMULATOR, *OLD_PROCESSOR, self.install(*LEVELS), "list"])
        self.assertEqual(done.stdout, "x86-64-v2 list\n", done.stderr)
        done = run([EMULATOR, *OLD_PROCESSOR, self.install("x86-64-v3"), "list"])
        self.assertEqual(done.returncode, 2)
        self.assertIn("runs none of the installed copies (x86-64-v3)", done.stderr)
        self.assertEqual(len(done.stderr.splitlines()), 1)

    @unittest.skipUnless(EMULATOR, "no qemu-x86_64 (package qemu-user)")
    def test_an_old_processor_renders_and_says_in_which_class(self):
        # Not the bits of this machine: the emulator's approximate reciprocals are its own.
        done = run([EMULATOR, *OLD_PROCESSOR, LEVELS["x86-64-v2"], "render",
                    SCENES / "cornell.glb", "-o", self.folder / "old.exr", *LEAST_SETTINGS])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("rendering with --isa x86-64-v2", done.stderr)
        self.assertTrue((self.folder / "old.exr").is_file())

    def render_v3(self, picture, settings, runner=()):
        """Digest, processor arithmetic and warnings of a small render by the v3 copy."""
        done = run([*runner, LEVELS["x86-64-v3"], "render", SCENES / "cornell.glb", "-o", picture,
                    "--layers", "all", "--json", *settings])
        self.assertEqual(done.returncode, 0, done.stderr)
        arithmetic = re.search(rb'"arithmetic":"([0-9a-f]{16})"', picture.read_bytes())
        self.assertIsNotNone(arithmetic, "not among the picture's settings")
        return json.loads(done.stdout)["digest"], arithmetic.group(1).decode(), done.stderr

    @unittest.skipUnless(EMULATOR, "no qemu-x86_64 (package qemu-user)")
    def test_processors_of_one_arithmetic_make_the_same_bits(self):
        # Left alone, Embree takes narrow kernels, with other bits, on the second of these.
        made = [self.render_v3(self.folder / "emulated.exr", LEAST_SETTINGS,
                               [EMULATOR, "-cpu", processor])[:2]
                for processor in ["Haswell-v4", "Skylake-Server-v1"]]
        self.assertEqual(made[0], made[1])

    @unittest.skipUnless(EMULATOR, "no qemu-x86_64 (package qemu-user)")
    @unittest.skipUnless(here_runs("x86-64-v3"), "this processor lacks AVX2")
    def test_a_replay_in_another_arithmetic_says_so(self):
        digest, arithmetic, _ = self.render_v3(self.folder / "first.exr", LEAST_SETTINGS)
        again, other, warnings = self.render_v3(
            self.folder / "again.exr", ["--replay", self.folder / "first.exr", "--threads", "1"],
            [EMULATOR, "-cpu", "Haswell-v4"])
        self.assertNotEqual(arithmetic, other)
        self.assertNotEqual(digest, again)
        self.assertIn(arithmetic, warnings)
        self.assertIn("replay it on a processor like the first", warnings)

    @unittest.skipUnless(EMULATOR, "no qemu-x86_64 (package qemu-user)")
    def test_a_copy_says_what_it_needs_instead_of_dying(self):
        for level, processor in [("x86-64-v2", OLDER_PROCESSOR), ("x86-64-v3", OLD_PROCESSOR)]:
            done = run([EMULATOR, *processor, LEVELS[level], "list"])
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn(f"cannot run programs compiled for {level}", done.stderr)


if __name__ == "__main__":
    unittest.main()
