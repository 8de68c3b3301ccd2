"""Work side by side: errors and Ctrl-C end everything, children with it."""

import pathlib
import signal
import tempfile
import threading
import unittest

from tessera_chart import lanes, programs


class Lanes(unittest.TestCase):
    def test_all_work_is_done_in_any_number_of_lanes(self):
        for num_lanes in (1, 2, 5):
            done = []
            lanes.run([lambda i=i: done.append(i) for i in range(20)], num_lanes)
            self.assertEqual(sorted(done), list(range(20)))

    def test_lanes_run_side_by_side(self):
        both = threading.Barrier(2, timeout=60)  # a single lane would wait for ever
        lanes.run([both.wait, both.wait], 2)

    def test_an_error_ends_the_children_and_leaves_the_rest(self):
        done = []

        def fail():
            raise ValueError("no")

        with self.assertRaises(ValueError):
            lanes.run([lambda: programs.run(["sleep", "1000"]), fail, lambda: done.append(1)], 2)
        self.assertEqual(done, [])

    def test_ctrl_c_ends_the_children_of_all_lanes(self):
        # Not inherited: a build service may start its tests with SIGINT ignored.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        self.addCleanup(signal.signal, signal.SIGINT, before)
        with tempfile.TemporaryDirectory() as folder:
            # The second to come sends Ctrl-C, and both would stay for ever.
            script = pathlib.Path(folder) / "stay"
            script.write_text(f"#!/bin/sh\nmkdir {folder}/first 2>/dev/null || "
                              f"{{ mkdir {folder}/second 2>/dev/null && kill -INT $PPID; }}\n"
                              "exec sleep 1000\n")
            script.chmod(0o755)
            with self.assertRaises(KeyboardInterrupt):
                lanes.run([lambda: programs.run([str(script)])] * 3, 2)
        lanes.run([lambda: programs.run(["true"])], 2)  # another run may start

    def test_peak_memory_and_cpu_are_those_of_the_child(self):
        spent = programs.run(["/usr/bin/python3", "-c", "x = bytearray(b'1' * 200_000_000)"])
        self.assertGreater(spent.peak_bytes, 200_000_000)
        self.assertGreater(spent.cpu_s, 0)


if __name__ == "__main__":
    unittest.main()
