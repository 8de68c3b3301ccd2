"""Bad input of every kind: one line on stderr, the stated exit code, nothing on stdout."""

import json
import os
import socket
import unittest

from command_line_case import CommandLineCase, POSITIONS, triangle_glb, triangle_gltf

BAD_INPUT, UNAVAILABLE = 2, 3


class BadScenes(CommandLineCase):
    def expect_bad_scene(self, name, *words):
        self.expect_error(BAD_INPUT, words, "render", name, "-o", "out.exr", "--spp", "1",
                          "--size", "8x8")
        self.assertFalse((self.folder / "out.exr").exists())

    def test_files_that_are_no_scenes(self):
        glb = triangle_glb()
        self.expect_bad_scene("missing.glb", "missing.glb")
        self.expect_bad_scene(self.write("empty.glb", b""), "empty.glb", "is empty")
        self.expect_bad_scene(self.write("short.glb", glb[:10]), "short.glb", "truncated")
        self.expect_bad_scene(self.write("cut.glb", glb[:len(glb) // 2]), "cut.glb", "truncated")
        self.expect_bad_scene(self.write("text.glb", "solid teapot\n"), "text.glb", "not glTF")
        self.expect_bad_scene(self.write("other.gltf", "{}"), "other.gltf", "not glTF")
        self.expect_bad_scene(".", "is a folder")

    def test_files_that_the_scene_names(self):
        self.write("a.gltf", triangle_gltf("mesh.bin"))
        self.expect_bad_scene("a.gltf", "a.gltf", "buffers[0].uri", "mesh.bin")
        self.write("b.gltf", triangle_gltf("../mesh.bin"))
        self.expect_bad_scene("b.gltf", "b.gltf", "buffers[0].uri", "leaves the scene's folder")
        self.write("c.gltf", triangle_gltf("file:///etc/passwd"))
        self.expect_bad_scene("c.gltf", "buffers[0].uri", "file:///etc/passwd")

    def test_names_with_dots_and_percent_signs_work(self):
        self.write("textures/mesh 50%.bin", POSITIONS)
        self.write("d.gltf", triangle_gltf("./textures/mesh%2050%25.bin"))
        self.expect_done("render", "d.gltf", "-o", "d.png", "--spp", "1", "--size", "8x8")

    def test_errors_that_only_the_loader_sees(self):
        scene = json.loads(triangle_gltf())
        scene["extensionsUsed"] = scene["extensionsRequired"] = ["ACME_unheard_of"]
        self.write("required.gltf", json.dumps(scene))
        self.expect_bad_scene("required.gltf", "ACME_unheard_of")
        scene = json.loads(triangle_gltf())
        scene["nodes"][0]["children"] = [0]
        self.write("cycle.gltf", json.dumps(scene))
        self.expect_bad_scene("cycle.gltf", "node")


class BadFlags(CommandLineCase):
    def expect_bad_flag(self, words, *flags):
        self.expect_error(BAD_INPUT, words, "render", "triangle.glb", "-o", "out.exr", *flags)
        self.assertFalse((self.folder / "out.exr").exists())

    def test_values(self):
        self.expect_bad_flag(["--size", "0x0"], "--size", "0x0")
        self.expect_bad_flag(["--size", "1000000x1000000"], "--size", "1000000x1000000")
        self.expect_bad_flag(["--spp", "0"], "--spp", "0")
        self.expect_bad_flag(["--spp", "-4"], "--spp", "-4")
        self.expect_bad_flag(["--spp", "1000000000000"], "--spp", "1000000000000")
        self.expect_bad_flag(["--spp", "many"], "--spp", "many")
        self.expect_bad_flag(["--fov-y", "nan"], "--look-from", "0,0,1", "--look-at", "0,0,0",
                             "--fov-y", "nan")
        self.expect_bad_flag(["--region"], "--size", "64x64", "--region", "60,60,8,8")
        self.expect_bad_flag(["--denoiser", "geometric"], "--denoiser", "magic")
        self.expect_bad_flag(["--isa m68k", "x86-64-v3"], "--isa", "m68k")
        self.expect_bad_flag(["--threads", "0"], "--threads", "0")
        self.expect_bad_flag(["camera", "behind", "front"], "--camera", "behind")
        self.expect_bad_flag(["--env", "sky.hdr"], "--env", "sky.hdr")
        self.expect_bad_flag(["--continue", "film.exr"], "--continue", "film.exr")
        self.expect_bad_flag(["--sparkle"], "--sparkle")

    def test_environment_that_is_no_picture(self):
        self.write("sky.hdr", "not a picture")
        self.expect_bad_flag(["sky.hdr"], "--env", "sky.hdr", "--size", "8x8", "--spp", "1")

    def test_outputs_are_checked_before_rendering(self):
        absurd = ["--size", "4096x4096", "--spp", "1000000"]  # would take days
        for output in ["out.jpg", "no/such/folder/out.exr", "/proc/out.png"]:
            self.expect_error(BAD_INPUT, [output], "render", "triangle.glb", "-o", output, *absurd)
        os.mkdir(self.folder / "folder.exr")
        self.expect_error(BAD_INPUT, ["folder.exr"], "render", "triangle.glb", "-o", "folder.exr",
                          *absurd)

    def test_commands(self):
        self.expect_error(BAD_INPUT, ["tessera --help"])
        self.expect_error(BAD_INPUT, ["tessera --help"], "paint")
        self.expect_error(BAD_INPUT, ["-o"], "render", "triangle.glb")
        self.expect_error(BAD_INPUT, ["scene"], "render")
        self.expect_error(BAD_INPUT, ["--server"], "list")
        self.expect_error(BAD_INPUT, ["jobs/N"], "show", "seven", "--server", "127.0.0.1:1")

    def test_pictures_that_are_none(self):
        self.write("bad.exr", b"\x76\x2f\x31\x01 and no more")
        self.expect_error(BAD_INPUT, ["bad.exr"], "compare", "bad.exr", "bad.exr")
        self.expect_error(BAD_INPUT, ["bad.exr"], "denoise", "bad.exr", "-o", "out.exr")
        self.expect_error(BAD_INPUT, ["missing.exr"], "compare", "missing.exr", "bad.exr")


class BadServers(CommandLineCase):
    def test_unreachable(self):
        with socket.socket() as unused:
            unused.bind(("127.0.0.1", 0))  # bound, but nobody listens
            address = "127.0.0.1:%d" % unused.getsockname()[1]
            self.expect_error(UNAVAILABLE, [f"no server at {address}", "tessera-server"],
                              "render", "triangle.glb", "-o", "out.exr", "--server", address)
            self.expect_error(UNAVAILABLE, [f"no server at {address}"], "list", "--server", address)

    def test_addresses(self):
        for address, words in [("farm", "names no port"), ("farm:x", "its port"),
                               ("::1:4242", "brackets"), ("http://farm:4242", "is a URL"),
                               ("", "empty")]:
            self.expect_error(BAD_INPUT, ["--server", words], "render", "triangle.glb", "-o",
                              "out.exr", "--server", address)
            self.assertFalse((self.folder / "out.exr").exists())

    def test_plaintext_stays_on_this_machine(self):
        self.expect_error(BAD_INPUT, ["--insecure"], "list", "--server", "farm.invalid:4242")


if __name__ == "__main__":
    unittest.main()
