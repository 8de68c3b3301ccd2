#!/usr/bin/python3
"""Breaks a farm of real processes while it renders, and checks that nothing shows.

  bench/farm_faults.py --build build/release kills [--kills 50] [--workers 3]
      SIGKILLs random workers and the server and starts them again, amid one job.
  bench/farm_faults.py --build build/release network
      Workers as hosts in network namespaces (needs root, `ip`, `tc` and `nft`): one link is cut and
      restored, one loses packets, one is slow.

  bench/farm_faults.py --build build/release restart [--jobs 100]
      Kills a server that keeps so many jobs and an unfinished film of 1920x1080, and times its
      starts.

Prints what was done, how long the server took to serve again, how soon work of a lost worker was
handed out again, and whether the digest is that of one process alone. Exit code 1 if it is not, if
the server took more than 2 s to serve, or work was handed out again after more than 3 s; with
--loaded, on a machine that does other things as well, times are printed and not judged.
"""

import argparse
import contextlib
import json
import os
import pathlib
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

CLIENT_WAIT_S = 600
SERVING_MAX_S = 2.0
RELEASE_MAX_S = 3.0
RESTARTS = 5


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


class Farm:
    """A server that keeps its ports and its data over restarts, and its workers."""

    def __init__(self, programs: pathlib.Path, folder: pathlib.Path, host="127.0.0.1",
                 server_options=()):
        self.programs, self.folder, self.host = programs, folder, host
        self.port, self.http_port = free_ports(2)
        self.server_options = list(server_options)
        self.server = None
        self.workers = {}

    def _start(self, name: str, command) -> subprocess.Popen:
        with (self.folder / f"{name}.log").open("a", encoding="utf-8") as log:
            return subprocess.Popen([str(part) for part in command], stdout=log, stderr=log)

    def start_server(self) -> float:
        """Returns the seconds until it serves."""
        begin = time.monotonic()
        self.server = self._start("server", [
            self.programs / "tessera-server", "--listen", f"{self.host}:{self.port}",
            "--http", f"127.0.0.1:{self.http_port}", "--data-dir", self.folder / "data",
            *self.server_options])
        while not self.is_serving():
            if self.server.poll() is not None:
                raise SystemExit(f"the server ended: {self.folder}/server.log")
            time.sleep(0.005)
        return time.monotonic() - begin

    def is_serving(self) -> bool:
        return self.get("/healthz") is not None

    def get(self, path: str):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.http_port}{path}",
                                        timeout=2) as answer:
                return answer.read().decode()
        except (urllib.error.URLError, OSError):
            return None

    def metric(self, name: str, label="") -> float:
        """The sum over those of the metric's labels that hold `label`; 0 where there is none."""
        return sum(float(value) for labels, value in
                   re.findall(rf"^{name}(\S*) (\S+)$", self.get("/metrics") or "", re.M)
                   if label in labels)

    def start_worker(self, name: str, prefix=(), address=None, options=()) -> None:
        self.workers[name] = self._start(name, [
            *prefix, self.programs / "tessera-worker", "--name", name, "--threads", "1",
            "--server", address or f"127.0.0.1:{self.port}", *options])

    def stop(self) -> None:
        for process in [*self.workers.values(), self.server]:
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()


def client(programs, *arguments) -> dict:
    done = subprocess.run([str(programs / "tessera"), *[str(a) for a in arguments]],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        return {"failed": done.returncode, "error": done.stderr.strip().splitlines()[-1:]}
    return json.loads(done.stdout or "{}")


def render_options(arguments) -> list:
    return [arguments.scene, "--size", arguments.size, "--spp", arguments.spp, "--denoiser", "none",
            "--seed", "3", "--json"]


class Waiting:
    """`tessera render --server` in the background: the client that must not notice anything."""

    def __init__(self, arguments, farm: Farm, output: pathlib.Path):
        self.process = subprocess.Popen(
            [str(part) for part in [farm.programs / "tessera", "render", *render_options(arguments),
                                    "-o", output, "--server", f"127.0.0.1:{farm.port}",
                                    "--insecure"]],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def wait_for_samples(self, farm: Farm) -> None:
        """A client that has never reached the server says so at once, as it should."""
        while farm.metric("tessera_samples_total") == 0 and self.is_running():
            time.sleep(0.05)

    def is_running(self) -> bool:
        return self.process.poll() is None

    def result(self) -> dict:
        out, err = self.process.communicate(timeout=CLIENT_WAIT_S)
        if self.process.returncode != 0:
            raise SystemExit(f"the client failed with {self.process.returncode}: {err.strip()}")
        return json.loads(out)


def expected_digest(arguments, programs, folder) -> str:
    alone = client(programs, "render", *render_options(arguments), "-o", folder / "alone.exr")
    if "failed" in alone:
        raise SystemExit(f"one process alone failed: {alone['error']}")
    print(f"one process alone: {alone['seconds']['total']:.0f} s, digest {alone['digest'][:16]}")
    return alone["digest"]


def run_kills(arguments, programs, folder) -> bool:
    expected = expected_digest(arguments, programs, folder)
    rng = random.Random(arguments.seed)
    farm = Farm(programs, folder)
    serving = []
    with contextlib.ExitStack() as stack:
        stack.callback(farm.stop)
        farm.start_server()
        for index in range(arguments.workers):
            farm.start_worker(f"worker{index}")
        waiting = Waiting(arguments, farm, folder / "farm.exr")
        waiting.wait_for_samples(farm)
        kills = {"server": 0, "worker": 0}
        while sum(kills.values()) < arguments.kills and waiting.is_running():
            time.sleep(rng.uniform(0.3, 2 * arguments.interval))
            if rng.random() < arguments.server_share:
                kills["server"] += 1
                farm.server.kill()
                farm.server.wait()
                serving.append(farm.start_server())
            else:
                kills["worker"] += 1
                name = rng.choice(sorted(farm.workers))
                farm.workers[name].kill()
                farm.workers[name].wait()
                farm.start_worker(name)
        was_running = waiting.is_running()
        result = waiting.result()
    print(f"killed: {kills['worker']} times a worker, {kills['server']} times the server"
          + ("" if was_running else " (the job ended before the last kill: give more --spp)"))
    if serving:
        serving.sort()
        print(f"from the server's start to serving again: median {serving[len(serving) // 2]:.2f} s,"
              f" worst {serving[-1]:.2f} s")
    in_time = is_in_time(arguments, "serving again", max(serving, default=0), SERVING_MAX_S)
    return report(result, expected) and sum(kills.values()) >= arguments.kills and in_time


def is_in_time(arguments, what: str, seconds: float, limit: float) -> bool:
    if seconds <= limit:
        return True
    print(f"TOO LATE: {what} took {seconds:.2f} s, the target is {limit:g} s"
          + (" (the machine is said to be loaded)" if arguments.loaded else ""))
    return arguments.loaded


def run_restart(arguments, programs, folder) -> bool:
    farm = Farm(programs, folder, server_options=["--client-jobs", str(2 * arguments.jobs)])
    address = ["--server", f"127.0.0.1:{farm.port}"]
    with contextlib.ExitStack() as stack:
        stack.callback(farm.stop)
        farm.start_server()
        for index in range(arguments.jobs):
            size = "1920x1080" if index == 0 else "64x36"
            job = client(programs, "submit", arguments.scene, "--size", size, "--spp", 65536,
                         "--seed", index, "--priority", -min(index, 1), "--denoiser", "none",
                         "--json", *address)
            if "failed" in job:
                raise SystemExit(f"job {index} was refused: {job['error']}")
        farm.start_worker("worker0")
        # Until a checkpoint of the film, 30 s apart, holds a pass over the frame.
        film = folder / "data" / "films" / "1.film"
        begin = time.monotonic()
        while time.monotonic() - begin < 120 and not (film.exists()
                                                      and film.stat().st_size > 50e6):
            time.sleep(0.2)
        farm.workers["worker0"].kill()
        farm.workers["worker0"].wait()
        jobs = farm.metric("tessera_jobs")
        serving = []
        for _ in range(RESTARTS):
            farm.server.kill()
            farm.server.wait()
            serving.append(farm.start_server())
        kept = farm.metric("tessera_jobs")
        megabytes = film.stat().st_size / 1e6 if film.exists() else 0
    serving.sort()
    print(f"{kept:.0f} of {jobs:.0f} jobs, the first with a film of {megabytes:.0f} MB: from the "
          f"server's start to serving again: median {serving[len(serving) // 2]:.2f} s, worst "
          f"{serving[-1]:.2f} s of {RESTARTS}")
    in_time = is_in_time(arguments, "serving again", serving[-1], SERVING_MAX_S)
    return kept == jobs >= arguments.jobs and megabytes > 50 and in_time


def report(result: dict, expected: str) -> bool:
    same = result["digest"] == expected
    print(f"the job: {result['seconds']['total']:.0f} s, digest {result['digest'][:16]}: "
          + ("the same" if same else "ANOTHER"))
    return same


def ip(*arguments) -> None:
    subprocess.run(["ip", *arguments], check=True)


def check_network_tools(parser: argparse.ArgumentParser) -> None:
    """Before minutes of rendering, not after."""
    if os.geteuid() != 0:
        parser.error("network namespaces need root: run it with sudo")
    missing = [tool for tool in ("ip", "nft", "tc") if shutil.which(tool) is None]
    if missing:
        parser.error(f"no {', '.join(missing)} here: apt-get install iproute2 nftables")


class Host:
    """A network namespace with a link of its own to the server's."""

    def __init__(self, index: int):
        self.name, self.link = f"tessera-h{index}", f"tessera-v{index}"
        self.server_address, address = f"10.177.{index}.1", f"10.177.{index}.2"
        ip("netns", "add", self.name)
        ip("link", "add", self.link, "type", "veth", "peer", "name", "eth0", "netns", self.name)
        ip("addr", "add", f"{self.server_address}/24", "dev", self.link)
        ip("link", "set", self.link, "up")
        ip("-n", self.name, "addr", "add", f"{address}/24", "dev", "eth0")
        ip("-n", self.name, "link", "set", "eth0", "up")
        ip("-n", self.name, "link", "set", "lo", "up")

    def run(self, *command) -> None:
        subprocess.run(["ip", "netns", "exec", self.name, *command], check=True)

    def cut(self) -> None:
        """Silently: no end is told, as when a switch loses power."""
        self.run("nft", "add", "table", "inet", "cut")
        for hook in ("input", "output"):
            self.run("nft", "add", "chain", "inet", "cut", hook,
                     f"{{ type filter hook {hook} priority -10; policy drop; }}")

    def restore(self) -> None:
        self.run("nft", "delete", "table", "inet", "cut")

    def lose(self, percent: int) -> None:
        self.run("nft", "add", "table", "inet", "loss")
        self.run("nft", "add", "chain", "inet", "loss", "input",
                 "{ type filter hook input priority 0; }")
        self.run("nft", "add", "rule", "inet", "loss", "input", "numgen", "random", "mod", "100",
                 "<", str(percent), "drop")

    def slow_down(self, rate: str) -> None:
        self.run("tc", "qdisc", "add", "dev", "eth0", "root", "tbf", "rate", rate, "burst", "64k",
                 "latency", "200ms")

    def remove(self) -> None:
        subprocess.run(["ip", "netns", "del", self.name], check=False)


def await_samples_of(farm: Farm, host: str, waiting: Waiting) -> None:
    count = farm.metric("tessera_worker_samples_total", host)
    while farm.metric("tessera_worker_samples_total", host) <= count and waiting.is_running():
        time.sleep(0.05)


def has_leases(farm: Farm, host: str) -> bool:
    """Over HTTP: the start of a client would take as long as what is measured on busy cores."""
    return farm.get("/healthz") is None or farm.metric("tessera_worker_leases", host) > 0


def run_network(arguments, programs, folder) -> bool:
    expected = expected_digest(arguments, programs, folder)
    farm = Farm(programs, folder, host="0.0.0.0", server_options=["--insecure"])
    with contextlib.ExitStack() as stack:
        hosts = []
        for index in range(3):
            hosts.append(Host(index))
            stack.callback(hosts[-1].remove)
        hosts[1].lose(5)
        hosts[2].slow_down("8mbit")
        stack.callback(farm.stop)
        farm.start_server()
        for host in hosts:
            farm.start_worker(host.name, prefix=["ip", "netns", "exec", host.name],
                              address=f"{host.server_address}:{farm.port}", options=["--insecure"])
        waiting = Waiting(arguments, farm, folder / "farm.exr")
        waiting.wait_for_samples(farm)
        releases, returns = [], []
        while waiting.is_running() and len(releases) < arguments.cuts:
            begin = time.monotonic()
            await_samples_of(farm, hosts[0].name, waiting)
            returns.append(time.monotonic() - begin)
            if not waiting.is_running():
                break
            hosts[0].cut()
            begin = time.monotonic()
            while has_leases(farm, hosts[0].name) and waiting.is_running():
                time.sleep(0.05)
            if not waiting.is_running():
                break
            releases.append(time.monotonic() - begin)
            hosts[0].restore()
        result = waiting.result()
    print(f"links: one cut and restored {len(releases)} times, one losing 5 % of packets, one of "
          "8 Mbit/s")
    if releases:
        print("from the cut until nothing waits for the lost worker, its work being handed out again "
              f"or done by others: worst {max(releases):.1f} s of {len(releases)}")
    if len(returns) > 1:
        print(f"from the link's return to new samples over it: worst {max(returns[1:]):.1f} s")
    in_time = is_in_time(arguments, "handing out again", max(releases, default=0), RELEASE_MAX_S)
    return report(result, expected) and len(releases) == arguments.cuts and in_time


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["kills", "network", "restart"])
    parser.add_argument("--build", type=pathlib.Path, required=True, help="the build folder")
    parser.add_argument("--scene", type=pathlib.Path, help="default: the project's still life")
    parser.add_argument("--size", default="320x180")
    parser.add_argument("--spp", type=int, default=1024)
    parser.add_argument("--seed", type=int, default=1, help="of the faults")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--interval", type=float, default=1.0, help="mean seconds between kills")
    parser.add_argument("--server-share", type=float, default=0.2, help="of the kills")
    parser.add_argument("--cuts", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=100, help="that the restarted server keeps")
    parser.add_argument("--loaded", action="store_true", help="times are not judged")
    arguments = parser.parse_args()
    if arguments.what == "network":
        check_network_tools(parser)
    programs = arguments.build.resolve() / "bin"
    arguments.scene = arguments.scene or arguments.build / "scenes" / "still_life.glb"
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="tessera-faults-") as folder:
        run = {"kills": run_kills, "network": run_network, "restart": run_restart}
        is_good = run[arguments.what](arguments, programs, pathlib.Path(folder))
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
