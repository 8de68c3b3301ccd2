"""A farm with TLS, tokens and worker certificates, as docs/operations.md sets it up."""

import signal
import subprocess
import unittest

from command_line_case import SERVER, WORKER, TIMEOUT_SECONDS, CommandLineCase, Farm


class SecuredFarm(CommandLineCase):

    def openssl(self, *arguments):
        subprocess.run(["openssl", *arguments], cwd=self.folder, check=True, capture_output=True)

    def setUp(self):
        super().setUp()
        key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
        self.openssl("req", "-x509", *key, "-days", "1", "-subj", "/CN=ca",
                     "-keyout", "ca.key", "-out", "ca.pem")
        self.write("names", "subjectAltName=IP:127.0.0.1\n")
        for who in ("server", "worker"):
            self.openssl("req", *key, "-subj", f"/CN={who}", "-keyout", f"{who}.key",
                         "-out", f"{who}.csr")
            self.openssl("x509", "-req", "-in", f"{who}.csr", "-CA", "ca.pem", "-CAkey", "ca.key",
                         "-CAcreateserial", "-days", "1", "-extfile", "names",
                         "-out", f"{who}.pem")
        self.write("tokens", "submit sam 0123456789abcdef\nview lena fedcba9876543210\n")
        (self.folder / "tokens").chmod(0o600)
        self.write("sam", "0123456789abcdef\n")
        self.write("lena", "fedcba9876543210\n")
        self.write("wrong", "0000000000000000\n")

    def path(self, name):
        return str(self.folder / name)

    def start(self):
        farm = Farm(
            self,
            server_flags=["--tls-cert", self.path("server.pem"), "--tls-key",
                          self.path("server.key"), "--client-ca", self.path("ca.pem"),
                          "--token-file", self.path("tokens")],
            worker_flags=["--ca", self.path("ca.pem"), "--cert", self.path("worker.pem"),
                          "--key", self.path("worker.key")])
        self.server = ["--server", farm.address]
        self.tls = [*self.server, "--ca", "ca.pem"]
        return farm

    def test_render_with_a_token_equals_render_here(self):
        self.start()
        flags = ["triangle.glb", "-o", "a.exr", "--size", "24x16", "--spp", "4"]
        here = self.expect_json("render", *flags)
        there = self.expect_json("render", *flags, *self.tls, "--token-file", "sam")
        self.assertEqual(here["digest"], there["digest"])
        self.assertIn("jobs/1", self.expect_done("list", *self.tls, "--token-file", "lena"))

    def test_who_may_not(self):
        self.start()
        submit = ["submit", "triangle.glb", "--size", "24x16", "--spp", "4", *self.tls]
        self.expect_error(2, ["--token-file"], *submit)
        self.expect_error(2, ["not one of this server's"], *submit, "--token-file", "wrong")
        self.expect_error(2, ["lena", "role view", "needs submit"], *submit, "--token-file", "lena")
        self.expect_error(3, ["start one with tessera-server"], "list", *self.server)

    def test_a_worker_without_a_certificate_leaves_with_the_reason(self):
        farm = self.start()
        done = subprocess.run([WORKER, "--server", farm.address, "--ca", self.path("ca.pem")],
                              capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False)
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("--token-file", done.stderr)

    def test_a_worker_over_tls_drains_at_sigterm(self):
        farm = self.start()
        worker = farm.workers[0]
        worker.send_signal(signal.SIGTERM)
        self.assertIn("left", worker.communicate(timeout=TIMEOUT_SECONDS)[1])
        self.assertEqual(worker.returncode, 0)

    def test_server_flags_that_do_not_fit(self):
        done = subprocess.run([SERVER, "--listen", "127.0.0.1:0", "--http", "off",
                               "--tls-cert", self.path("server.pem"),
                               "--tls-key", self.path("worker.key")],
                              capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False)
        self.assertEqual(done.returncode, 2)
        self.assertIn("is not the key of", done.stderr)


if __name__ == "__main__":
    unittest.main()
