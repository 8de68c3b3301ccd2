"""`tessera denoise` of two halves of any renderer: what may come with them, and what may be wrong."""

import json
import random
import struct
import unittest

from command_line_case import CommandLineCase

BAD_INPUT = 2
WIDTH, HEIGHT = 24, 16
RGB = ("R", "G", "B")


def exr(channels, width=WIDTH, height=HEIGHT):
    """An uncompressed EXR of float channels: {name: values, row by row}."""
    names = sorted(channels)

    def attribute(name, kind, data):
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(data)) + data

    listed = b"".join(n.encode() + b"\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1)
                      for n in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = (b"\x76\x2f\x31\x01" + struct.pack("<i", 2)
              + attribute(b"channels", b"chlist", listed)
              + attribute(b"compression", b"compression", b"\0")
              + attribute(b"dataWindow", b"box2i", window)
              + attribute(b"displayWindow", b"box2i", window)
              + attribute(b"lineOrder", b"lineOrder", b"\0")
              + attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
              + attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0))
              + attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)) + b"\0")
    row_bytes = 8 + 4 * width * len(names)
    first = len(header) + 8 * height
    rows = b"".join(
        struct.pack("<ii", y, 4 * width * len(names))
        + b"".join(struct.pack(f"<{width}f", *channels[n][y * width:(y + 1) * width])
                   for n in names)
        for y in range(height))
    return header + b"".join(struct.pack("<Q", first + y * row_bytes)
                             for y in range(height)) + rows


def noise(i, seed):
    """In [-0.5, 0.5), the same everywhere."""
    return random.Random(f"{i},{seed}").random() - 0.5


def picture(seed, names=RGB):
    """Left 0.2, right 0.8, with noise."""
    return {n: [(0.2 if i % WIDTH < WIDTH // 2 else 0.8) + 0.2 * noise(i, seed + n)
                for i in range(WIDTH * HEIGHT)] for n in names}


def constant(value, names=RGB):
    return {n: [value] * (WIDTH * HEIGHT) for n in names}


def sides(names):
    """1 on the left, 2 on the right."""
    return {n: [1.0 if i % WIDTH < WIDTH // 2 else 2.0 for i in range(WIDTH * HEIGHT)]
            for n in names}


class Halves(CommandLineCase):
    def setUp(self):
        super().setUp()
        self.write("a.exr", exr(picture("a")))
        self.write("b.exr", exr(picture("b")))
        self.write("truth.exr", exr({n: [0.6 * v - 0.4 for v in plane]
                                     for n, plane in sides(RGB).items()}))
        self.halves = ["--half-a", "a.exr", "--half-b", "b.exr"]

    def denoise(self, *flags):
        """Runs it; returns its JSON, whose notes must also be on stderr."""
        done = self.run_tessera("denoise", *self.halves, "-o", "out.exr", "--json", *flags)
        self.assertEqual(done.returncode, 0, done.stderr)
        result = json.loads(done.stdout)
        self.assertEqual(done.stderr.splitlines(), result["notes"])
        return result

    def error(self, *truth):
        return self.expect_json("compare", "out.exr", *(truth or ["truth.exr"]))["rel_mse"]

    def expect_refused(self, words, *arguments):
        self.expect_error(BAD_INPUT, words, "denoise", *arguments, "-o", "out.exr")
        self.assertFalse((self.folder / "out.exr").exists())

    def test_halves_alone(self):
        result = self.denoise()
        notes = "\n".join(result["notes"])
        for words in ["samples: not known", "variance: estimated", "albedo: none", "normal: none",
                      "depth: none"]:
            self.assertIn(words, notes)
        filtered = self.error()
        self.denoise("--denoiser", "none")
        self.assertLess(filtered, 0.5 * self.error())

    def test_paths_without_flags_are_the_same(self):
        self.denoise()
        self.expect_done("denoise", "a.exr", "b.exr", "-o", "again.exr")
        self.assertEqual(self.error("again.exr"), 0)

    def test_everything_that_may_come_along(self):
        self.write("v.exr", exr(constant(0.2**2 / 12 / 2)))
        self.write("albedo.exr", exr(sides(RGB)))
        self.write("n.exr", exr(sides(("X", "Y", "Z"))))
        self.write("z.exr", exr(sides(("Y",))))
        self.write("zv.exr", exr(constant(1e-6, ("Y",))))
        for denoiser in ["regression", "bilateral", "nlm", "welch", "geometric"]:
            self.denoise("--denoiser", denoiser)
            alone = self.error()
            result = self.denoise("--variance", "v.exr", "--spp", "16", "--albedo", "albedo.exr",
                                  "--normal", "n.exr", "--normal-b", "n.exr", "--depth", "z.exr",
                                  "--depth-variance", "zv.exr", "--denoiser", denoiser)
            notes = "\n".join(result["notes"])
            for words in ["from v.exr", "albedo: from albedo.exr, taken as free of noise",
                          "normal: from n.exr and n.exr, its noise from their difference",
                          "depth: from z.exr, its noise from zv.exr"]:
                self.assertIn(words, notes)
            self.assertNotIn("not known", notes)
            self.assertLess(self.error(), alone * 1.5, denoiser)

    def test_layers_of_the_halves_and_of_other_renderers(self):
        for half in "ab":
            layers = {f"ViewLayer.Combined.{n}": v for n, v in picture(half).items()}
            layers["Z"] = sides(("Z",))["Z"]
            layers["Z"][0] = float("inf")  # the sky
            self.write(f"{half}.exr", exr(layers))
        notes = "\n".join(self.denoise()["notes"])
        self.assertIn("depth: from layers of the halves", notes)
        self.assertIn("albedo: none", notes)

    def test_halves_rendered_by_tessera(self):
        for seed in "12":
            self.expect_done("render", "triangle.glb", "-o", f"{seed}.exr", "--size", "40x24",
                             "--spp", "4", "--seed", seed)
        done = self.run_tessera("denoise", "--half-a", "1.exr", "--half-b", "2.exr", "-o", "o.exr")
        self.assertEqual(done.returncode, 0, done.stderr)
        for words in ["variance: from the layers", "albedo: from layers", "depth: from layers"]:
            self.assertIn(words, done.stderr)
        self.assertNotIn("not known", done.stderr)

    def test_variances_that_underflowed(self):
        variance = constant(1e-3)
        variance["G"][7] = 0.0
        variance["B"][9] = float("nan")
        self.write("v.exr", exr(variance))
        self.assertIn("at 2 values", "\n".join(self.denoise("--variance", "v.exr")["notes"]))

    def test_what_is_missing_is_named(self):
        self.expect_refused(["--half-a", "FILM.exr"])
        self.expect_refused(["--half-a a.exr", "--half-b"], "--half-a", "a.exr")
        self.expect_refused(["--half-b b.exr", "--half-a"], "--half-b", "b.exr")
        self.expect_refused(["not both"], "a.exr", "--half-a", "a.exr")
        self.expect_refused(["--albedo", "film"], "a.exr", "--albedo", "b.exr")
        self.expect_refused(["--normal-b b.exr", "--normal too"], *self.halves, "--normal-b",
                            "b.exr")
        self.expect_refused(["--spp 1"], *self.halves, "--spp", "1")
        self.expect_refused(["missing.exr"], *self.halves, "--depth", "missing.exr")
        self.expect_refused(["two halves are no film"], *self.halves, "--layers", "film")

    def test_halves_that_are_equal(self):
        self.expect_refused(["a.exr", "another seed"], "--half-a", "a.exr", "--half-b", "a.exr")

    def test_files_of_other_sizes(self):
        self.write("small.exr", exr({n: [0.5] * 64 for n in RGB}, 8, 8))
        self.expect_refused(["small.exr", "8x8", "a.exr", "24x16"], "--half-a", "a.exr",
                            "--half-b", "small.exr")
        self.expect_refused(["small.exr", "8x8"], *self.halves, "--albedo", "small.exr")

    def test_files_without_the_channels(self):
        self.write("mask.exr", exr(constant(1.0, ("mask",))))
        self.expect_refused(["mask.exr", "colour", "R, G, B", "mask"], "--half-a", "mask.exr",
                            "--half-b", "b.exr")
        self.expect_refused(["mask.exr", "normal"], *self.halves, "--normal", "mask.exr")

    def test_values_that_are_no_numbers(self):
        broken = picture("c")
        broken["G"][5] = float("nan")
        self.write("nan.exr", exr(broken))
        self.expect_refused(["nan.exr", "channel G", "no numbers"], "--half-a", "nan.exr",
                            "--half-b", "b.exr")
        self.expect_refused(["nan.exr", "channel G"], *self.halves, "--albedo", "nan.exr")
        negative = constant(-1.0)
        self.write("v.exr", exr(negative))
        self.expect_refused(["v.exr", "negative"], *self.halves, "--variance", "v.exr")


if __name__ == "__main__":
    unittest.main()
