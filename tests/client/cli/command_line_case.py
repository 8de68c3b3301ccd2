"""What the tests of the command line share: a tiny scene, and running the binaries."""

import base64
import json
import os
import pathlib
import re
import struct
import subprocess
import tempfile
import unittest

TESSERA = os.environ["TESSERA"]
SERVER = os.environ["TESSERA_SERVER"]
WORKER = os.environ["TESSERA_WORKER"]
TIMEOUT_SECONDS = 100
POSITIONS = struct.pack("<9f", -1, -1, 0, 1, -1, 0, 0, 1, 0)


def triangle_gltf(buffer_uri=None):
    """A lit triangle in front of a camera, as the text of a .gltf."""
    uri = buffer_uri or "data:application/octet-stream;base64," + base64.b64encode(
        POSITIONS).decode()
    return json.dumps({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 0, 3]}],
        "cameras": [{"name": "front", "type": "perspective",
                     "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [-1, -1, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": uri}],
    })


def triangle_glb():
    text = triangle_gltf().encode()
    text += b" " * (-len(text) % 4)
    return (b"glTF" + struct.pack("<II", 2, 20 + len(text)) + struct.pack("<I", len(text))
            + b"JSON" + text)


class CommandLineCase(unittest.TestCase):
    """A folder with the scene triangle.glb, in which the commands run."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("triangle.glb", triangle_glb())

    def write(self, name, data):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return name

    def run_tessera(self, *arguments):
        return subprocess.run([TESSERA, *arguments], cwd=self.folder, capture_output=True,
                              text=True, timeout=TIMEOUT_SECONDS, check=False)

    def expect_done(self, *arguments):
        """Runs a command that must succeed; returns its stdout."""
        done = self.run_tessera(*arguments)
        self.assertEqual(done.returncode, 0, f"{arguments}: {done.stderr}")
        return done.stdout

    def expect_json(self, *arguments):
        return json.loads(self.expect_done(*arguments, "--json"))

    def expect_error(self, code, words, *arguments):
        """Runs a command that must fail with one line that has all the words."""
        done = self.run_tessera(*arguments)
        self.assertEqual(done.returncode, code, f"{arguments}: {done.stdout}{done.stderr}")
        lines = done.stderr.splitlines()
        self.assertEqual(len(lines), 1, f"{arguments}: {done.stderr}")
        self.assertTrue(lines[0].startswith("tessera: "), lines[0])
        for word in words:
            self.assertIn(word, lines[0], f"{arguments}")
        self.assertEqual(done.stdout, "")


class Farm:
    """A server and connected workers on loopback, at ports of the system's choice."""

    def __init__(self, case, num_workers=1, server_flags=(), worker_flags=()):
        self.server = self._start(case, [SERVER, "--listen", "127.0.0.1:0", "--http", "",
                                         *server_flags])
        listening = self._wait_for(case, self.server, r"grpc_port=(\d+)")
        self.address = "127.0.0.1:" + listening.group(1)
        self.workers = [self._start(case, [WORKER, "--server", self.address, "--threads", "1",
                                           *worker_flags])
                        for _ in range(num_workers)]
        for worker in self.workers:
            self._wait_for(case, worker, "connected as")

    @staticmethod
    def _wait_for(case, process, pattern):
        """Reads the log up to the line with `pattern`; returns the match."""
        while True:
            line = process.stderr.readline()
            case.assertNotEqual(line, "", "the program ended")
            if match := re.search(pattern, line):
                return match

    @staticmethod
    def _start(case, command):
        process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
                                   text=True)

        def stop():
            process.kill()
            process.communicate()

        case.addCleanup(stop)
        return process
