"""The commands about jobs, against a real server with a worker on loopback."""

import pathlib
import re
import signal
import subprocess
import unittest

from command_line_case import CommandLineCase, Farm, TESSERA, TIMEOUT_SECONDS

SMALL = ["--size", "40x24", "--spp", "4"]
ENDLESS = ["--size", "256x256", "--spp", "1000000"]


class FarmCommands(CommandLineCase):
    def setUp(self):
        super().setUp()
        self.farm = Farm(self)
        self.server = ["--server", self.farm.address]

    def test_render_on_the_farm_equals_render_here(self):
        here = self.expect_json("render", "triangle.glb", "-o", "here.exr", *SMALL)
        there = self.expect_json("render", "triangle.glb", "-o", "there.exr", *SMALL, *self.server)
        self.assertEqual(here["digest"], there["digest"])
        self.assertEqual(self.expect_json("compare", "here.exr", "there.exr")["rel_mse"], 0)

    def test_life_of_a_job(self):
        name = self.expect_done("submit", "triangle.glb", *SMALL, *self.server).strip()
        self.assertRegex(name, r"^jobs/\d+$")
        self.assertEqual(self.expect_json("watch", name, *self.server)["state"], "done")
        self.assertEqual(self.expect_json("show", name, *self.server)["samples"], 40 * 24 * 4)
        jobs = self.expect_json("list", *self.server)["jobs"]
        self.assertEqual([job["name"] for job in jobs], [name])
        self.assertIn(name, self.expect_done("list", *self.server))
        self.expect_done("fetch", name, "-o", "a.exr", "-o", "a.png", *self.server)
        self.expect_done("fetch", name, "-o", "part.exr", "--region", "8,8,4,4", "--layers", "Z,id",
                         *self.server)
        self.expect_done("delete", name, *self.server)
        self.expect_error(2, [name], "show", name, *self.server)
        self.assertEqual(self.expect_json("list", *self.server)["jobs"], [])

    def test_steering(self):
        name = self.expect_done("submit", "triangle.glb", *ENDLESS, *self.server).strip()
        self.assertEqual(self.expect_json("pause", name, *self.server)["state"], "paused")
        self.assertIn(self.expect_json("resume", name, *self.server)["state"],
                      ["queued", "running"])
        self.assertIn(self.expect_json("cancel", name, *self.server)["state"],
                      ["finishing", "cancelled"])
        watched = self.run_tessera("watch", name, *self.server)
        self.assertEqual(watched.returncode, 4)

    def test_looking(self):
        name = self.expect_done("submit", "triangle.glb", *ENDLESS, "--look", "0,0,8,8",
                                *self.server).strip()
        for where in ("8,8,16,16", "none", "255,255,1,1"):
            self.assertEqual(self.expect_json("look", name, where, *self.server)["name"], name)
        self.expect_error(2, ["region"], "look", name, "250,250,16,16", *self.server)
        self.expect_error(2, ["jobs/77"], "look", "jobs/77", "none", *self.server)
        self.expect_done("cancel", name, *self.server)

    def interrupt(self, *arguments):
        """Sends SIGINT to a command that talks to the server; returns code and stderr."""
        process = subprocess.Popen([TESSERA, *arguments, *self.server], cwd=self.folder,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(process.kill)
        # It has taken over the signal once a second signal number is in its caught set.
        caught = 0
        while not caught & (1 << (signal.SIGINT - 1)):
            status = pathlib.Path(f"/proc/{process.pid}/status").read_text()
            caught = int(re.search(r"SigCgt:\s*([0-9a-f]+)", status).group(1), 16)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=TIMEOUT_SECONDS)
        return process.returncode, stderr

    def test_ctrl_c_ends_the_watching_not_the_job(self):
        name = self.expect_done("submit", "triangle.glb", *ENDLESS, *self.server).strip()
        code, stderr = self.interrupt("watch", name)
        self.assertEqual(code, 4, stderr)
        self.assertEqual(stderr, f"tessera: interrupted: {name} goes on\n")
        self.assertIn(self.expect_json("show", name, *self.server)["state"], ["queued", "running"])

    def test_ctrl_c_in_render_cancels_its_job(self):
        code, stderr = self.interrupt("render", "triangle.glb", "-o", "a.png", *ENDLESS)
        self.assertEqual(code, 4, stderr)
        jobs = self.expect_json("list", *self.server)["jobs"]
        for job in jobs:
            self.assertEqual(job["state"], "cancelled")

    def test_workers(self):
        # The first job's end proves that the worker is connected.
        self.expect_done("render", "triangle.glb", "-o", "a.png", *SMALL, *self.server)
        workers = self.expect_json("workers", *self.server)["workers"]
        self.assertEqual([worker["threads"] for worker in workers], [1])
        self.assertIn("workers/", self.expect_done("workers", *self.server))

    def test_continue_uploads_the_film(self):
        whole = self.expect_json("render", "triangle.glb", "-o", "w.exr", "--size", "40x24",
                                 "--spp", "11")
        self.expect_done("render", "triangle.glb", "-o", "film.exr", "--layers", "film", *SMALL,
                         *self.server)
        more = self.expect_json("render", "triangle.glb", "--continue", "film.exr", "--spp", "11",
                                "-o", "m.exr", *self.server)
        self.assertEqual(more["digest"], whole["digest"])

    def test_a_cancelled_job_can_be_replayed(self):
        name = self.expect_done("submit", "triangle.glb", *ENDLESS, *self.server).strip()
        while self.expect_json("show", name, *self.server)["samples"] == 0:
            pass
        self.expect_done("cancel", name, *self.server)
        self.assertEqual(self.run_tessera("watch", name, *self.server).returncode, 4)
        self.expect_done("fetch", name, "-o", "cut.exr", *self.server)
        cut = self.expect_json("show", name, *self.server)
        here = self.expect_json("render", "triangle.glb", "--replay", "cut.exr", "-o", "h.png")
        self.assertEqual(here["digest"], cut["digest"])
        there = self.expect_json("render", "triangle.glb", "--replay", "cut.exr", "-o", "t.png",
                                 "--tile-size", "16", *self.server)
        self.assertEqual(there["digest"], cut["digest"])
        self.expect_done("fetch", name, "-o", "part.exr", "--region", "0,0,8,8", *self.server)
        self.expect_error(2, ["part.exr", "--region"], "render", "triangle.glb", "--replay",
                          "part.exr", "-o", "p.png")

    def test_scene_that_the_loader_refuses_leaves_other_jobs_alone(self):
        good = self.expect_done("submit", "triangle.glb", *SMALL, *self.server).strip()
        self.write("bad.gltf", '{"asset":{"version":"2.0"},"extensionsRequired":["ACME_x"],'
                               '"extensionsUsed":["ACME_x"]}')
        self.expect_error(2, ["ACME_x"], "render", "bad.gltf", "-o", "b.png", *SMALL, *self.server)
        self.assertEqual(self.expect_json("watch", good, *self.server)["state"], "done")

    def test_server_that_dies_while_it_is_watched(self):
        # Watching gives up after about a minute; a command that begins afterwards does at once.
        name = self.expect_done("submit", "triangle.glb", *SMALL, *self.server).strip()
        self.expect_json("watch", name, *self.server)
        self.farm.server.kill()
        self.farm.server.wait()
        self.expect_error(3, [f"no server at {self.farm.address}"], "show", name, *self.server)


if __name__ == "__main__":
    unittest.main()
