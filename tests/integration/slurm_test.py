"""Workers from a Slurm array: a real controller and node daemon, alone on this machine.

Skipped (exit code 77) where Slurm's programs are not installed or this is not root.
"""

import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time

TESSERA = os.environ["TESSERA"]
SERVER = os.environ["TESSERA_SERVER_PROGRAM"]
WORKER = os.environ["TESSERA_WORKER_PROGRAM"]
SCENE = os.environ["TESSERA_SCENE"]
SCRIPT = os.environ["TESSERA_SLURM_SCRIPT"]
PROGRAMS = ["slurmctld", "slurmd", "sbatch", "squeue", "scancel", "sinfo"]
LONGEST_SECONDS = 60
SKIPPED = 77


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def eventually(what, condition):
    give_up = time.monotonic() + LONGEST_SECONDS
    while not condition():
        if time.monotonic() > give_up:
            raise AssertionError(f"{what}: not within {LONGEST_SECONDS} s")
        time.sleep(0.1)


def run(*arguments, **options):
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=LONGEST_SECONDS,
                          check=False, **options)
    if done.returncode != 0:
        raise AssertionError(f"{arguments} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def configuration(folder):
    host = socket.gethostname()
    cpus = os.cpu_count()
    return "\n".join([
        "ClusterName=test", f"SlurmctldHost={host}(127.0.0.1)",
        "AuthType=auth/none", "CredType=cred/none", "SlurmUser=root", "SlurmdUser=root",
        f"SlurmctldPort={free_port()}", f"SlurmdPort={free_port()}",
        f"SlurmctldPidFile={folder}/ctld.pid", f"SlurmdPidFile={folder}/d.pid",
        f"StateSaveLocation={folder}/state", f"SlurmdSpoolDir={folder}/spool",
        "ProctrackType=proctrack/linuxproc", "TaskPlugin=task/none", "MpiDefault=none",
        "SelectType=select/cons_tres", "SelectTypeParameters=CR_CPU", "ReturnToService=2",
        "AccountingStorageType=accounting_storage/none", "JobAcctGatherType=jobacct_gather/none",
        f"NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN",
        "PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP", ""])


class Slurm:
    """The daemons; they end with the block."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        (self.folder / "state").mkdir()
        (self.folder / "spool").mkdir()
        (self.folder / "slurm.conf").write_text(configuration(folder))
        self.environment = {**os.environ, "SLURM_CONF": str(self.folder / "slurm.conf")}
        self.daemons = []

    def __enter__(self):
        for program in ("slurmctld", "slurmd"):
            log = open(self.folder / f"{program}.log", "w", encoding="utf-8")
            self.daemons.append(subprocess.Popen([program, "-D", "-c"] if program == "slurmctld"
                                                 else [program, "-D"],
                                                 env=self.environment, stdout=log, stderr=log))
        eventually("the node is idle", lambda: "idle" in subprocess.run(
            ["sinfo", "-h", "-o", "%t"], env=self.environment, capture_output=True, text=True,
            check=False).stdout)
        return self

    def __exit__(self, *_):
        subprocess.run(["scancel", "--me"], env=self.environment, check=False)
        eventually("the queue is empty", lambda: not self("squeue", "-h").strip())
        for daemon in reversed(self.daemons):
            daemon.terminate()
            daemon.wait()

    def __call__(self, *arguments):
        return run(*arguments, env=self.environment)


def test(folder):
    server = subprocess.Popen([SERVER, "--listen", "127.0.0.1:0", "--http", "off", "--port-file",
                               f"{folder}/ports"], stderr=subprocess.DEVNULL)
    try:
        eventually("the server listens", pathlib.Path(folder, "ports").exists)
        port = pathlib.Path(folder, "ports").read_text().split()[0].split("=")[1]
        address = f"127.0.0.1:{port}"
        with Slurm(folder) as slurm:
            logs = f"{folder}/worker-%a.log"
            job = slurm("sbatch", "--parsable", "--array=1-2", "--cpus-per-task=1",
                        f"--output={logs}", f"--export=ALL,TESSERA_WORKER_SERVER={address},"
                        f"TESSERA_WORKER={WORKER}", SCRIPT).strip()
            workers = lambda: run(TESSERA, "workers", "--server", address, "--json")
            eventually("two workers have come", lambda: workers().count('"workers/') == 2)
            run(TESSERA, "render", SCENE, "--size", "32x24", "--spp", "4", "--server", address,
                "-o", f"{folder}/out.png", "--quiet")
            assert pathlib.Path(folder, "out.png").stat().st_size > 0
            # What Slurm does a minute before a time limit.
            slurm("scancel", "--batch", "--signal=TERM", job)
            eventually("the array has ended", lambda: not slurm("squeue", "-h", "-j", job).strip())
            for task in (1, 2):
                log = pathlib.Path(folder, f"worker-{task}.log").read_text()
                assert "left" in log, log
    finally:
        server.terminate()
        server.wait()


def main():
    if os.geteuid() != 0 or not all(shutil.which(program) for program in PROGRAMS):
        print("Slurm is not here, or this is not root: skipped")
        return SKIPPED
    with tempfile.TemporaryDirectory() as folder:
        test(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
