"""`tessera render` without a server: outputs, figures, films, interruption and continuation."""

import json
import os
import pty
import re
import signal
import subprocess
import unittest

from command_line_case import CommandLineCase, TESSERA, TIMEOUT_SECONDS, triangle_gltf

CANCELLED = 4
SMALL = ["--size", "40x24", "--spp", "4"]


class Render(CommandLineCase):
    def test_json_has_exactly_the_stable_fields(self):
        result = self.expect_json("render", "triangle.glb", "-o", "a.exr", "-o", "a.png", *SMALL)
        self.assertEqual(list(result), ["digest", "width", "height", "spp", "samples", "rays",
                                        "non_finite", "seconds", "error", "stopped_by", "bytes",
                                        "outputs"])
        self.assertEqual(set(result["seconds"]), {"load", "render", "filter", "total"})
        self.assertEqual(set(result["error"]), {"rel_rmse", "promised"})
        self.assertEqual(set(result["bytes"]), {"assets", "deltas"})
        self.assertRegex(result["digest"], "^[0-9a-f]{64}$")
        self.assertEqual((result["width"], result["height"]), (40, 24))
        self.assertEqual(result["samples"], 40 * 24 * 4)
        self.assertEqual(result["stopped_by"], "spp")
        self.assertEqual(result["outputs"], ["a.exr", "a.png"])
        self.assertEqual((self.folder / "a.png").read_bytes()[1:4], b"PNG")
        self.assertEqual((self.folder / "a.exr").read_bytes()[:4], b"\x76\x2f\x31\x01")

    def test_the_same_bits_for_any_threads_and_tiles(self):
        digests = {self.expect_json("render", "triangle.glb", "-o", "a.png", *SMALL,
                                    *flags)["digest"]
                   for flags in ([], ["--threads", "1"], ["--tile-size", "16"],
                                 ["--tile-size", "7", "--threads", "2"])}
        self.assertEqual(len(digests), 1)
        other = self.expect_json("render", "triangle.glb", "-o", "a.png", *SMALL, "--seed", "1")
        self.assertNotIn(other["digest"], digests)

    def test_notes_and_quiet(self):
        loud = self.run_tessera("render", "triangle.glb", "-o", "a.png", *SMALL)
        self.assertIn("neutral sky", loud.stderr)
        self.assertIn("a.png", loud.stdout)
        quiet = self.run_tessera("render", "triangle.glb", "-o", "a.png", *SMALL, "--quiet")
        self.assertEqual((quiet.stdout, quiet.stderr, quiet.returncode), ("", "", 0))

    def test_region_and_transparency(self):
        self.expect_done("render", "triangle.glb", "-o", "whole.exr", *SMALL)
        part = self.expect_json("render", "triangle.glb", "-o", "part.exr", *SMALL, "--region",
                                "8,4,16,16", "--transparent")
        self.assertEqual(part["samples"], 16 * 16 * 4)
        done = self.run_tessera("compare", "part.exr", "whole.exr")
        self.assertEqual(done.returncode, 2, "other pixels cannot be compared")

    def test_film_denoises_to_the_served_picture(self):
        self.expect_done("render", "triangle.glb", "-o", "film.exr", "--layers", "film", *SMALL)
        self.expect_done("denoise", "film.exr", "-o", "again.exr")
        self.assertEqual(self.expect_json("compare", "again.exr", "film.exr")["rel_mse"], 0)
        self.expect_done("denoise", "film.exr", "--denoiser", "none", "-o", "raw.exr")
        self.assertGreater(self.expect_json("compare", "raw.exr", "film.exr")["rel_mse"], 0)

    def test_two_halves_of_any_renderer(self):
        self.expect_done("render", "triangle.glb", "-o", "a.exr", *SMALL, "--denoiser", "none")
        self.expect_done("render", "triangle.glb", "-o", "b.exr", *SMALL, "--denoiser", "none",
                         "--seed", "1")
        self.expect_done("render", "triangle.glb", "-o", "ref.exr", "--size", "40x24", "--spp",
                         "1024")
        self.expect_done("denoise", "a.exr", "b.exr", "-o", "joined.exr")
        joined = self.expect_json("compare", "joined.exr", "ref.exr")
        half = self.expect_json("compare", "a.exr", "ref.exr")
        self.assertLess(joined["rel_mse"], half["rel_mse"])


class Continue(CommandLineCase):
    def test_more_samples_give_the_bits_of_one_render(self):
        digests = set()
        # The film has more samples than carry features, exactly as many, fewer, and all.
        for features in ("2", "4", "8", "all"):
            flags = ["--feature-spp", features]
            whole = self.expect_json("render", "triangle.glb", "-o", "w.exr", "--size", "40x24",
                                     "--spp", "11", *flags)
            self.expect_done("render", "triangle.glb", "-o", "film.exr", "--layers", "film",
                             *SMALL, *flags)
            more = self.expect_json("render", "triangle.glb", "--continue", "film.exr", "-o",
                                    "m.exr", "--spp", "11")
            self.assertEqual(more["digest"], whole["digest"])
            self.assertEqual(more["samples"], whole["samples"])
            digests.add(whole["digest"])
        self.assertEqual(len(digests), 4)

    def test_other_settings_are_refused(self):
        self.expect_done("render", "triangle.glb", "-o", "film.exr", "--layers", "film", *SMALL)
        self.expect_error(2, ["--seed", "--max-depth"], "render", "triangle.glb", "--continue",
                          "film.exr", "-o", "m.exr", "--seed", "9", "--max-depth", "1")
        self.expect_error(2, ["--feature-spp", "the film's is 64"], "render", "triangle.glb",
                          "--continue", "film.exr", "-o", "m.exr", "--feature-spp", "16")
        self.expect_error(2, ["--feature-spp 48", "power of two"], "render", "triangle.glb", "-o",
                          "m.exr", "--feature-spp", "48")
        self.expect_error(2, ["--spp 3", "4 samples"], "render", "triangle.glb", "--continue",
                          "film.exr", "-o", "m.exr", "--spp", "3")
        self.expect_done("render", "triangle.glb", "-o", "plain.exr", *SMALL)
        self.expect_error(2, ["plain.exr", "--layers film"], "render", "triangle.glb",
                          "--continue", "plain.exr", "-o", "m.exr")


class AutoDepth(CommandLineCase):
    def test_what_the_pilot_finds_is_a_number_like_any_other(self):
        small = ["--size", "16x12", "--spp", "4", "--sky", "1,1,1"]
        found = self.expect_json("render", "triangle.glb", "-o", "auto.exr", "--layers", "film",
                                 "--max-depth", "auto", *small)
        self.assertEqual(found["max_depth"], 0)  # one triangle: no light is reflected twice
        number = self.expect_json("render", "triangle.glb", "-o", "n.exr", "--max-depth", "0",
                                  *small)
        self.assertEqual(found["digest"], number["digest"])
        for threads, tile in (("1", "8"), ("3", "32")):
            again = self.expect_json("render", "triangle.glb", "-o", "a.exr", "--max-depth", "auto",
                                     "--threads", threads, "--tile-size", tile, *small)
            self.assertEqual(again["digest"], found["digest"])
        more = self.expect_json("render", "triangle.glb", "--continue", "auto.exr", "-o", "m.exr",
                                "--spp", "8")
        straight = self.expect_json("render", "triangle.glb", "-o", "n.exr", "--max-depth", "0",
                                    "--size", "16x12", "--spp", "8", "--sky", "1,1,1")
        self.assertEqual(more["digest"], straight["digest"])
        self.expect_error(2, ["--max-depth (the film's is 0)"], "render", "triangle.glb",
                          "--continue", "auto.exr", "-o", "m.exr", "--max-depth", "auto")
        replayed = self.expect_json("render", "triangle.glb", "--replay", "auto.exr", "-o", "r.png")
        self.assertEqual(replayed["digest"], found["digest"])
        self.expect_error(2, ["--max-depth some", "0 to 1024, or auto"], "render", "triangle.glb",
                          "-o", "a.exr", "--max-depth", "some")


class Replay(CommandLineCase):
    def test_any_picture_can_be_replayed(self):
        first = self.expect_json("render", "triangle.glb", "-o", "a.exr", *SMALL, "--seed", "3")
        again = self.expect_json("render", "triangle.glb", "--replay", "a.exr", "-o", "b.png")
        self.assertEqual(again["digest"], first["digest"])

    def test_what_cannot_give_the_same_bits_is_refused(self):
        self.expect_done("render", "triangle.glb", "-o", "a.exr", *SMALL)
        replay = ["render", "triangle.glb", "--replay", "a.exr", "-o", "b.exr"]
        self.expect_error(2, ["--replay", "--seed"], *replay, "--seed", "9")
        self.expect_error(2, ["--replay", "--max-depth"], *replay, "--max-depth", "1")
        for flags in (["--spp", "8"], ["--max-time", "1"], ["--target-error", "0.1"],
                      ["--continue", "a.exr"]):
            self.expect_error(2, [flags[0], "replay"], *replay, *flags)
        self.write("other.gltf", triangle_gltf().replace("0.8", "0.9"))
        self.expect_error(2, ["--replay", "the scene's files"], "render", "other.gltf", "--replay",
                          "a.exr", "-o", "b.exr")
        self.expect_done("render", "triangle.glb", "-o", "c.exr", *SMALL, "--layers", "final,Z")
        self.expect_error(2, ["c.exr", "--layers"], "render", "triangle.glb", "--replay", "c.exr",
                          "-o", "b.exr")
        data = (self.folder / "a.exr").read_bytes()
        version = self.expect_done("--version").split()[1].encode()
        self.assertIn(version, data)
        other = version[:-1] + (b"0" if version[-1:] != b"0" else b"1")
        self.write("old.exr", data.replace(version, other))
        self.expect_error(2, ["--replay", other.decode(), version.decode()], "render",
                          "triangle.glb", "--replay", "old.exr", "-o", "b.exr")
        self.assertFalse((self.folder / "b.exr").exists())


class Interrupt(CommandLineCase):
    def interrupt_render(self, *flags, twice=False):
        """Sends SIGINT once the progress bar shows samples; returns exit code, stdout, stderr.

        twice: a second one at once, as timeout(1) sends it.
        """
        terminal, stderr = pty.openpty()
        process = subprocess.Popen([TESSERA, "render", "triangle.glb", "--size", "128x128",
                                    "--spp", "1000000", *flags], cwd=self.folder, stderr=stderr,
                                   stdout=subprocess.PIPE, text=True)
        self.addCleanup(process.kill)
        os.close(stderr)
        shown = ""
        while not re.search(r"(?!0\.0)\d+\.\d/1000000 spp", shown):
            shown += os.read(terminal, 4096).decode()
        process.send_signal(signal.SIGINT)
        if twice:
            while "interrupted" not in shown:
                shown += os.read(terminal, 4096).decode()
            process.send_signal(signal.SIGINT)
        try:
            while True:
                shown += os.read(terminal, 4096).decode()
        except OSError:  # the other end is closed
            pass
        os.close(terminal)
        stdout, _ = process.communicate(timeout=TIMEOUT_SECONDS)
        return process.returncode, stdout, shown

    def test_two_signals_at_once_are_one_interruption(self):
        code, _, stderr = self.interrupt_render("-o", "twice.png", twice=True)
        self.assertEqual(code, CANCELLED, stderr)
        self.assertTrue(os.path.exists(os.path.join(self.folder, "twice.png")), stderr)

    def test_saves_the_picture_and_a_film_to_continue(self):
        code, stdout, stderr = self.interrupt_render("-o", "a.png", "--json")
        self.assertEqual(code, CANCELLED, stderr)
        self.assertIn("--continue a.film.exr", stderr)
        result = json.loads(stdout)
        self.assertEqual(result["stopped_by"], "cancelled")
        self.assertEqual(result["outputs"], ["a.png", "a.film.exr"])
        self.assertTrue((self.folder / "a.png").exists())
        # A power of two well above: some tiles are ahead of the mean.
        spp = 1
        while spp < 4 * (result["spp"] + 1):
            spp *= 2
        more = self.expect_json("render", "triangle.glb", "--continue", "a.film.exr", "-o",
                                "more.png", "--spp", str(spp))
        straight = self.expect_json("render", "triangle.glb", "--size", "128x128", "-o",
                                    "straight.png", "--spp", str(spp))
        self.assertEqual(more["digest"], straight["digest"])

    def test_an_interrupted_render_can_be_replayed(self):
        # Tiles of unequal sample counts: the schedule is in the picture (contract C2).
        code, stdout, stderr = self.interrupt_render("-o", "a.exr", "--json")
        self.assertEqual(code, CANCELLED, stderr)
        cut = json.loads(stdout)
        for flags in ([], ["--threads", "1"], ["--tile-size", "16"], ["--tile-size", "5"]):
            again = self.expect_json("render", "triangle.glb", "--replay", "a.exr", "-o",
                                     "again.exr", *flags)
            self.assertEqual(again["digest"], cut["digest"], flags)
            self.assertEqual(again["samples"], cut["samples"])
        self.assertEqual(self.expect_json("compare", "again.exr", "a.exr")["rel_mse"], 0)
        twice = self.expect_json("render", "triangle.glb", "--replay", "again.exr", "-o", "b.exr")
        self.assertEqual(twice["digest"], cut["digest"])

    def test_film_output_serves_itself(self):
        code, stdout, stderr = self.interrupt_render("-o", "a.exr", "--layers", "film", "--json")
        self.assertEqual(code, CANCELLED, stderr)
        self.assertEqual(json.loads(stdout)["outputs"], ["a.exr"])
        self.assertIn("--continue a.exr", stderr)


class FullDisk(CommandLineCase):
    def render_to_small_disk(self, *flags):
        """Runs tessera render -o small/a.exr, small a file system of 16 KiB; needs root."""
        small, spare = self.folder / "small", self.folder / "spare"
        small.mkdir()
        spare.mkdir()
        in_small = ["unshare", "--mount", "sh", "-c",
                    "mount -t tmpfs -o size=16k none small && exec \"$@\"", "sh"]
        if subprocess.run([*in_small, "true"], cwd=self.folder, stderr=subprocess.DEVNULL,
                          check=False).returncode != 0:
            self.skipTest("cannot mount a file system")
        return subprocess.run([*in_small, TESSERA, "render", "triangle.glb", "-o", "small/a.exr",
                               "--size", "128x128", "--spp", "4", *flags], cwd=self.folder,
                              env={**os.environ, "TMPDIR": str(spare)}, capture_output=True,
                              text=True, timeout=TIMEOUT_SECONDS, check=False)

    def test_samples_are_kept_where_there_is_room(self):
        run = self.render_to_small_disk()
        self.assertNotEqual(run.returncode, 0)
        (film,) = (self.folder / "spare").glob("a.film.*.exr")
        self.assertIn("small/a.exr", run.stderr)
        self.assertIn(f"tessera denoise {film}", run.stderr)
        more = self.expect_json("render", "triangle.glb", "--continue", str(film), "-o", "more.png",
                                "--spp", "8")
        straight = self.expect_json("render", "triangle.glb", "--size", "128x128", "-o",
                                    "straight.png", "--spp", "8")
        self.assertEqual(more["digest"], straight["digest"])


class Info(CommandLineCase):
    def test_describes_the_scene(self):
        info = self.expect_json("info", "triangle.glb")
        self.assertEqual(info["triangles"], 1)
        self.assertTrue(info["renderable"])
        self.assertIn("triangles", self.expect_done("info", "triangle.glb"))
        self.expect_error(2, ["missing.glb"], "info", "missing.glb")

    def test_a_scene_that_cannot_be_rendered_is_described_as_far_as_it_goes(self):
        scene = json.loads(triangle_gltf())
        scene["extensionsUsed"] = scene["extensionsRequired"] = ["ACME_unheard_of"]
        self.write("bad.gltf", json.dumps(scene))
        text = self.run_tessera("info", "bad.gltf")
        self.assertEqual(text.returncode, 2)
        self.assertEqual(len(text.stderr.splitlines()), 1, text.stderr)
        self.assertIn("ACME_unheard_of", text.stderr)
        self.assertRegex(text.stdout, r"triangles +unknown")
        self.assertRegex(text.stdout, r"cameras +front")
        self.assertRegex(text.stdout, r"extensions_unsupported +ACME_unheard_of")
        done = self.run_tessera("info", "bad.gltf", "--json")
        self.assertEqual(done.returncode, 2)
        info = json.loads(done.stdout)
        self.assertFalse(info["renderable"])
        self.assertIn("ACME_unheard_of", info["error"])
        self.assertIsNone(info["triangles"])
        self.assertEqual(info["cameras"], ["front"])


class Completion(CommandLineCase):
    def complete(self, *words):
        script = ("source <(\"$TESSERA\" completion); COMP_WORDS=(\"$@\"); "
                  "COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _tessera; "
                  "printf '%s\\n' \"${COMPREPLY[@]}\"")
        done = subprocess.run(["bash", "-c", script, "bash", *words], cwd=self.folder,
                              capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=True)
        self.assertEqual(done.stderr, "")
        return done.stdout.split()

    def test_script_is_valid_and_completes(self):
        script = self.expect_done("completion")
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)
        self.assertEqual(self.complete("tessera", "rend"), ["render"])
        self.assertEqual(self.complete("tessera", "render", "--target-e"), ["--target-error"])
        self.assertEqual(self.complete("tessera", "render", "--quality", "p"), ["preview"])
        self.assertEqual(self.complete("tessera", "render", "tri"), ["triangle.glb"])
        self.assertEqual(self.complete("tessera", "list", "--spp"), [])
        self.assertEqual(self.complete("tessera", "render", "--isa", "x86-64-v4"), ["x86-64-v4"])


class Help(CommandLineCase):
    def test_flags_list_the_values_that_they_take(self):
        text = " ".join(self.expect_done("render", "--help").split())
        for word in ["bilateral", "nlm", "welch", "geometric", "none", "x86-64-v3", "x86-64-v4", "variance",
                     "samples", "film", "--replay"]:
            self.assertIn(word, text)
        text = self.expect_done("denoise", "--help")
        for word in ["bilateral", "--half-a", "--half-b", "--albedo-variance", "--normal-b"]:
            self.assertIn(word, text)


if __name__ == "__main__":
    unittest.main()
